"""IPOPT with MUMPS and with the factorisation stage by stage: time of an iteration, in turns."""

from typing import Any

import click
import numpy as np

from scripts.measure.shared import head, median, row
from scripts.peers import problems as peers
from scripts.peers.tasks import TASKS
from trajopt.problem.problem import Problem
from trajopt.solvers.ipopt import LINEAR_SOLVER, STAGES
from trajopt.solving.solving import prepare, solve, solve_prepared
from trajopt.transcription.guess import perturbed
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
# Meshes of `--scaling`, of the first case.
INTERVALS = (25, 50, 100, 200, 400, 800)
# Of `barrier`: tasks of docs/peers.md, each with the mesh that is compared there, and settings.
MESHES = {
    "walk": ("legendre:4", 3),
    "trot": ("legendre:3", 4),
    "pace": ("legendre:3", 3),
    "bound": ("legendre:4", 2),
    "jump": ("legendre:4", 3),
}
SETTINGS: dict[str, dict[str, Any]] = {
    "the defaults": {},
    "`corrector_type=affine`": {"corrector_type": "affine"},
    "`bound_mult_init_val=3e-3`": {"bound_mult_init_val": 3e-3},
    "`min_refinement_steps=0`": {"min_refinement_steps": 0},
    "all three": peers.QUICK,
}
SMALL_NOISE = 0.03


@click.command("linear-systems")
@click.option("--repeats", default=5, help="Solves of each case with each.")
@click.option("--scaling", is_flag=True, help="Instead: meshes of the jump, with one thread and with two.")
def linear_systems(repeats: int, scaling: bool) -> None:
    """Median wall time of an iteration, functions included, and iterations, of one mesh each."""
    if scaling:
        over_meshes(repeats)
    else:
        against_mumps(repeats)


def against_mumps(repeats: int) -> None:
    """Iterations and their time with each linear solver, in turns."""
    head("problem", "mesh", "iterations", "MUMPS [ms]", "iterations", "stages [ms]", "ratio")
    for name, values, scheme, intervals in CASES:
        problem = problems.load(name, **values)
        times, iterations = in_turns(
            problem, scheme, intervals, repeats, [{"options": {LINEAR_SOLVER: solver}} for solver in SOLVERS]
        )
        row(
            " ".join([name, *(f"{key}={value}" for key, value in values.items())]),
            f"{scheme}, {intervals}" if scheme else "its own",
            iterations[0],
            f"{times[0]:.1f}",
            iterations[1],
            f"{times[1]:.1f}",
            f"{times[1] / times[0]:.2f}",
        )


def over_meshes(repeats: int) -> None:
    """Time of an iteration against the number of intervals, and the exponent that fits it."""
    name, values, scheme, _ = CASES[0]
    problem, found = problems.load(name, **values), []
    head("intervals", "iterations", "one thread [ms]", "two threads [ms]", "ratio")
    for intervals in INTERVALS:
        times, iterations = in_turns(problem, scheme, intervals, repeats, [{"threads": 1}, {"threads": 2}])
        found.append(times[0])
        row(intervals, iterations[0], f"{times[0]:.1f}", f"{times[1]:.1f}", f"{times[1] / times[0]:.2f}")
    exponent = np.polyfit(np.log(INTERVALS), np.log(found), 1)[0]
    click.echo(
        f"\nTime of an iteration with one thread grows with the intervals to the power of {exponent:.2f}."
    )


def in_turns(
    problem: Problem, scheme: str | None, intervals: int | None, repeats: int, ways: list[dict[str, Any]]
) -> tuple[list[float], list[int]]:
    """Median time of an iteration in ms, and iterations, of each way to solve."""
    times: list[list[float]] = [[] for _ in ways]
    iterations = [0 for _ in ways]
    for _ in range(repeats):
        for i, way in enumerate(ways):
            found = solve(
                problem,
                transcription=scheme,
                intervals=intervals,
                judge=False,
                **way,
            ).statistics
            times[i].append(1e3 * found.wall_time_s / found.iterations)
            iterations[i] = found.iterations
    return [median(part) for part in times], iterations


@click.command("barrier")
@click.option("--starts", default=5, help="From the guess and perturbed ones, of each setting.")
def barrier(starts: int) -> None:
    """Iterations from the guess, medians of iterations and solver time over starts, by settings."""
    prepared = {}
    for name, (scheme, intervals) in MESHES.items():
        problem = peers.build(TASKS[name])
        prepared[name] = prepare(problem, mesh=peers.mesh(problem, scheme, intervals))
    head("", *(f"{name}, `{scheme}@{intervals}`" for name, (scheme, intervals) in MESHES.items()))
    for label, options in SETTINGS.items():
        cells = []
        for each in prepared.values():
            guesses = [perturbed(each.transcription, each.guess, k, SMALL_NOISE) for k in range(1, starts)]
            solutions = [
                solve_prepared(each, guess, origin={}, judge=False, options=options)
                for guess in (each.guess, *guesses)
            ]
            figures = [solution.statistics for solution in solutions if solution.success]
            iterations = median([one.iterations for one in figures])
            time = 1e3 * median([one.wall_time_s for one in figures])
            missed = f", {starts - len(figures)} not solved" if len(figures) < starts else ""
            cells.append(f"{figures[0].iterations}, {iterations:.0f}, {time:.0f} ms{missed}")
        row(label, *cells)
