"""What an iteration of IPOPT costs: linear solvers, operations of the fronts, meshes, settings."""

from typing import Any

import click
import numpy as np

from scripts.measure.shared import NOISE, head, median, named, row, timed
from trajopt.problem.problem import Problem
from trajopt.solvers.ipopt import LINEAR_SOLVER, STAGES
from trajopt.solvers.status import Status
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
# Problems and meshes of `scaling`.
GROWING = ("ur5-reach", "hopper-hop", "solo12-jump")
INTERVALS = (25, 50, 100, 200, 400, 800)


@click.command("linear-systems")
@click.option("--repeats", default=5, help="Solves of each case with each.")
def linear_systems(repeats: int) -> None:
    """Iterations and their median wall time, functions included, of one mesh each, with MUMPS and stages."""
    head("problem, mesh", "iterations", "MUMPS [ms]", "iterations", "stages [ms]", "ratio")
    for name, values, scheme, intervals in CASES:
        problem = problems.load(name, **values)
        ways = [{"options": {LINEAR_SOLVER: solver}} for solver in SOLVERS]
        times, iterations = in_turns(problem, scheme, intervals, repeats, ways)
        mesh = f", {scheme}@{intervals}" if scheme else ""
        pairs = [cell for n, ms in zip(iterations, times, strict=True) for cell in (n, f"{ms:.1f}")]
        row(named(name, values) + mesh, *pairs, f"{times[1] / times[0]:.2f}")


@click.command("scaling")
@click.option("--starts", default=5, help="From the guess and perturbed ones, of each mesh.")
def scaling(starts: int) -> None:
    """Finer meshes: iterations, time of one with one thread and with two, to build, and of the verdict."""
    times = ("iteration [ms]", "with two threads", "solve [s]", "build [s]", "verdict [s]")
    head("problem", "intervals a phase", "variables", "iterations: guess, median", "not solved", *times)
    for name in GROWING:
        problem, measured = problems.load(name), []
        for intervals in INTERVALS:
            one, two = (
                prepare(problem, transcription="legendre:2", intervals=intervals, threads=threads)
                for threads in (1, 2)
            )
            others = (perturbed(one.transcription, one.guess, k, NOISE) for k in range(1, starts))
            results, ratios = [], []
            for guess in (one.guess, *others):
                results.append(timed(one, guess).result)
                ratios.append(timed(two, guess).result.wall_time / results[-1].wall_time)
            solved = [result for result in results if result.status is Status.SOLVED]
            verdict = solve_prepared(one, one.guess, origin={}).statistics.verdict_time_s
            iteration = median([result.wall_time / result.iterations for result in results])
            whole = median([result.wall_time for result in solved])
            measured.append((iteration, whole, one.build_time, verdict or np.nan))
            counts = f"{results[0].iterations}, {median([result.iterations for result in solved]):.0f}"
            shares = f"{1e3 * iteration:.1f}", f"{median(ratios):.2f}"
            rest = (f"{seconds:.2f}" for seconds in measured[-1][1:])
            row(name, intervals, len(one.guess), counts, len(results) - len(solved), *shares, *rest)
        powers = np.polyfit(np.log(INTERVALS), np.log(measured), 1)[0]
        grows, *more = (f"N^{power:.2f}" for power in powers)
        row(name, "grows as", "", "", "", grows, "", *more)


def in_turns(
    problem: Problem, scheme: str | None, intervals: int | None, repeats: int, ways: list[dict[str, Any]]
) -> tuple[list[float], list[int]]:
    """Median time of an iteration in ms, and iterations, of each way to solve."""
    times: list[list[float]] = [[] for _ in ways]
    iterations = [0 for _ in ways]
    for _ in range(repeats):
        for i, way in enumerate(ways):
            found = solve(problem, transcription=scheme, intervals=intervals, judge=False, **way).statistics
            times[i].append(1e3 * found.wall_time_s / found.iterations)
            iterations[i] = found.iterations
    return [median(part) for part in times], iterations
