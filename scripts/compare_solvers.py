"""Solvers and Hessians on the same problems: from the guess, from perturbed starts, and solved again.

    OMP_NUM_THREADS=1 python -m scripts.compare_solvers
    OMP_NUM_THREADS=1 python -m scripts.compare_solvers solo12-jump --seeds 20

Three tables a problem: every solver and Hessian from the problem's guess (median time of the repeats); the
number of perturbed starts (0.1 in scaled units) that are solved, with the medians of iterations; and the
solve of a problem whose one parameter is changed a little, from the solution with its multipliers: time and
iterations until all rows hold to 1e-3 in natural units, and until the tolerance of 1e-6 is met. Times are of
the processor, in one thread.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import click
import numpy as np

from trajopt.errors import InputError
from trajopt.solvers.drivers import check_hessian, run_solver
from trajopt.solvers.result import Result, StoppingCriteria, WarmMultipliers
from trajopt.solvers.status import Status
from trajopt.solving.solving import prepare, solve
from trajopt.transcription.guess import perturbed
from trajopt.transcription.nlp import Nlp
from trajopt_library import problems

PAIRS = (
    ("ipopt", "exact"),
    ("ipopt", "gauss-newton"),
    ("ipopt", "limited-memory"),
    ("fatrop", "exact"),
    ("fatrop", "gauss-newton"),
    ("sqp", "exact"),
    ("sqp", "gauss-newton"),
)
# Problems with the parameter that is changed, and by what factor.
CHANGES = {
    "ur5-reach": ("x", 1.1),
    "hopper-hop": ("distance", 1.1),
    "solo12-jump": ("distance", 1.1),
    "quadruped-trot": ("speed", 1.1),
    "biped-squat": ("depth", 1.1),
}
SPREAD = 0.1
FEASIBLE = 1e-3
LIMITS = StoppingCriteria(max_iterations=300, max_time=60.0)


@dataclass(frozen=True, kw_only=True)
class Run:
    """A result, its time in s, and when its rows first held to ``FEASIBLE``: s and iteration, or None."""

    result: Result
    time: float
    feasible_time: float | None
    feasible_iteration: int | None

    @property
    def solved(self) -> bool:
        """Whether it was solved."""
        return self.result.status is Status.SOLVED


def timed(nlp: Nlp, x: np.ndarray, solver: str, warm: WarmMultipliers | None = None) -> Run:
    """Solve, watching for the first iterate whose rows hold."""
    seen: list[tuple[float, int]] = []
    begun = time.process_time()

    def watch(info: dict[str, float]) -> bool:
        if not seen and info["primal"] <= FEASIBLE:
            seen.append((time.process_time() - begun, int(info["iteration"])))
        return True

    result = run_solver(nlp, x, solver, LIMITS, {}, watch, warm)
    at, iteration = seen[0] if seen else (None, None)
    spent = time.process_time() - begun
    return Run(result=result, time=spent, feasible_time=at, feasible_iteration=iteration)


def cold(name: str, repeats: int) -> None:
    """Table of the solves from the problem's own guess."""
    head = "solver, Hessian | status | iterations | objective | ms | ms each | functions, ms"
    _head(f"{head} | programs | ms a program | iterations a program")
    for solver, hessian in PAIRS:
        prepared = prepare(problems.load(name), hessian=hessian)
        try:
            runs = [timed(prepared.nlp, prepared.guess, solver) for _ in range(repeats)]
        except InputError as error:
            print(f"| {solver}, {hessian} | {error} |")
            continue
        one = sorted(runs, key=lambda one: one.time)[len(runs) // 2]
        found, ms = one.result, 1e3 * one.time
        each = ms / max(1, found.iterations)
        cells = f"{found.status.word} | {found.iterations} | {found.objective:.7g} | {ms:.0f}"
        cells = f"{cells} | {each:.1f} | {1e3 * found.function_time:.0f} | {_programs(found)}"
        print(f"| {solver}, {hessian} | {cells} |", flush=True)


def _programs(found: Result) -> str:
    if not found.figures:
        return "| |"
    count = max(1, int(found.figures["quadratic_programs"]))
    ms = 1e3 * found.figures["quadratic_program_time_s"] / count
    return f"{count} | {ms:.1f} | {found.figures['quadratic_program_iterations'] / count:.1f}"


def robust(name: str, seeds: int) -> None:
    """Table of the solves from perturbed starts."""
    _head("solver, Hessian | solved | median iterations | median ms | objectives")
    for solver, hessian in (("ipopt", "exact"), ("fatrop", "exact"), ("sqp", "exact")):
        prepared = prepare(problems.load(name), hessian=hessian)
        starts = [perturbed(prepared.transcription, prepared.guess, seed, SPREAD) for seed in range(seeds)]
        try:
            found = [timed(prepared.nlp, start, solver) for start in starts]
        except InputError:
            continue
        good = [one for one in found if one.solved]
        if not good:
            print(f"| {solver}, {hessian} | 0 of {seeds} | | | |")
            continue
        iterations = np.median([one.result.iterations for one in good])
        ms = 1e3 * np.median([one.time for one in good])
        ends = ", ".join(sorted({f"{one.result.objective:.4g}" for one in good}))
        cells = f"{len(good)} of {seeds} | {iterations:.0f} | {ms:.0f} | {ends}"
        print(f"| {solver}, {hessian} | {cells} |", flush=True)


def again(name: str, repeats: int) -> None:
    """Table of the solves after a small change, from the solution with its multipliers."""
    parameter, factor = CHANGES[name]
    value = problems.load(name).parameters[parameter]
    first = solve(problems.load(name), tolerance=LIMITS.tolerance)
    changed = problems.load(name, **{parameter: factor * value})
    print(f"\n`{parameter}` from {value:g} to {factor * value:g}:\n")
    _head("solver, Hessian | iterations, ms to 1e-3 | iterations, ms to the end | status | objective")
    for solver, hessian in PAIRS:
        prepared = prepare(changed, hessian=hessian, start=first)
        try:
            check_hessian(solver, hessian)
            runs = [timed(prepared.nlp, prepared.guess, solver, prepared.warm) for _ in range(repeats)]
        except InputError:
            continue
        one = sorted(runs, key=lambda r: r.time)[len(runs) // 2]
        soon = "" if one.feasible_time is None else f"{one.feasible_iteration}, {1e3 * one.feasible_time:.0f}"
        end, status = f"{one.result.iterations}, {1e3 * one.time:.0f}", one.result.status.word
        print(f"| {solver}, {hessian} | {soon} | {end} | {status} | {one.result.objective:.7g} |", flush=True)


def _head(columns: str) -> None:
    print(f"| {columns} |\n" + "|---" * (columns.count("|") + 1) + "|", flush=True)


@click.command(help=__doc__)
@click.argument("names", nargs=-1)
@click.option("--seeds", default=20, help="Perturbed starts.")
@click.option("--repeats", default=3, help="Solves whose median time is shown.")
def main(names: Sequence[str], seeds: int, repeats: int) -> None:
    """Print the tables."""
    for name in names or CHANGES:
        print(f"\n## {name}\n")
        cold(name, repeats)
        print()
        robust(name, seeds)
        if name in CHANGES:
            again(name, repeats)


if __name__ == "__main__":
    main()
