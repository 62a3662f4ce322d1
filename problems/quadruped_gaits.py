"""Gaits of quadrupeds as periodic orbits at a commanded speed: trot, pace, walk, bound, pronk and gallop.

One cycle (or half of one, where the other half is its mirror image) from a touchdown on; the final state is
the initial one moved by the commanded displacement. Feet land anywhere on the ground.
"""

from functools import partial
from typing import Any

from trajopt.errors import InputError
from trajopt.problem import Family, Periodicity, Problem
from trajopt.reduced import Pace, commanded_motion
from trajopt.robot import Robot, quadruped_legs
from trajopt.schedule import QUADRUPED, gait_of
from trajopt_library import robots

from . import common, gait_common
from .gait_common import HIGHER, RARE, ROBOTS, STYLES

SYMMETRIC = ("walk", "amble", "trot", "flying-trot", "pace")


def _periodicity(robot: Robot, pace: Pace, duration: float, *, mirrored: bool) -> Periodicity:
    motion = commanded_motion(robot, pace)
    way = motion(duration)[:3] - motion(0.0)[:3]
    return Periodicity(
        translation=(float(way[0]), float(way[1]), 0.0), turn=pace.turn_rate * duration, mirror=mirrored
    )


def build(
    *,
    style: str,
    robot: str,
    cycle: str,
    durations: str,
    footholds: str,
    goal: str,
    friction: float,
    torque_share: float,
    **commanded: Any,
) -> Problem:
    """Build one periodic gait; see ``FAMILIES`` for the parameters. Raises InputError."""
    body, name = robots.load(robot), f"quadruped-{style}"
    legs = quadruped_legs(body)
    asked = gait_common.command(body, STYLES[style], gait_of(body, style), **commanded)
    half = cycle == "half"
    if half and (asked.pace.turn_rate or asked.pace.velocity[1]):
        raise InputError(
            f"{name} with cycle=half turns or moves sideways", "allowed: straight ahead, or cycle=full"
        )
    mirror, free = legs.mirror if half else None, durations == "free"
    schedule = gait_common.cycle(asked, mirror, free=free)
    return gait_common.periodic_problem(
        name,
        body,
        asked,
        schedule,
        mirror=mirror,
        swing=HIGHER * asked.lift,
        friction=friction,
        torque_share=torque_share,
        goal=goal,
        planned=footholds == "planned",
        periodicity=_periodicity(body, asked.pace, schedule.duration, mirrored=half),
        duration_bounds=(schedule.duration, schedule.duration) if free else None,
    )


def _family(style: str) -> Family:
    defaults, gait = STYLES[style], QUADRUPED[style]
    return Family(
        name=f"quadruped-{style}",
        robots=ROBOTS[:1] if style in RARE else ROBOTS,
        phases=tuple(phase.name for phase in gait.phases(1.0)),
        summary=f"{style}, periodic at a commanded speed: {defaults.summary}",
        parameters=(
            gait_common.forward(defaults),
            common.speed("lateral", 0.0, "speed to the left"),
            gait_common.TURN_RATE,
            gait_common.PERIOD,
            gait_common.duty(gait),
            _CYCLE if style in SYMMETRIC else _FULL,
            _DURATIONS,
            _FOOTHOLDS,
            gait_common.GOAL,
            gait_common.clearance(),
            common.friction(0.7),
            common.TORQUE_SHARE,
        ),
        build=partial(build, style=style),
    )


_CYCLE = common.choice(
    "cycle", "solve a whole cycle, or half of one, followed by its mirror image", "full", "half"
)
_FULL = common.choice("cycle", "solve a whole cycle", "full")
_DURATIONS = common.choice("durations", "durations of the phases within the period", "fixed", "free")
_FOOTHOLDS = common.choice(
    "footholds", "feet land anywhere on the ground, or under the hips in mid stance", "free", "planned"
)
FAMILIES = tuple(_family(style) for style in STYLES)
