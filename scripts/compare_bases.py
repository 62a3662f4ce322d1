"""The same motions on a quaternion and on virtual joints: where they agree, and where angles fail.

uv run python -m scripts.compare_bases
"""

from __future__ import annotations

import click
import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import ORDERS, virtual_order
from trajopt.dynamics.virtual_base import to_free_flyer
from trajopt.problem.problem import Problem
from trajopt.reduced.base_conversion import with_virtual_base
from trajopt.solution.solution import Solution
from trajopt.solvers.drivers import SOLVERS
from trajopt.solving.solving import solve
from trajopt_library import problems

QUATERNION = "quaternion"
HEADER = (
    f"{'problem':12}{'base':12}{'variables':>10}{'rows':>7}{'iter':>6}{'time s':>8}{'objective':>12}"
    f"{'margin':>8}{'cond M':>9}{'base path m':>13}  status"
)


@click.command()
@click.option("--yaw", default=0.6, help="turn of the jump, rad")
@click.option("--order", "orders", type=click.Choice(ORDERS), multiple=True, default=("ZYX", "YXZ"))
@click.option("--transcription", default="legendre:2")
@click.option("--intervals", default=40)
@click.option("--solver", type=click.Choice(list(SOLVERS)), default="ipopt")
def main(yaw: float, orders: tuple[str, ...], transcription: str, intervals: int, solver: str) -> None:
    """Solve a jump and half a flip on every base; print sizes, figures and how far apart they are."""
    click.echo(HEADER)
    for problem in (problems.load("solo12-jump", distance=0.2, yaw=yaw), problems.load("solo12-flip")):
        first: Solution | None = None
        for base in (QUATERNION, *orders):
            asked = problem if base == QUATERNION else with_virtual_base(problem, base)
            found = solve(
                asked, transcription=transcription, intervals=intervals, solver=solver, max_iterations=300
            )
            first = first or found
            click.echo(_row(asked, base, found, first))


def _row(problem: Problem, base: str, found: Solution, first: Solution) -> str:
    meta = found.meta
    margin = meta.get("gimbal_margin")
    apart = np.linalg.norm(_free_flyer(found)[:, :3] - _free_flyer(first)[:, :3], axis=1).max()
    return (
        f"{problem.name:12}{base:12}{meta['variables']:10d}{meta['constraints']:7d}{meta['iterations']:6d}"
        f"{meta['wall_time_s']:8.2f}{meta['objective']:12.6f}{'' if margin is None else f'{margin:.3f}':>8}"
        f"{condition(found):9.1e}{apart:13.1e}  {meta['status']}"
    )


def condition(solution: Solution) -> float:
    """Worst condition number over samples of the joint-space inertia."""
    model, data = solution.model, solution.model.createData()
    worst = max(np.linalg.cond(pin.crba(model, data, q)) for q in solution.q)
    return float(worst)


def _free_flyer(solution: Solution) -> np.ndarray:
    """Configurations (K, nq) with a quaternion."""
    model = solution.model
    if virtual_order(model) is None:
        return solution.q
    still = np.zeros(model.nv)
    return np.array([to_free_flyer(model, q, still, still)[0] for q in solution.q])


if __name__ == "__main__":
    main()
