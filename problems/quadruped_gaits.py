"""Gaits of quadrupeds as periodic orbits at a commanded speed: trot, pace, walk, bound, pronk and gallop.

One cycle (or half of one, where the other half is its mirror image) from a touchdown on; the final state is
the initial one moved by the commanded way. Feet land anywhere on the ground.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from trajopt.errors import InputError
from trajopt.problem.family import Choice, Family
from trajopt.problem.periodicity import Periodicity
from trajopt.problem.problem import Problem
from trajopt.reduced.gait_guess import Pace, commanded_motion, plan_of_cycle
from trajopt.robot.legs import quadruped_legs
from trajopt.robot.robot import Robot
from trajopt.schedule.gaits import Gait
from trajopt.schedule.named_gaits import QUADRUPED
from trajopt.schedule.schedule import Schedule
from trajopt.terms import swing_arcs
from trajopt.terrain.flat import FlatGround
from trajopt_library import robots

from . import common, gait_common
from .gait_common import HIGHER, RARE, ROBOTS, STYLES, gait_terms

# Free durations are between these parts of the nominal ones; their sum, the period, is not free.
FREE = (0.6, 1.5)
# Of a whole cycle.
INTERVALS = 32

SYMMETRIC = ("walk", "amble", "trot", "flying-trot", "pace")


def _cycle(gait: Gait, period: float, mirror: Mapping[str, str] | None, *, free: bool) -> Schedule:
    bounds = FREE if free else None
    if mirror is None:
        return Schedule(gait.phases(period, duration_bounds=bounds))
    return Schedule(gait.half_cycle(period, mirror, duration_bounds=bounds))


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
    effort_share: float,
    **commanded: float | None,
) -> Problem:
    """Build one periodic gait; see ``FAMILIES`` for the parameters. Raises InputError."""
    body, name = robots.load(robot), f"quadruped-{style}"
    legs, asked = quadruped_legs(body), gait_common.command(body, style, **commanded)
    half = cycle == "half"
    if half and (asked.pace.turn_rate or asked.pace.velocity[1]):
        raise InputError(
            f"{name} with cycle=half turns or moves sideways", "allowed: straight ahead, or cycle=full"
        )
    mirror, ground = legs.mirror if half else None, FlatGround(friction=friction)
    schedule = _cycle(asked.gait, asked.period, mirror, free=durations == "free")
    plan = plan_of_cycle(body, schedule, asked.pace, mirror=mirror, clearance=HIGHER * asked.lift)
    schedule = plan.schedule if footholds == "planned" else schedule
    feet = asked.gait.feet
    arcs = swing_arcs(
        schedule,
        feet,
        height=asked.lift,
        terrain=ground,
        next_name=mirror or dict(zip(feet, feet, strict=True)),
    )
    return Problem(
        name=name,
        robot=body,
        schedule=schedule,
        terrain=ground,
        initial_q=body.reference,
        initial_v=np.zeros(body.nv),
        terms=(*gait_terms(goal, body, schedule, asked.pace, ground, effort_share), *arcs),
        guess=plan.guess,
        parameters=asked.parameters,
        default_intervals=INTERVALS // 2 if half else INTERVALS,
        periodicity=_periodicity(body, asked.pace, schedule.duration, mirrored=half),
        duration_bounds=(schedule.duration, schedule.duration) if durations == "free" else None,
    )


def _family(style: str) -> Family:
    own = STYLES[style]
    return Family(
        name=f"quadruped-{style}",
        robots=ROBOTS[:1] if style in RARE else ROBOTS,
        phases=tuple(phase.name for phase in QUADRUPED[style].phases(1.0)),
        summary=f"{style}, periodic at a commanded speed: {own.summary}",
        parameters=(
            gait_common.speed("speed", None, f"forward (default: Froude number {own.froude:g})"),
            gait_common.speed("lateral", 0.0, "to the left"),
            gait_common.turn_rate(),
            gait_common.period(),
            gait_common.duty(style),
            _CYCLE if style in SYMMETRIC else _FULL,
            _DURATIONS,
            _FOOTHOLDS,
            gait_common.goal(),
            gait_common.clearance(),
            common.friction(0.7),
            common.effort_share(),
        ),
        build=partial(build, style=style),
    )


_CYCLE = Choice(
    name="cycle",
    default="full",
    choices=("full", "half"),
    meaning="solve a whole cycle, or half of one whose mirror image is the other half",
)
_FULL = Choice(name="cycle", default="full", choices=("full",), meaning="solve a whole cycle")
_DURATIONS = Choice(
    name="durations",
    default="fixed",
    choices=("fixed", "free"),
    meaning="shares of the phases in the period",
)
_FOOTHOLDS = Choice(
    name="footholds",
    default="free",
    choices=("free", "planned"),
    meaning="feet land anywhere on the ground, or under the hips in mid stance",
)
FAMILIES = tuple(_family(style) for style in STYLES)
