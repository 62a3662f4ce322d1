"""Gaits of bipeds as periodic orbits at a commanded speed: half a cycle, closed by its mirror image."""

from functools import partial
from typing import Any

from trajopt.problem import Family, Periodicity, Problem
from trajopt.robot import biped_legs
from trajopt.schedule import BIPED, gait_of

from . import bipeds, common, gait_common
from .gait_common import Style

# Height of a foot in mid-swing, over the robot's length: the least, and that of the guess.
CLEARANCE = 0.05
GUESS_CLEARANCE = 0.08
# Froude numbers of a slow walk and of a jog, which determine the stride lengths as for animals.
STYLES = {
    "walk": Style(froude=0.04, clearance=CLEARANCE, summary="one or two feet on the ground"),
    "run": Style(froude=0.25, clearance=CLEARANCE, summary="one foot or none on the ground"),
}


def build(
    *,
    style: str,
    name: str,
    robot: str,
    cycle: str,
    feet: str,
    heel: float | None,
    toe: float | None,
    friction: float,
    torque_share: float,
    **commanded: Any,
) -> Problem:
    """Build one periodic gait; see ``FAMILIES`` for the parameters. Raises InputError."""
    body, half = bipeds.biped(robot), cycle == "half"
    rolls = bipeds.rolls_of(body, feet, heel, toe)
    left, right = biped_legs(body)
    asked = gait_common.command(body, STYLES[style], gait_of(body, style), **commanded)
    mirror = {left: right, right: left} if half else None
    return gait_common.periodic_problem(
        name,
        body,
        asked,
        gait_common.cycle(asked, mirror),
        mirror=mirror,
        swing=asked.lift * GUESS_CLEARANCE / CLEARANCE,
        rolls=rolls,
        friction=friction,
        torque_share=torque_share,
        periodicity=Periodicity(velocity=(*asked.pace.velocity, 0.0), mirror=half),
    )


def _family(name: str, style: str) -> Family:
    defaults, gait = STYLES[style], BIPED[style]
    return Family(
        name=name,
        robots=bipeds.ROBOTS,
        phases=("double_1", "single_1") if style == "walk" else ("single_1", "flight_1"),
        summary=f"{style}, periodic at a commanded speed: {defaults.summary}",
        parameters=(
            gait_common.forward(defaults),
            common.duration(
                "period", None, "duration of a cycle, two steps (default: from length and speed)", (0.05, 10)
            ),
            gait_common.duty(gait),
            common.choice("cycle", "solve one step, followed by its mirror image, or both", "half", "full"),
            *bipeds.ROLLING,
            gait_common.clearance("twentieth"),
            common.friction(0.7),
            common.TORQUE_SHARE,
        ),
        build=partial(build, style=style, name=name),
    )


FAMILIES = (_family("biped-gait", "walk"), _family("biped-run", "run"))
