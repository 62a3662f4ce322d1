"""Problems on hands beside the same ones without hands (docs/problems/bipeds.md)."""

from dataclasses import replace

import click

import trajopt
from scripts.measure.shared import head, row
from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.robot import biped_legs
from trajopt.schedule import Phase
from trajopt_library import problems

NAMES = (
    ("humanoid-push-off", "g1_arms"),
    ("humanoid-push-off", "talos_arms"),
    ("humanoid-lean", "g1_arms"),
    ("humanoid-climb", "g1_arms"),
)
MAX_TIME = 120.0  # s


@click.command("hands")
def hands() -> None:
    """Objective and iterations with hands, and where their contacts are taken out of all phases."""
    head("problem", "robot", "objective", "iterations", "without hands")
    for name, robot in NAMES:
        problem = problems.load(name, robot=robot)
        solution = trajopt.solve(problem, max_time=MAX_TIME)
        objective = f"{solution.statistics.objective:.4f}" if solution.success else "not solved"
        iterations = sum(each.iterations for each in solution.statistics.rounds)
        row(name, robot, objective, iterations, _without(problem))


def _without(problem: Problem) -> str:
    """What becomes of a problem on feet alone: its objective, or why there is none."""
    feet = biped_legs(problem.robot)
    contacts = tuple(problem.robot.contact(foot) for foot in feet)
    schedule = replace(problem.schedule, phases=tuple(_on(phase, feet) for phase in problem.schedule.phases))
    try:
        alone = replace(problem, robot=replace(problem.robot, contacts=contacts), schedule=schedule)
        solution = trajopt.solve(alone, max_time=MAX_TIME)
    except InputError as error:
        return f"refused: {error}"
    if solution.success:
        return f"{solution.statistics.objective:.4f}"
    certified = ", certified" if solution.statistics.certified_infeasible else ""
    return f"not solved: {solution.statistics.status.replace('_', ' ')}{certified}"


def _on(phase: Phase, feet: tuple[str, ...]) -> Phase:
    """A phase without contacts that are not feet."""
    held = {name: place for name, place in phase.footholds.items() if name in feet}
    return replace(phase, contacts=tuple(c for c in phase.contacts if c in feet), surfaces={}, footholds=held)
