"""Gaits of quadrupeds as periodic orbits at a commanded speed: trot, pace, walk, bound, pronk and gallop.

One cycle (or half of one, where the other half is its mirror image) from a touchdown on; the final state is
the initial one moved by the commanded way. Feet land anywhere on the ground.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

import robots
from problems import common
from trajopt.errors import InputError
from trajopt.family import Choice, Family, Parameter
from trajopt.gaits import Gait
from trajopt.legs import quadruped_legs
from trajopt.model_quantities import gravity_of
from trajopt.named_gaits import QUADRUPED, gait_of
from trajopt.objectives import REST, goal_terms
from trajopt.periodicity import Periodicity
from trajopt.problem import Problem
from trajopt.reduced.gait_guess import Pace, commanded_motion, periodic_footholds, periodic_guess
from trajopt.robot import Robot
from trajopt.schedule import FlatGround, Schedule
from trajopt.swing_terms import swing_arcs
from trajopt.terms import FrictionPyramid, PositionLimits, Term, VelocityLimits
from trajopt.tracking import TrackingCost

ROBOTS = ("solo12", "go2", "anymal_c", "a1", "hyq")
# Least height of a foot in mid swing, and that of the guess, as parts of the robot's length.
CLEARANCE = 0.1
GUESS_CLEARANCE = 0.15
# Price of the base's distance from the commanded motion: a tenth of that of torques.
TRACKING = 0.1
# Free durations are between these parts of the nominal ones; their sum, the period, is not free.
FREE = (0.6, 1.5)
INTERVALS = 32


@dataclass(frozen=True, kw_only=True)
class Style:
    """What a gait's family takes by default: ``froude`` number u^2 / (g l) of its speed u, and its strides.

    Strides of mammals are ``stride`` froude^``growth`` leg lengths long (Alexander, Jayes, "A dynamic
    similarity hypothesis for the gaits of quadrupedal mammals", J. Zool. 201, 1983): 2.4 froude^0.34 in
    symmetrical gaits and 1.9 froude^0.40 in asymmetrical ones.
    """

    froude: float
    stride: float = 2.4
    growth: float = 0.34
    summary: str = ""

    def speed(self, robot: Robot) -> float:
        """Default speed, m/s."""
        return math.sqrt(self.froude * gravity_of(robot.model) * robot.length)

    def period(self, robot: Robot, speed: float) -> float:
        """Period in s at ``speed`` m/s: the stride's length over it; a slower gait keeps the default's."""
        unit = math.sqrt(gravity_of(robot.model) * robot.length)
        root = max(abs(speed) / unit, math.sqrt(self.froude))
        return self.stride * root ** (2 * self.growth - 1) * robot.length / unit


STYLES = {
    "trot": Style(froude=0.16, summary="diagonal legs together"),
    "pace": Style(froude=0.09, summary="legs of a side together"),
    "walk": Style(
        froude=0.06, summary="one leg after the other, lateral sequence, two or three on the ground"
    ),
    "bound": Style(froude=0.25, stride=1.9, growth=0.40, summary="hind legs, flight, fore legs, flight"),
    "pronk": Style(froude=0.09, stride=1.9, growth=0.40, summary="all legs together, then flight"),
    "gallop": Style(
        froude=0.64, stride=1.9, growth=0.40, summary="transverse, one leg after the other, two flights"
    ),
}
SYMMETRIC = ("trot", "pace", "walk")


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


def gait_terms(
    goal: str, robot: Robot, schedule: Schedule, pace: Pace, ground: FlatGround, effort_share: float
) -> tuple[Term, ...]:
    """Costs and limits of a gait: its goal, and a base near the commanded motion."""
    way = math.hypot(*pace.velocity) * abs(pace.progress(schedule.duration))
    share = 1.0 if goal == "effort" else REST
    return (
        *goal_terms(goal, robot, schedule, travel=way if goal == "transport" else None),
        TrackingCost(reference=commanded_motion(robot, pace), part="base", weight=share * TRACKING),
        common.share_of_effort(robot, effort_share),
        PositionLimits(),
        VelocityLimits(),
        FrictionPyramid(friction=ground.friction),
    )


def build(
    *,
    style: str,
    robot: str,
    speed: float | None,
    lateral: float,
    turn_rate: float,
    period: float | None,
    duty: float | None,
    cycle: str,
    durations: str,
    footholds: str,
    goal: str,
    clearance: float | None,
    friction: float,
    effort_share: float,
) -> Problem:
    """Build one periodic gait; see ``FAMILIES`` for the parameters. Raises InputError."""
    body, own = robots.load(robot), STYLES[style]
    legs, name = quadruped_legs(body), f"quadruped-{style}"
    gait = gait_of(body, style)
    gait = gait if duty is None else gait.with_duty(duty)
    speed = own.speed(body) if speed is None else speed
    period = own.period(body, math.hypot(speed, lateral)) if period is None else period
    pace = Pace(velocity=(speed, lateral), turn_rate=turn_rate)
    half = cycle == "half"
    if half and (turn_rate or lateral):
        raise InputError(
            f"{name} with cycle=half turns or moves sideways", "allowed: straight ahead, or cycle=full"
        )
    mirror = legs.mirror if half else None
    schedule = _cycle(gait, period, mirror, free=durations == "free")
    ground = FlatGround(friction=friction)
    lift = CLEARANCE * body.length if clearance is None else clearance
    guess = periodic_guess(body, schedule, pace, mirror=mirror, clearance=lift * GUESS_CLEARANCE / CLEARANCE)
    if footholds == "planned":
        schedule = periodic_footholds(body, schedule, pace, mirror=mirror)
    images = mirror or {foot: foot for foot in gait.feet}
    return Problem(
        name=name,
        robot=body,
        schedule=schedule,
        terrain=ground,
        initial_q=body.reference,
        initial_v=np.zeros(body.nv),
        terms=(
            *gait_terms(goal, body, schedule, pace, ground, effort_share),
            *swing_arcs(schedule, gait.feet, height=lift, terrain=ground, next_name=images),
        ),
        guess=guess,
        parameters={"speed": speed, "period": period, "clearance": lift},
        default_intervals=INTERVALS // 2 if half else INTERVALS,
        periodicity=_periodicity(body, pace, schedule.duration, mirrored=half),
        duration_bounds=(schedule.duration, schedule.duration) if durations == "free" else None,
    )


def _speed(name: str, default: float | None, meaning: str) -> Parameter:
    return Parameter(name=name, default=default, unit="m/s", lower=-10.0, upper=10.0, meaning=meaning)


def _duty(style: str) -> float:
    gait = QUADRUPED[style]
    return gait.duty_of(gait.feet[0])


def _family(style: str) -> Family:
    gait = STYLES[style]
    return Family(
        name=f"quadruped-{style}",
        robots=ROBOTS,
        phases=("double_1", "..."),
        summary=f"{style}, periodic at a commanded speed: {gait.summary}",
        parameters=(
            _speed("speed", None, f"forward (default: Froude number {gait.froude:g})"),
            _speed("lateral", 0.0, "to the left"),
            Parameter(
                name="turn_rate", default=0.0, unit="rad/s", lower=-5.0, upper=5.0, meaning="to the left"
            ),
            common.duration(
                "period", None, "duration of a cycle (default: by length and speed)", (0.02, 20.0)
            ),
            Parameter(
                name="duty",
                default=None,
                unit="",
                lower=0.05,
                upper=0.95,
                meaning=f"stance of a foot as part of the period (default: {_duty(style):g})",
            ),
            *((_CYCLE,) if style in SYMMETRIC else (_FULL,)),
            _DURATIONS,
            _FOOTHOLDS,
            _GOAL,
            Parameter(
                name="clearance",
                default=None,
                unit="m",
                lower=0.0,
                upper=1.0,
                meaning="least height of a foot in mid swing (default: a tenth of the robot's length)",
            ),
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
_GOAL = Choice(
    name="goal",
    default="effort",
    choices=("effort", "transport", "smooth"),
    meaning="least torques, cost of transport or accelerations",
)
FAMILIES = tuple(_family(style) for style in STYLES)
