"""Solve the jump over its range of distances, heights and turns, and check every solution.

uv run python -m scripts.jump_range --solver ipopt
"""

from __future__ import annotations

import itertools
import math

import click

import trajopt
from trajopt.solvers.drivers import SOLVERS
from trajopt_library import problems

DISTANCES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
HEIGHTS = (0.0, 0.1, 0.2)
TURNS = (0.0, math.radians(22.5), math.radians(45.0))


@click.command()
@click.option("--solver", type=click.Choice(list(SOLVERS)), default="ipopt")
@click.option("--transcription", default="legendre:2")
def main(solver: str, transcription: str) -> None:
    """Print a line for every case."""
    solved = 0
    cases = list(itertools.product(DISTANCES, HEIGHTS, TURNS))
    for distance, height, yaw in cases:
        problem = problems.load("solo12-jump", distance=distance, height=height, yaw=yaw)
        solution = trajopt.solve(problem, solver=solver, transcription=transcription)
        report = trajopt.check(solution)
        solved += solution.success and report.ok
        click.echo(
            f"distance {distance:.1f} m  height {height:.1f} m  yaw {math.degrees(yaw):4.1f} deg  "
            f"{solution.meta['status']:10s} {solution.meta['iterations']:4d} iterations  "
            f"objective {solution.meta['objective']:8.4f}  drift {report.foot_drift:.1e} m  "
            f"open loop {report.open_loop_position:.1e} m  {'' if report.ok else report.failures()}"
        )
    click.echo(f"{solved} of {len(cases)} solved and within the check's tolerances")


if __name__ == "__main__":
    main()
