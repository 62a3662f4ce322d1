"""Iterations of full problems from guesses with and without reduced models."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import click
import numpy as np

from scripts.measure.shared import NOISE, head, median, row, solver_option, timed
from trajopt import Problem, solve
from trajopt.problem.contact_paths import ContactPaths
from trajopt.reduced.body_guess import DEFAULT_CLEARANCE, guess_from_lip, guess_from_srb
from trajopt.reduced.footsteps import feet_of
from trajopt.reduced.single_rigid_body import body_problem, footholds_of
from trajopt.solvers.result import StoppingCriteria
from trajopt.solving.solving import prepare
from trajopt.transcription.guess import perturbed
from trajopt_library import problems

JUMPS = (
    {"distance": 0.3},
    {"distance": 0.5},
    {"distance": 0.3, "yaw": "45deg"},
    {"distance": 0.3, "height": 0.2},
    {"distance": 0.4, "height": 0.15, "yaw": "35deg"},
)
WALKS = ({}, {"steps": 3, "length": 0.3, "turn": "10deg"}, {"steps": 2, "length": -0.2, "step_time": 0.8})
LIMITS = StoppingCriteria(max_iterations=200)


@dataclass(frozen=True, kw_only=True)
class Midway:
    """Centre of mass midway between the feet, as its motion in a guess without a model."""

    feet: ContactPaths

    def com(self, t: float) -> np.ndarray:
        """Mean position of the feet (2,), m."""
        places = [self.feet.pose(name, t).translation[:2] for name in self.feet.stances]
        return np.asarray(np.mean(places, axis=0))


@click.command()
@click.option("--seeds", default=5, show_default=True, help="Perturbed starts.")
@solver_option
def guesses(seeds: int, solver: str) -> None:
    """Jumps of Solo12 and walks of Talos from reduced models, from the default guess, standing still."""
    titles = ("status", "iterations", "time s", "cost", "perturbed: solved", "median")
    head("problem", "guess", *titles)
    for name, guess, problem in (*jumps(solver), *walks()):
        prepared = prepare(problem)
        first = timed(prepared, solver=solver, stop=LIMITS)
        starts = (perturbed(prepared.transcription, prepared.guess, seed, NOISE) for seed in range(seeds))
        found = [timed(prepared, start, solver, LIMITS) for start in starts]
        solved = [own.result.iterations for own in found if own.solved]
        cost = first.result.objective * prepared.transcription.objective_unit
        row(name, guess, first.result.status.word, first.result.iterations, f"{first.seconds:.2f}",
            f"{cost:.4f}", f"{len(solved)} of {seeds}", f"{median(solved):g}")  # fmt: skip


def jumps(solver: str) -> Iterator[tuple[str, str, Problem]]:
    """Jumps with three guesses."""
    for values in JUMPS:
        name = " ".join(f"{key}={value}" for key, value in values.items())
        problem = problems.load("solo12-jump", **values)
        yield name, "default", problem
        reduced = solve(body_problem(problem), solver=solver)
        found = reduced.statistics
        note = f"one body ({found.iterations} iterations, {found.wall_time_s:.2f} s)"
        yield name, note, replace(problem, guess=guess_from_srb(problem, reduced))
        yield name, "standing still", standing_still(problem)


def walks() -> Iterator[tuple[str, str, Problem]]:
    """Walks with three guesses."""
    for values in WALKS:
        name = "walk " + " ".join(f"{key}={value}" for key, value in values.items())
        problem = problems.load("biped-walk", **values)
        yield name, "pendulum", problem
        robot, plan = problem.robot, footholds_of(problem)
        feet = plan.contact_paths(feet_of(robot, problem.initial_q), DEFAULT_CLEARANCE)
        yield name, "midway", replace(problem, guess=guess_from_lip(robot, plan, Midway(feet=feet)))
        yield name, "standing still", standing_still(problem)


def standing_still(problem: Problem) -> Problem:
    """The problem with its reference posture as guess."""
    return replace(problem, guess=lambda t: problem.robot.reference)
