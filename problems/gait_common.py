"""Shared by the gaits: speeds and periods from the robot's size, costs, periodic problems, parameters."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from trajopt.dynamics import gravity_of
from trajopt.problem import Parameter, Problem
from trajopt.reduced import Pace, commanded_motion, plan_of_cycle
from trajopt.robot import EDGES, Robot, edge_contacts, with_edges
from trajopt.schedule import Gait, Motion, Schedule, rolled, stride_period
from trajopt.terms import REST, Term, TrackingCost, goal_terms, swing_arcs
from trajopt.terrain import FlatGround

from . import common

ROBOTS = ("solo12", "go2", "anymal_c", "a1", "hyq")
# Swing height of the guess over the required one.
HIGHER = 1.5
# Bounds of free durations as multiples of the nominal ones; their sum, the period, is fixed.
FREE = (0.6, 1.5)
# Fractions of a stance on heel and toe.
Rolls = tuple[float, float]
# Intervals of a full cycle.
INTERVALS = 32
# Weight of the base's deviation from the commanded motion: a tenth of the weight of torques.
TRACKING = 0.1


@dataclass(frozen=True, kw_only=True)
class Style:
    """Defaults of a gait: ``froude`` number u^2 / (g l) of its speed u, and its strides.

    ``clearance``: least height of a foot in mid-swing over the robot's length.

    Strides of mammals are ``stride`` froude^``growth`` leg lengths long (Alexander, Jayes, "A dynamic
    similarity hypothesis for the gaits of quadrupedal mammals", J. Zool. 201, 1983): 2.4 froude^0.34 in
    symmetrical gaits and 1.9 froude^0.40 in asymmetrical ones.
    """

    froude: float
    stride: float = 2.4
    growth: float = 0.34
    clearance: float = 0.1
    summary: str = ""

    def speed(self, robot: Robot) -> float:
        """Default speed, m/s."""
        return math.sqrt(self.froude * gravity_of(robot.model) * robot.length)

    def period(self, robot: Robot, speed: float) -> float:
        """Period in s at ``speed`` m/s: stride length over speed; a slower gait keeps the default period."""
        return stride_period(robot, speed, stride=self.stride, growth=self.growth, slowest=self.froude)


STYLES = {
    "walk": Style(
        froude=0.06, summary="one leg after the other in lateral sequence, two or three on the ground"
    ),
    "amble": Style(froude=0.16, summary="footfalls of the walk, one or two legs on the ground"),
    "trot": Style(froude=0.16, summary="diagonal legs together"),
    "flying-trot": Style(froude=0.25, summary="diagonal legs together, flight between"),
    "pace": Style(froude=0.09, summary="legs of one side together"),
    "bound": Style(froude=0.25, stride=1.9, growth=0.40, summary="hind legs, flight, fore legs, flight"),
    "pronk": Style(froude=0.09, stride=1.9, growth=0.40, summary="all legs together, then flight"),
    "canter": Style(froude=0.36, stride=1.9, growth=0.40, summary="three beats, left lead, one flight"),
    "gallop": Style(froude=0.49, stride=1.9, growth=0.40, summary="transverse footfalls, two flights"),
    "rotary-gallop": Style(froude=0.49, stride=1.9, growth=0.40, summary="rotary footfalls, two flights"),
}
# Gaits that the test suite runs on one robot only, although all robots can.
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
        """Values of the derived parameters."""
        return {"speed": self.pace.velocity[0], "period": self.period, "clearance": self.lift}


def command(
    robot: Robot,
    style: Style,
    gait: Gait,
    *,
    speed: float | None = None,
    lateral: float = 0.0,
    turn_rate: float = 0.0,
    period: float | None = None,
    duty: float | None = None,
    clearance: float | None = None,
) -> Command:
    """A ``gait`` in a ``style`` with these parameters, None for their defaults. Raises InputError."""
    speed = style.speed(robot) if speed is None else speed
    return Command(
        gait=gait if duty is None else gait.with_duty(duty),
        period=style.period(robot, math.hypot(speed, lateral)) if period is None else period,
        pace=Pace(velocity=(speed, lateral), turn_rate=turn_rate),
        lift=style.clearance * robot.length if clearance is None else clearance,
    )


def corner_images(images: Mapping[str, str], *, mirrored: bool) -> dict[str, str]:
    """The corner whose motion each corner of a sole continues, from that of the soles."""
    return {
        corner: image
        for sole, other in images.items()
        for edge in EDGES
        for corner, image in zip(
            edge_contacts(sole, edge), edge_contacts(other, edge)[:: -1 if mirrored else 1], strict=True
        )
    }


def near(motion: Motion, weight: float = TRACKING) -> Term:
    """Cost on the distance of the base, which has no other cost, from that of a motion."""
    return TrackingCost(reference=motion, part="base", weight=weight)


def gait_costs(goal: str, robot: Robot, schedule: Schedule, pace: Pace) -> tuple[Term, ...]:
    """Costs of a gait: its goal, and a base near the commanded motion."""
    way = math.hypot(*pace.velocity) * abs(pace.progress(schedule.duration))
    share = 1.0 if goal == "effort" else REST
    return (
        *goal_terms(goal, robot, schedule, travel=way if goal == "transport" else None),
        near(commanded_motion(robot, pace), share * TRACKING),
    )


def cycle(asked: Command, mirror: Mapping[str, str] | None, *, free: bool = False) -> Schedule:
    """One period, or half of it with its image under ``mirror`` to follow; ``free``: free durations."""
    bounds = FREE if free else None
    if mirror is None:
        return Schedule(asked.gait.phases(asked.period, duration_bounds=bounds))
    return Schedule(asked.gait.half_cycle(asked.period, mirror, duration_bounds=bounds))


def periodic_problem(
    name: str,
    robot: Robot,
    asked: Command,
    schedule: Schedule,
    *,
    mirror: Mapping[str, str] | None,
    swing: float,
    goal: str = "effort",
    planned: bool = False,
    rolls: Rolls | None = None,
    **settings: Any,
) -> Problem:
    """A periodic gait through a `cycle`; see `common.problem`.

    swing: height of swings of the guess, m. planned: feet land on planned footholds, not anywhere. rolls:
    parts of a stance on heel and toe, None for feet that stay flat, as those of the guess always do.
    """
    plan = plan_of_cycle(robot, schedule, asked.pace, mirror=mirror, clearance=swing)
    schedule = plan.schedule if planned else schedule
    images = mirror or {foot: foot for foot in asked.gait.feet}
    feet = asked.gait.feet
    if rolls is not None:
        schedule = rolled(schedule, asked.gait.feet, heel=rolls[0], toe=rolls[1], next_name=images)
        robot, images = with_edges(robot), corner_images(images, mirrored=mirror is not None)
        feet = tuple(images)
    return common.problem(
        name,
        robot,
        schedule,
        plan.guess,
        costs=gait_costs(goal, robot, schedule, asked.pace),
        more=swing_arcs(schedule, feet, height=asked.lift, terrain=FlatGround(), next_name=images),
        end=(),
        parameters=asked.parameters,
        default_intervals=INTERVALS if mirror is None else INTERVALS // 2,
        **settings,
    )


def forward(style: Style) -> Parameter:
    """The commanded velocity of the base forward, m/s."""
    return common.speed("speed", None, f"forward speed (default: Froude number {style.froude:g})")


def duty(gait: Gait | None = None) -> Parameter:
    """Duty factor of all feet."""
    default = "the gait's" if gait is None else f"{gait.duty_of(gait.feet[0]):g}"
    return common.share("duty", None, f"duty factor of each foot (default: {default})")


def clearance(part: str = "tenth") -> Parameter:
    """Height of swings, m."""
    meaning = f"least height of a foot in mid swing (default: a {part} of the robot's length)"
    return common.length("clearance", None, meaning, (0.0, 1.0))


TURN_RATE = common.number("turn_rate", 0.0, "rad/s", "yaw rate to the left", (-5.0, 5.0))
PERIOD = common.duration("period", None, "duration of a cycle (default: from length and speed)", (0.02, 20.0))
GOAL = common.goal(
    "effort", "transport", "smooth", meaning="objective: torques, cost of transport or accelerations"
)
