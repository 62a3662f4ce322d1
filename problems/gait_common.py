"""What gaits of quadrupeds share: their speeds and periods by the robot's size, costs, limits, parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass

from trajopt.dynamics.model_quantities import gravity_of
from trajopt.problem.family import Choice, Parameter
from trajopt.reduced.gait_guess import Pace, commanded_motion
from trajopt.robot.robot import Robot
from trajopt.schedule.gaits import Gait
from trajopt.schedule.named_gaits import QUADRUPED, gait_of
from trajopt.schedule.schedule import Schedule
from trajopt.terms import FrictionPyramid, PositionLimits, Term, TrackingCost, VelocityLimits, goal_terms
from trajopt.terms.objectives import REST
from trajopt.terrain.flat import FlatGround

from . import common

ROBOTS = ("solo12", "go2", "anymal_c", "a1", "hyq")
# Least height of a foot in mid swing as a part of the robot's length; swings of the guess are higher.
CLEARANCE = 0.1
HIGHER = 1.5
# Price of the base's distance from the commanded motion: a tenth of that of torques.
TRACKING = 0.1


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
    "walk": Style(
        froude=0.06, summary="one leg after the other, lateral sequence, two or three on the ground"
    ),
    "amble": Style(froude=0.16, summary="footfalls of the walk, one or two legs on the ground"),
    "trot": Style(froude=0.16, summary="diagonal legs together"),
    "flying-trot": Style(froude=0.25, summary="diagonal legs together, flight between"),
    "pace": Style(froude=0.09, summary="legs of a side together"),
    "bound": Style(froude=0.25, stride=1.9, growth=0.40, summary="hind legs, flight, fore legs, flight"),
    "pronk": Style(froude=0.09, stride=1.9, growth=0.40, summary="all legs together, then flight"),
    "canter": Style(froude=0.36, stride=1.9, growth=0.40, summary="three beats, left lead, one flight"),
    "gallop": Style(froude=0.49, stride=1.9, growth=0.40, summary="transverse, two flights"),
    "rotary-gallop": Style(
        froude=0.49, stride=1.9, growth=0.40, summary="footfalls round the body, two flights"
    ),
}
# Gaits that the suite runs on one robot only; they run on all.
RARE = ("amble", "flying-trot", "canter", "rotary-gallop")


@dataclass(frozen=True, kw_only=True)
class Command:
    """A gait of a robot with every default filled in: ``period`` s, ``pace``, ``lift`` of swings in m."""

    gait: Gait
    period: float
    pace: Pace
    lift: float

    @property
    def parameters(self) -> dict[str, object]:
        """Values of the parameters that were derived."""
        return {"speed": self.pace.velocity[0], "period": self.period, "clearance": self.lift}


def command(
    robot: Robot,
    style: str,
    *,
    speed: float | None,
    lateral: float,
    turn_rate: float,
    period: float | None,
    duty: float | None,
    clearance: float | None,
) -> Command:
    """The gait of a ``style`` with these parameters of a family, None for its default. Raises InputError."""
    own, gait = STYLES[style], gait_of(robot, style)
    speed = own.speed(robot) if speed is None else speed
    return Command(
        gait=gait if duty is None else gait.with_duty(duty),
        period=own.period(robot, math.hypot(speed, lateral)) if period is None else period,
        pace=Pace(velocity=(speed, lateral), turn_rate=turn_rate),
        lift=CLEARANCE * robot.length if clearance is None else clearance,
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


def speed(name: str, default: float | None, meaning: str) -> Parameter:
    """A commanded velocity of the base, m/s."""
    return Parameter(name=name, default=default, unit="m/s", lower=-10.0, upper=10.0, meaning=meaning)


def turn_rate() -> Parameter:
    """A commanded rate of the base about the vertical, rad/s."""
    return Parameter(
        name="turn_rate", default=0.0, unit="rad/s", lower=-5.0, upper=5.0, meaning="to the left"
    )


def period() -> Parameter:
    """Duration of a cycle, s."""
    return common.duration("period", None, "duration of a cycle (default: by length and speed)", (0.02, 20.0))


def duty(style: str | None = None) -> Parameter:
    """Duty factor of all feet."""
    meaning = "the gait's own"
    if style is not None:
        gait = QUADRUPED[style]
        meaning = f"{gait.duty_of(gait.feet[0]):g}"
    return Parameter(
        name="duty",
        default=None,
        unit="",
        lower=0.05,
        upper=0.95,
        meaning=f"stance of a foot as part of the period (default: {meaning})",
    )


def clearance() -> Parameter:
    """Height of swings, m."""
    return Parameter(
        name="clearance",
        default=None,
        unit="m",
        lower=0.0,
        upper=1.0,
        meaning="least height of a foot in mid swing (default: a tenth of the robot's length)",
    )


def goal() -> Choice:
    """What is to be least."""
    return Choice(
        name="goal",
        default="effort",
        choices=("effort", "transport", "smooth"),
        meaning="least torques, cost of transport or accelerations",
    )
