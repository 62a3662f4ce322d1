"""What an iteration of IPOPT costs: linear solvers, operations of the fronts, meshes, settings."""

import math
from collections import Counter
from typing import Any

import click
import numpy as np

from scripts.measure.shared import NOISE, head, median, named, row, timed
from scripts.peers import problems as peers
from scripts.peers.tasks import TASKS
from trajopt import _engine
from trajopt.problem.problem import Problem
from trajopt.solvers.ipopt import LINEAR_SOLVER, STAGES
from trajopt.solvers.status import Status
from trajopt.solving.solving import PreparedProblem, prepare, solve, solve_prepared
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
    "`corrector_type=none`": {"corrector_type": "none"},
    "`bound_mult_init_val=1`": {"bound_mult_init_val": 1.0},
    "`min_refinement_steps=1`": {"min_refinement_steps": 1},
}
SETTINGS["all three, IPOPT's own"] = {k: v for setting in SETTINGS.values() for k, v in setting.items()}
SMALL_NOISE = 0.03


# Of `fronts`: rows and depths of products by which the kernel's peak is found.
PRODUCTS = ((48, 16), (96, 16), (96, 96), (160, 96))
# Of functions: values, first and second derivatives.
KINDS = ("value", "first", "second")
# Points that a tape is run at together.
LANES = 8

repeats_option = click.option("--repeats", default=5, help="Solves of each case with each.")


@click.command("linear-systems")
@repeats_option
def linear_systems(repeats: int) -> None:
    """Iterations and their median wall time, functions included, of one mesh each, with MUMPS and stages."""
    head("problem, mesh", "iterations", "MUMPS [ms]", "iterations", "stages [ms]", "ratio")
    for name, values, scheme, intervals in CASES:
        problem = problems.load(name, **values)
        times, iterations = in_turns(
            problem, scheme, intervals, repeats, [{"options": {LINEAR_SOLVER: solver}} for solver in SOLVERS]
        )
        row(
            _label(name, values, scheme, intervals),
            iterations[0],
            f"{times[0]:.1f}",
            iterations[1],
            f"{times[1]:.1f}",
            f"{times[1] / times[0]:.2f}",
        )


@click.command("fronts")
@repeats_option
def fronts(repeats: int) -> None:
    """Time of an iteration against that of its fronts' operations at the kernel's peak, and its parts."""
    head(
        "problem, mesh",
        "10^6 operations",
        "peak [GFLOP/s]",
        "at the peak [ms]",
        "iteration [ms]",
        "ratio",
        "factorisation",
        "substitution",
        "values",
        "first derivatives",
        "second derivatives",
        "IPOPT",
        "lanes filled",
    )
    for name, values, scheme, intervals in CASES:
        prepared = prepare(problems.load(name, **values), transcription=scheme, intervals=intervals)
        solves, rates = [], []
        for _ in range(repeats):
            rates += [_engine.product_rate(*shape) for shape in PRODUCTS]
            result = timed(prepared).result
            functions = prepared.nlp.engine.timings()
            solves.append((result.wall_time, result, [functions[kind][0] for kind in KINDS]))
        whole, chosen, functions_s = sorted(solves, key=lambda solve: solve[0])[repeats // 2]
        figures, peak = chosen.figures, max(rates)
        ideal = figures["kkt_operations"] / peak
        parts = [figures["factorization_time_s"], figures["substitution_time_s"], *functions_s]
        shares = [part / whole for part in parts]
        row(
            _label(name, values, scheme, intervals),
            f"{figures['kkt_operations'] / chosen.iterations / 1e6:.1f}",
            f"{peak / 1e9:.0f}",
            f"{1e3 * ideal / chosen.iterations:.2f}",
            f"{1e3 * whole / chosen.iterations:.2f}",
            f"{whole / ideal:.0f}",
            *(f"{share:.0%}" for share in [*shares, 1 - sum(shares), _filled(prepared)]),
        )


@click.command("scaling")
@click.option("--starts", default=5, help="From the guess and perturbed ones, of each mesh.")
def scaling(starts: int) -> None:
    """Finer meshes: iterations, time of one with one thread and with two, to build, and of the verdict."""
    head(
        "problem",
        "intervals a phase",
        "variables",
        "iterations: guess, median",
        "not solved",
        "iteration [ms]",
        "with two threads",
        "solve [s]",
        "build [s]",
        "verdict [s]",
    )
    for name in GROWING:
        problem, measured = problems.load(name), []
        for intervals in INTERVALS:
            one, two = (
                prepare(problem, transcription="legendre:2", intervals=intervals, threads=threads)
                for threads in (1, 2)
            )
            guesses = [
                one.guess,
                *(perturbed(one.transcription, one.guess, k, NOISE) for k in range(1, starts)),
            ]
            results, ratios = [], []
            for guess in guesses:
                results.append(timed(one, guess).result)
                ratios.append(timed(two, guess).result.wall_time / results[-1].wall_time)
            solved = [result for result in results if result.status is Status.SOLVED]
            verdict = solve_prepared(one, one.guess, origin={}).statistics.verdict_time_s
            iteration = median([result.wall_time / result.iterations for result in results])
            whole = median([result.wall_time for result in solved])
            measured.append((iteration, whole, one.build_time, verdict or np.nan))
            row(
                name,
                intervals,
                len(one.guess),
                f"{results[0].iterations}, {median([result.iterations for result in solved]):.0f}",
                len(results) - len(solved),
                f"{1e3 * iteration:.1f}",
                f"{median(ratios):.2f}",
                *(f"{seconds:.2f}" for seconds in measured[-1][1:]),
            )
        powers = np.polyfit(np.log(INTERVALS), np.log(measured), 1)[0]
        grows, *more = (f"N^{power:.2f}" for power in powers)
        row(name, "grows as", "", "", "", grows, "", *more)


def _filled(prepared: PreparedProblem) -> float:
    """Part of the vector lanes that points of one instance fill, in second derivatives."""
    points: Counter[_engine.Tape] = Counter()
    for group in prepared.nlp.parts["groups"]:
        points[group["second"]] += len(group["x_offset"])
    needed = sum(tape.statements * count / LANES for tape, count in points.items())
    return needed / sum(tape.statements * math.ceil(count / LANES) for tape, count in points.items())


def _label(name: str, values: dict[str, Any], scheme: str | None, intervals: int | None) -> str:
    """A case and its mesh."""
    mesh = f", {scheme}@{intervals}" if scheme else ""
    return named(name, values) + mesh


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
