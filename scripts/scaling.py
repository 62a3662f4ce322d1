"""Iterations and time of solvers on finer and finer meshes: the exponent of time in the number of intervals.

uv run python -m scripts.scaling solo12-jump --solver fatrop --intervals 25,50,100,200,400 --seeds 4
"""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass

import click
import numpy as np

from trajopt.problem.problem import Problem
from trajopt.solvers.drivers import SOLVERS, run
from trajopt.solvers.result import Stop
from trajopt.solvers.status import Status
from trajopt.solving.solving import PreparedProblem, prepare
from trajopt.transcription.guess import perturbed
from trajopt_library import problems


@dataclass(frozen=True, kw_only=True)
class Row:
    """One number of intervals: of the own start and medians over perturbed ones; CPU seconds."""

    intervals: int
    own: int | None
    median: float | None
    solved: int
    step: float
    build: float


def _row(problem: Problem, solver: str, intervals: int, seeds: int, sigma: float) -> Row:
    begun = time.process_time()
    prepared = prepare(problem, intervals=intervals)
    build = time.process_time() - begun
    own, others, steps = None, [], []
    for seed in range(seeds + 1):
        iterations, seconds = _solve(prepared, solver, seed, sigma if seed else 0.0)
        if iterations is None:
            continue
        steps.append(seconds / max(iterations, 1))
        if seed:
            others.append(iterations)
        else:
            own = iterations
    return Row(
        intervals=intervals,
        own=own,
        median=statistics.median(others) if others else None,
        solved=len(others),
        step=statistics.median(steps) if steps else float("nan"),
        build=build,
    )


def _solve(prepared: PreparedProblem, solver: str, seed: int, sigma: float) -> tuple[int | None, float]:
    """Iterations, None where it was not solved, and CPU seconds."""
    start = perturbed(prepared.transcription, prepared.guess, seed, sigma) if sigma else prepared.guess
    begun = time.process_time()
    result = run(prepared.nlp, start, solver, Stop(), {}, lambda *_: True)
    return (result.iterations if result.status is Status.SOLVED else None), time.process_time() - begun


def exponent(intervals: list[int], seconds: list[float]) -> float:
    """p of the least-squares fit log seconds = p log N + constant, over what is finite."""
    found = np.isfinite(seconds)
    return float(np.polyfit(np.log(np.array(intervals)[found]), np.log(np.array(seconds)[found]), 1)[0])


@click.command()
@click.argument("problem")
@click.option("--robot", default=None)
@click.option("--solver", type=click.Choice(list(SOLVERS)), default="fatrop")
@click.option("--intervals", default="25,50,100,200,400")
@click.option("--seeds", default=4, help="perturbed starts beside the own one")
@click.option("--sigma", default=0.1, help="standard deviation of the noise, scaled units")
def main(problem: str, robot: str | None, solver: str, intervals: str, seeds: int, sigma: float) -> None:
    """Print a table, and the exponents of build time, time of an iteration and time of a solve."""
    numbers = [int(part) for part in intervals.split(",")]
    built = problems.load(problem, **({} if robot is None else {"robot": robot}))
    rows = [_row(built, solver, number, seeds, sigma) for number in numbers]
    click.echo("intervals  own start  median  solved  ms/iteration  build s")
    for row in rows:
        own = "-" if row.own is None else row.own
        median = "-" if row.median is None else f"{row.median:g}"
        solved = f"{row.solved}/{seeds}"
        cells = f"{row.intervals:9d}  {own!s:>9}  {median:>6}  {solved:>6}"
        click.echo(f"{cells}  {row.step * 1e3:12.2f}  {row.build:7.2f}")
    steps = [row.step for row in rows]
    whole = [row.step * (row.median or row.own or np.nan) for row in rows]
    parts = {"an iteration": steps, "a solve": whole, "the build": [row.build for row in rows]}
    click.echo(", ".join(f"{name}: N^{exponent(numbers, part):.2f}" for name, part in parts.items()))


if __name__ == "__main__":
    main()
