"""Solve one problem from many perturbed starts: success, iterations and distinct optima.

uv run python -m scripts.perturbed_starts solo12-jump --solver fatrop --sigma 0.3 --seeds 100
"""

from __future__ import annotations

import statistics
from collections import Counter

import click
import numpy as np

from trajopt.solvers.drivers import SOLVERS, run_solver
from trajopt.solvers.result import StoppingCriteria
from trajopt.solvers.status import Status
from trajopt.solving.solving import prepare
from trajopt.transcription.guess import perturbed
from trajopt_library import problems

# Objectives closer than this belong to one optimum.
SAME_OPTIMUM = 1e-3


@click.command()
@click.argument("problem")
@click.option("--solver", type=click.Choice(list(SOLVERS)), default="ipopt")
@click.option("--sigma", default=0.1, help="standard deviation of the noise, scaled units")
@click.option("--seeds", default=100, help="seeds 0 to N - 1")
@click.option("--transcription", default=None)
@click.option("--intervals", type=int, default=None)
def main(
    problem: str, solver: str, sigma: float, seeds: int, transcription: str | None, intervals: int | None
) -> None:
    """Print a table of outcomes over seeds."""
    prepared = prepare(problems.load(problem), transcription=transcription, intervals=intervals)
    results = []
    for seed in range(seeds):
        start = perturbed(prepared.transcription, prepared.guess, seed, sigma)
        results.append(run_solver(prepared.nlp, start, solver, StoppingCriteria(), {}, lambda *_: True))
    solved = [result for result in results if result.status is Status.SOLVED]
    scheme = prepared.transcription.layout.mesh.transcription
    click.echo(f"{problem} {solver} {scheme} sigma {sigma}: {len(solved)} of {seeds}")
    if solved:
        iterations = [result.iterations for result in solved]
        click.echo(f"iterations: median {statistics.median(iterations):g}, most {max(iterations)}")
        seconds = [result.wall_time for result in solved]
        click.echo(f"time: median {statistics.median(seconds):.2f} s, most {max(seconds):.2f} s")
        for objective, count in _optima([result.objective for result in solved]):
            click.echo(f"optimum {objective:.5g}: {count} starts")
    for status, count in Counter(r.status.word for r in results if r.status is not Status.SOLVED).items():
        click.echo(f"{status}: {count} starts")


def _optima(objectives: list[float]) -> list[tuple[float, int]]:
    """Distinct objectives with how many starts reached each."""
    groups: list[list[float]] = []
    for value in sorted(objectives):
        if groups and abs(value - groups[-1][0]) <= SAME_OPTIMUM * abs(value):
            groups[-1].append(value)
        else:
            groups.append([value])
    return [(float(np.median(group)), len(group)) for group in groups]


if __name__ == "__main__":
    main()
