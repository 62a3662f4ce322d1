"""Iterations of full problems from guesses of reduced models and of none.

uv run python -m scripts.compare_guesses
uv run python -m scripts.compare_guesses --seeds 20 --sigma 0.3

Jumps of Solo12 from the problem's own guess, from one rigid body (`trajopt.reduced.body_guess`), and standing
still; walks of Talos from the linear inverted pendulum, with the CoM midway between the feet, and from
standing still.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from dataclasses import dataclass, replace

import click
import numpy as np

import trajopt
from trajopt.problem.problem import Problem
from trajopt.reduced.body_guess import guess_from_srb
from trajopt.reduced.foot_motion import DEFAULT_CLEARANCE, FootMotion, guess_from_lip
from trajopt.reduced.footsteps import feet_of
from trajopt.reduced.single_rigid_body import body_problem, footholds_of
from trajopt.solvers.drivers import SOLVERS, run_solver
from trajopt.solvers.result import StoppingCriteria
from trajopt.solvers.status import Status
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
MOST_ITERATIONS = 200


@dataclass(frozen=True, kw_only=True)
class Midway:
    """Centre of mass midway between the feet, as its motion in a guess without a model."""

    feet: FootMotion

    def com(self, t: float) -> np.ndarray:
        """Mean position of the feet (2,), m."""
        places = [self.feet.foothold(name, t).position[:2] for name in self.feet.initial]
        return np.asarray(np.mean(places, axis=0))

    def velocity(self, t: float) -> np.ndarray:
        """Not used by a guess."""
        raise NotImplementedError

    acceleration = zmp_at = velocity


def jumps(solver: str) -> Iterator[tuple[str, str, Problem]]:
    """Jumps with three guesses."""
    for values in JUMPS:
        name = " ".join(f"{key}={value}" for key, value in values.items())
        problem = problems.load("solo12-jump", **values)
        yield name, "own", problem
        reduced = trajopt.solve(body_problem(problem), solver=solver)
        note = f"one body ({reduced.meta['iterations']} iterations, {reduced.meta['wall_time_s']:.2f} s)"
        yield name, note, replace(problem, guess=guess_from_srb(problem, reduced))
        yield name, "standing still", replace(problem, guess=lambda t, q=problem.robot.reference: q)


def walks() -> Iterator[tuple[str, str, Problem]]:
    """Walks with three guesses."""
    for values in WALKS:
        name = "walk " + " ".join(f"{key}={value}" for key, value in values.items())
        problem = problems.load("biped-walk", **values)
        yield name, "pendulum", problem
        robot, plan = problem.robot, footholds_of(problem)
        feet = FootMotion(plan=plan, initial=feet_of(robot, problem.initial_q), clearance=DEFAULT_CLEARANCE)
        yield name, "midway", replace(problem, guess=guess_from_lip(robot, plan, Midway(feet=feet)))
        yield name, "standing still", replace(problem, guess=lambda t, q=robot.reference: q)


@click.command()
@click.option("--solver", type=click.Choice(list(SOLVERS)), default="ipopt")
@click.option("--sigma", default=0.1, help="standard deviation of the noise, scaled units")
@click.option("--seeds", default=5, help="perturbed starts: seeds 0 to N - 1")
@click.option("--walks-only", is_flag=True, help="leave out the jumps")
def main(solver: str, sigma: float, seeds: int, walks_only: bool) -> None:
    """Print a line for every problem and guess."""
    for name, guess, problem in (*(() if walks_only else jumps(solver)), *walks()):
        prepared = prepare(problem)
        starts = [
            prepared.guess,
            *(perturbed(prepared.transcription, prepared.guess, seed, sigma) for seed in range(seeds)),
        ]
        stop = StoppingCriteria(max_iterations=MOST_ITERATIONS)
        results = [run_solver(prepared.nlp, start, solver, stop, {}, lambda *_: True) for start in starts]
        first, others = results[0], [r for r in results[1:] if r.status is Status.SOLVED]
        median = statistics.median(r.iterations for r in others) if others else float("nan")
        click.echo(
            f"{name:38s} {guess:34s} {first.status.word:16s} {first.iterations:4d} iterations "
            f"{first.wall_time:6.2f} s  cost {first.objective:7.4f}   "
            f"perturbed: {len(others)} of {seeds} solved, median {median:g}"
        )


if __name__ == "__main__":
    main()
