"""IPOPT with MUMPS and with the factorisation stage by stage: time of an iteration, in turns."""

from __future__ import annotations

from typing import Any

import click

from scripts.measure.shared import head, median, row
from trajopt.solvers.drivers import LINEAR_SOLVER, STAGES
from trajopt.solving.solving import solve
from trajopt.transcription.compilation import WAITING_LEVEL
from trajopt_library import problems

# Problem, its parameters, and the mesh; None for the problem's own.
CASES: tuple[tuple[str, dict[str, Any], str | None, int | None], ...] = (
    ("solo12-jump", {}, "legendre:2", 50),
    ("solo12-jump", {}, "legendre:4", 20),
    ("quadruped-jump-forward", {"robot": "anymal_c"}, "legendre:2", 50),
    ("quadruped-trot", {"robot": "go2"}, None, None),
    ("biped-walk", {"robot": "talos"}, None, None),
    ("arm-pick-place", {"robot": "panda"}, None, None),
)
SOLVERS = ("mumps", STAGES)


@click.command("linear-systems")
@click.option("--repeats", default=5, help="Solves of each case with each.")
def linear_systems(repeats: int) -> None:
    """Median wall time of an iteration, functions included, and iterations, of one mesh each."""
    head("problem", "mesh", "iterations", "MUMPS [ms]", "iterations", "stages [ms]", "ratio")
    for name, values, scheme, intervals in CASES:
        problem = problems.load(name, **values)
        times: dict[str, list[float]] = {solver: [] for solver in SOLVERS}
        iterations = {}
        for _ in range(repeats):
            for solver in SOLVERS:
                options = {LINEAR_SOLVER: solver}
                found = solve(
                    problem,
                    transcription=scheme,
                    intervals=intervals,
                    judge=False,
                    options=options,
                    compile=WAITING_LEVEL,
                ).meta
                times[solver].append(1e3 * found["wall_time_s"] / found["iterations"])
                iterations[solver] = found["iterations"]
        usual, own = (median(times[solver]) for solver in SOLVERS)
        row(
            " ".join([name, *(f"{key}={value}" for key, value in values.items())]),
            f"{scheme}, {intervals}" if scheme else "its own",
            iterations["mumps"],
            f"{usual:.1f}",
            iterations[STAGES],
            f"{own:.1f}",
            f"{own / usual:.2f}",
        )
