"""Two-stage locomotion against the full problem: size, iterations, time, cost and torques beyond limits."""

import time

import click

from scripts.measure.shared import head, named, row, solver_option, verdict
from trajopt import Problem, solve
from trajopt.reduced.two_stage import base_rows_problem, recover_torques
from trajopt.reduced.wrench_distribution import redistribute_wrenches
from trajopt.solving.solving import PreparedProblem, prepare
from trajopt.solving.warm_start import warm_start
from trajopt.transcription.stage_functions import Derivatives
from trajopt_library import problems

CASES = (
    ("solo12-jump", {}),
    ("solo12-jump", {"torque_limit": 2.2}),
    ("biped-walk", {}),
    ("biped-walk", {"torque_share": 0.6}),
)
TITLES = (
    "problem", "model", "variables", "rows", "SX instructions", "iterations", "time s",
    "ms an iteration", "in functions", "cost", "torque furthest beyond its limit", "check",
)  # fmt: skip


@click.command()
@solver_option
def two_stage(solver: str) -> None:
    """The full problem, stage one, and stage one with its wrenches redistributed, on their own mesh.

    Costs are the full problem's objective at each solution. SX instructions are those of values, first and
    second derivatives of the largest point function.
    """
    head(*TITLES)
    for name, parameters in CASES:
        title = named(name, parameters)
        compare(title, problems.load(name, **parameters), solver)


def compare(title: str, problem: Problem, solver: str) -> None:
    """Print the lines of one problem."""
    full, first = (prepare(each) for each in (problem, base_rows_problem(problem)))
    whole, motion = (
        solve(each, solver=solver, fixed_mesh=True) for each in (problem, base_rows_problem(problem))
    )
    begun = time.perf_counter()
    shared = redistribute_wrenches(problem, motion)
    sharing = time.perf_counter() - begun
    for name, prepared, found, more in (
        ("full", full, whole, 0.0),
        ("stage one", first, motion, 0.0),
        ("redistributed", first, shared, sharing),
    ):
        statistics, worst = found.statistics, recover_torques(problem, found)[1].worst
        times = statistics.wall_time_s, statistics.function_time_s
        each = [1e3 * time / statistics.iterations for time in times]
        unknowns = warm_start(full.transcription, found).x
        cost = full.nlp.engine.f(unknowns) * full.transcription.objective_unit
        row(
            f"`{title}`", name, statistics.variables, statistics.constraints, instructions(prepared),
            statistics.iterations, f"{statistics.wall_time_s + more:.2f}", f"{each[0]:.1f}", f"{each[1]:.2f}",
            f"{cost:.4f}",
            f"{worst.excess:+.1%} {worst.joint} at {worst.time:.2f} s ({worst.phase})",
            verdict(found),
        )  # fmt: skip


def instructions(prepared: PreparedProblem) -> str:
    """SX instructions of values, first and second derivatives of the largest point function."""
    largest = max((group.point for group in prepared.transcription.groups), key=lambda point: point.n_z)
    made = Derivatives(largest)
    return " / ".join(f"{f.n_instructions():,}" for f in (made.value, made.first, made.second))
