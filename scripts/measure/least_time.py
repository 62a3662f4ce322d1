"""Why arms take many iterations: limits that are active in least time, and rounds with rows for bodies."""

from dataclasses import replace

import click
import numpy as np

import trajopt
from scripts.measure.shared import NOISE, head, median, named, row
from trajopt.problem.problem import Problem
from trajopt.solution.solution import Solution
from trajopt.solving.graded import first_mesh
from trajopt.solving.solving import prepare, solve_prepared
from trajopt.terms.limits import VelocityLimits
from trajopt.transcription.guess import perturbed
from trajopt_library import problems

# Arms whose durations are free, and multiples of the least durations at which these are fixed.
FAST = (
    ("arm-transfer", {"robot": "z1"}),
    ("arm-transfer", {"robot": "xarm7"}),
    ("arm-pick-place", {"robot": "panda", "goal": "time"}),
    ("irb1600-transfer", {"goal": "time"}),
)
SLOWER = (1.02, 1.1, 1.5)
# Arms near which other bodies are.
NEAR = (("arm-pick-place", "kinova"), ("arm-pick-place", "z1"), ("arm-transfer", "z1"), ("arm-reach", "z1"))


@click.command("least-time")
@click.option("--starts", default=5, help="Perturbed starts beside the default guess.")
def least_time(starts: int) -> None:
    """Iterations on the first mesh, guess and median of perturbed starts, after one change each."""
    head("problem", "least time", *(f"fixed, {factor:g} of it" for factor in SLOWER), "no velocity limits")
    for name, values in FAST:
        problem = problems.load(name, **values)
        cell, solution = _iterations(problem, starts)
        changed = [_fixed(problem, solution, factor) for factor in SLOWER]
        limitless = [term for term in problem.terms if not isinstance(term, VelocityLimits)]
        changed.append(replace(problem, terms=tuple(limitless)))
        row(named(name, values), cell, *(_iterations(each, starts)[0] for each in changed))


@click.command("arm-rounds")
def arm_rounds() -> None:
    """Rounds of arms near other bodies: iterations, variables, and time of an iteration."""
    head("problem", "iterations", "ms an iteration", "solver [s]")
    for name, robot in NEAR:
        solution = trajopt.solve(problems.load(name, robot=robot))
        rounds = solution.statistics.rounds
        row(
            named(name, {"robot": robot}),
            ", ".join(str(each.iterations) for each in rounds),
            ", ".join(f"{1e3 * each.wall_time_s / each.iterations:.1f}" for each in rounds),
            f"{sum(each.wall_time_s for each in rounds):.1f}",
        )


def _iterations(problem: Problem, starts: int) -> tuple[str, Solution]:
    """Iterations of the default guess and the median of perturbed ones; the first one's solution."""
    prepared = prepare(problem, mesh=first_mesh(problem))
    guesses = [
        perturbed(prepared.transcription, prepared.guess, seed, NOISE) for seed in range(1, starts + 1)
    ]
    solutions = [solve_prepared(prepared, x, origin={}, judge=False) for x in (prepared.guess, *guesses)]
    counts = [solution.statistics.iterations for solution in solutions if solution.converged]
    missed = f", {len(solutions) - len(counts)} not solved" if len(counts) < len(solutions) else ""
    return f"{counts[0]}, {median(counts[1:]):.0f}{missed}", solutions[0]


def _fixed(problem: Problem, solution: Solution, factor: float) -> Problem:
    """The problem with the solution's durations times a factor, and its guess stretched over them."""
    usual = problem.schedule.phases
    phases = tuple(
        replace(phase, duration=factor * duration, duration_bounds=None)
        for phase, duration in zip(usual, solution.phase_durations, strict=True)
    )
    before, after = (np.cumsum([0.0, *(phase.duration for phase in each)]) for each in (usual, phases))
    return replace(
        problem,
        schedule=replace(problem.schedule, phases=phases),
        guess=lambda t: problem.guess_at(float(np.interp(t, after, before))),
    )
