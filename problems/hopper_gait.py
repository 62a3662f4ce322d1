"""Hopping on one leg as a periodic orbit at a commanded speed: from touchdown to touchdown."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trajopt.dynamics.model_quantities import gravity_of
from trajopt.problem.family import Choice, Family, Parameter
from trajopt.problem.periodicity import Periodicity
from trajopt.problem.problem import Problem
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.terms import FrictionPyramid, PositionLimits, SwingClearance, VelocityLimits, goal_terms
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.swing_profile import smooth_step

from . import common, hoppers

# Speed by default as a Froude number u^2 / (g l), and a stride's length in leg lengths as of animals:
# 1.9 froude^0.40 (Alexander, Jayes, "A dynamic similarity hypothesis for the gaits of quadrupedal mammals",
# J. Zool. 201, 1983, asymmetrical gaits, which hops of kangaroos follow as well).
FROUDE = 0.25
STRIDE, GROWTH = 1.9, 0.40
# Stance as a part of the period.
DUTY = 0.5
# Least height of the foot in mid flight as a part of the robot's length.
CLEARANCE = 0.05
# Free durations are between these parts of the nominal ones.
FREE = (0.5, 2.0)
INTERVALS = 24


@dataclass(frozen=True)
class _Guess:
    """The base at an even speed, ballistic in flight; the foot under it in mid stance, the neutral point.

    ``durations`` of stance and flight, s; ``lift``: height of the foot in mid flight over where the leg
    of constant height would have it, m.
    """

    robot: Robot
    speed: float
    durations: tuple[float, float]
    lift: float

    def __call__(self, t: float) -> np.ndarray:
        stance, flight = self.durations
        cycle, since = divmod(t, stance + flight)
        step = self.speed * (stance + flight)
        rate = gravity_of(self.robot.model) * flight / 2
        forward = self.speed * t
        ahead = np.array([cycle * step + self.speed * stance / 2, 0.0, 0.0])
        foot = hoppers.standing_foot(self.robot) + ahead
        if since < stance:
            up = float(common.hermite(since / stance, stance, 0.0, -rate, 0.0, rate))
            return hoppers.posture(self.robot, forward, up, foot)
        s = (since - stance) / flight
        up = rate * flight * s * (1 - s)
        swing = np.array([smooth_step(s) * step, 0.0, up + self.lift * 4 * s * (1 - s)])
        return hoppers.posture(self.robot, forward, up, foot + swing)


def _period(robot: Robot, speed: float) -> float:
    """Duration of a stride at ``speed`` m/s, s; a slower gait keeps that of the default speed."""
    unit = gravity_of(robot.model) * robot.length
    froude = max(speed**2 / unit, FROUDE)
    return STRIDE * froude**GROWTH * robot.length / math.sqrt(froude * unit)


def _schedule(foot: str, durations: tuple[float, float], *, free: bool) -> Schedule:
    bounds = [(FREE[0] * duration, FREE[1] * duration) if free else None for duration in durations]
    return Schedule(
        (
            Phase(name="stance", duration=durations[0], contacts=(foot,), duration_bounds=bounds[0]),
            Phase(name="flight", duration=durations[1], duration_bounds=bounds[1]),
        )
    )


def build(
    *,
    robot: str,
    speed: float | None,
    period: float | None,
    duty: float,
    durations: str,
    goal: str,
    friction: float,
    effort_share: float,
) -> Problem:
    """Build one cycle; see ``FAMILY`` for the parameters. Raises InputError."""
    own = hoppers.hopper(robot)
    speed = math.sqrt(FROUDE * gravity_of(own.model) * own.length) if speed is None else speed
    period = _period(own, speed) if period is None else period
    times = (duty * period, (1 - duty) * period)
    schedule = _schedule(hoppers.foot_of(own), times, free=durations == "free")
    ground = FlatGround(friction=friction)
    return Problem(
        name="hopper-gait",
        robot=own,
        schedule=schedule,
        terrain=ground,
        initial_q=own.reference,
        initial_v=np.zeros(own.nv),
        terms=(
            *goal_terms(goal, own, schedule, travel=abs(speed) * period),
            common.share_of_effort(own, effort_share),
            PositionLimits(),
            VelocityLimits(),
            FrictionPyramid(),
            SwingClearance(height=CLEARANCE * own.length, terrain=ground),
        ),
        guess=_Guess(own, speed, times, CLEARANCE * own.length),
        parameters={"speed": speed, "period": period},
        default_intervals=INTERVALS,
        periodicity=Periodicity(velocity=(speed, 0.0, 0.0)),
    )


FAMILY = Family(
    name="hopper-gait",
    robots=hoppers.ROBOTS,
    phases=("stance", "flight"),
    summary="hopping on one leg, periodic at a commanded speed",
    parameters=(
        Parameter(
            name="speed",
            default=None,
            unit="m/s",
            lower=-10.0,
            upper=10.0,
            meaning=f"forward (default: Froude number {FROUDE:g})",
        ),
        common.duration("period", None, "duration of a hop (default: by length and speed)", (0.02, 20.0)),
        Parameter(
            name="duty",
            default=DUTY,
            unit="",
            lower=0.05,
            upper=0.95,
            meaning="stance as part of the period",
        ),
        Choice(
            name="durations", default="fixed", choices=("fixed", "free"), meaning="of stance and of flight"
        ),
        common.goal("effort", "transport", "smooth"),
        common.friction(0.7),
        common.effort_share(),
    ),
    build=build,
)
