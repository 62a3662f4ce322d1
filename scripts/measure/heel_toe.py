"""Walking and running of bipeds on soles that roll from heel to toe, beside flat feet."""

from typing import Any

import click

import trajopt
from scripts.measure.shared import PASSES, head, row, verdict
from trajopt.errors import TrajoptError
from trajopt.motion.energy_use import cost_of_transport
from trajopt.motion.solution import Solution
from trajopt_library import problems
from trajopt_library.problems import biped_gait, bipeds

FEET = ("flat", "heel-toe")
ROBOTS = ("talos", "g1")
# Multiples of the default speed, with the stride lengths that go with them.
SPEEDS = {"biped-gait": (0.75, 1.0, 1.5), "biped-run": (0.8, 1.0, 1.2)}
# Steps over the robot's length, at the default period, until a step does not pass the check.
STEPS = (0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
# Of all solves of a motion, s and iterations of each: several times what the slowest that are solved take.
LIMITS = {"max_time": 60.0, "max_iterations": 300}


@click.command("heel-toe")
def heel_toe() -> None:
    """Cost of transport, iterations and verdict, flat beside heel-toe, at three speeds."""
    figures = (f"{feet}: {what}" for feet in FEET for what in ("cost", "iterations", "check"))
    head("gait", "robot", "speed [m/s]", "step [m]", *figures)
    for family, factors in SPEEDS.items():
        for robot in ROBOTS:
            style, body = biped_gait.STYLES["walk" if family == "biped-gait" else "run"], bipeds.biped(robot)
            for factor in factors:
                speed = factor * style.speed(body)
                cells = [
                    cell for feet in FEET for cell in _cells(family, robot=robot, speed=speed, feet=feet)
                ]
                step = speed * style.period(body, speed) / 2
                row(family, robot, f"{speed:.2f}", f"{step:.2f}", *cells)


@click.command("longest-steps")
def longest_steps() -> None:
    """Steps of a walk that pass the check, at the default period."""
    head("robot", "period [s]", "feet", *(f"step {step:g} l" for step in STEPS))
    for robot in ROBOTS:
        style, body = biped_gait.STYLES["walk"], bipeds.biped(robot)
        period = style.period(body, style.speed(body))
        for feet in FEET:
            cells = []
            for step in STEPS:
                settings = {"speed": 2 * step * body.length / period, "period": period}
                cost, _, check = _cells("biped-gait", robot=robot, feet=feet, **settings)
                cells.append(cost if check == PASSES else "-")
            row(robot, f"{period:.2f}", feet, *cells)


def _cells(family: str, **values: Any) -> tuple[str, str, str]:
    """Cost of transport, iterations of all rounds and verdict of one gait."""
    try:
        solution = trajopt.solve(problems.load(family, **values), **LIMITS)
    except TrajoptError as error:
        return "", "", str(error)
    if not solution.converged:
        return "", _iterations(solution), "not solved"
    return f"{cost_of_transport(solution):.3f}", _iterations(solution), verdict(solution)


def _iterations(solution: Solution) -> str:
    return str(sum(each.iterations for each in solution.statistics.rounds))
