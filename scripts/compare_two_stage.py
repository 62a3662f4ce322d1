"""Two-stage locomotion against the full problem: size, iterations, time, cost and torques beyond limits.

uv run python -m scripts.compare_two_stage
uv run python -m scripts.compare_two_stage solo12-jump --set distance=0.5 --set effort=2.2

Costs are the full problem's objective, evaluated at each solution. "shared anew" is stage one with its
contact wrenches redistributed (`trajopt.reduced.wrench_distribution`).
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import click
import numpy as np

import trajopt
from trajopt.problem.problem import Problem
from trajopt.reduced.two_stage import base_rows_problem, recover_torques
from trajopt.reduced.wrench_distribution import redistribute_wrenches
from trajopt.solution.solution import Solution
from trajopt.solvers.drivers import SOLVERS, run
from trajopt.solvers.result import Result, Stop
from trajopt.solvers.status import Status
from trajopt.solving.extraction import extract
from trajopt.solving.solving import PreparedProblem, prepare
from trajopt.transcription.stage_functions import derivatives
from trajopt.transcription.transcription import Transcription
from trajopt_library import problems

CASES = (
    ("solo12-jump", {}),
    ("solo12-jump", {"effort": 2.2}),
    ("biped-walk", {}),
    ("biped-walk", {"effort_share": 0.6}),
)


@dataclass(frozen=True)
class Solved:
    """A problem solved from its guess, with all that the table wants."""

    prepared: PreparedProblem
    result: Result
    solution: Solution

    @classmethod
    def of(cls, problem: Problem, solver: str) -> Solved:
        prepared = prepare(problem)
        result = run(prepared.nlp, prepared.guess, solver, Stop(), {}, lambda *_: True)
        meta = {
            "solver": solver,
            "status": result.status.word,
            "success": result.status is Status.SOLVED,
            "iterations": result.iterations,
            "objective": result.objective,
            "tolerance": Stop().tolerance,
            "wall_time_s": result.wall_time,
        }
        return cls(prepared, result, extract(prepared.transcription, result.x, meta))

    @property
    def instructions(self) -> tuple[int, int, int]:
        """SX instructions of values, first and second derivatives of the largest point function."""
        points = {id(group.point): group.point for group in self.prepared.transcription.groups}
        largest = max(points.values(), key=lambda point: point.n_z)
        made = derivatives(largest)
        return tuple(f.n_instructions() for f in (made.value, made.first, made.second))


def with_wrenches(transcription: Transcription, x: np.ndarray, solution: Solution) -> np.ndarray:
    """Unknowns ``x`` with the contact wrenches of a solution of the same intervals."""
    layout, names = transcription.layout, [contact.name for contact in transcription.problem.robot.contacts]
    unknowns = x * transcription.scale
    for k, rows in zip(layout.interval_stages, solution.intervals, strict=True):
        phase, window = int(layout.phase_of[k]), unknowns[layout.window(k)]
        for i in range(layout.scheme_of(phase).s):
            f = solution.f[rows.start + 1 + i]
            parts = [f[names.index(c.name), list(c.rows)] for c in layout.contacts[phase]]
            window[layout.local_wrench(phase, i)] = np.concatenate([np.zeros(0), *parts])
    return unknowns / transcription.scale


def compare(problem: Problem, solver: str) -> None:
    """Print the table of one problem."""
    full, first = Solved.of(problem, solver), Solved.of(base_rows_problem(problem), solver)
    begin = time.perf_counter()
    shared = redistribute_wrenches(problem, first.solution)
    sharing = time.perf_counter() - begin
    x = with_wrenches(first.prepared.transcription, first.result.x, shared)
    click.echo(
        f"{'':12s} {'variables':>9s} {'rows':>6s} {'SX instructions':>22s} {'iterations':>10s} "
        f"{'time s':>7s} {'ms/iteration':>12s} {'functions':>9s} "
        f"{'cost':>8s}  torque furthest beyond its limit"
    )
    for name, solved, unknowns, solution in (
        ("full", full, full.result.x, full.solution),
        ("stage one", first, first.result.x, first.solution),
        ("shared anew", first, x, shared),
    ):
        result, layout = solved.result, solved.prepared.transcription.layout
        worst = recover_torques(problem, solution)[1].worst
        wall = result.wall_time + (sharing if solution is shared else 0.0)
        per_iteration = [1e3 * t / result.iterations for t in (result.wall_time, result.function_time)]
        click.echo(
            f"{name:12s} {layout.n_unknowns:9d} {solved.prepared.transcription.n_rows:6d} "
            f"{'/'.join(str(n) for n in solved.instructions):>22s} {result.iterations:10d} {wall:7.2f} "
            f"{per_iteration[0]:12.1f} {per_iteration[1]:9.2f} {full.prepared.nlp.engine.f(unknowns):8.4f}  "
            f"{worst.excess:+.1%} {worst.joint} at {worst.time:.2f} s ({worst.phase})  {result.status.word}"
        )
    failures = trajopt.check(shared).failures()
    click.echo(f"check of the shared wrenches: {failures or 'all within tolerances'}\n")


@click.command()
@click.argument("problem", required=False)
@click.option("--set", "values", multiple=True, help="parameter=value of the problem")
@click.option("--solver", type=click.Choice(list(SOLVERS)), default="ipopt")
def main(problem: str | None, values: tuple[str, ...], solver: str) -> None:
    """Print a table for one problem, or for four cases."""
    chosen = dict(value.split("=", 1) for value in values)
    for name, parameters in CASES if problem is None else ((problem, chosen),):
        click.echo(f"{name} {' '.join(f'{key}={value}' for key, value in parameters.items())} ({solver})")
        compare(problems.load(name, **parameters), solver)


if __name__ == "__main__":
    main()
