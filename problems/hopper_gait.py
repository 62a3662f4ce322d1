"""Hopping on one leg as a periodic orbit at a commanded speed: from touchdown to touchdown."""

from functools import partial

import numpy as np

from trajopt.dynamics import gravity_of
from trajopt.problem import Family, Periodicity, Problem
from trajopt.robot import Robot
from trajopt.terms import goal_terms
from trajopt.terrain import smooth_step

from . import common, hoppers
from .gait_common import Style, forward

# Stride lengths as in asymmetrical gaits of animals, including hops of kangaroos.
STYLE = Style(froude=0.25, stride=1.9, growth=0.40, clearance=0.05)
# Bounds of free durations as multiples of the nominal ones.
FREE = (0.5, 2.0)
INTERVALS = 24


def _guess(robot: Robot, speed: float, durations: tuple[float, float], lift: float, t: float) -> np.ndarray:
    """Return the guess: base at constant speed, ballistic in flight, foot under it at mid-stance.

    durations: of stance and flight, s. lift: height of the foot in mid-flight above its position on a leg of
    constant length, m.
    """
    stance, flight = durations
    step, rate = speed * (stance + flight), gravity_of(robot.model) * flight / 2
    cycle, since = divmod(t, stance + flight)
    foot = hoppers.standing_foot(robot) + np.array([cycle * step + speed * stance / 2, 0.0, 0.0])
    if since < stance:
        up = float(common.hermite(since / stance, stance, 0.0, -rate, 0.0, rate))
        return hoppers.posture(robot, speed * t, up, foot)
    s = (since - stance) / flight
    up = rate * flight * s * (1 - s)
    swing = np.array([smooth_step(s) * step, 0.0, up + lift * 4 * s * (1 - s)])
    return hoppers.posture(robot, speed * t, up, foot + swing)


def build(
    *,
    robot: str,
    speed: float | None,
    period: float | None,
    duty: float,
    durations: str,
    goal: str,
    **limits: float,
) -> Problem:
    """Build one cycle; see ``FAMILY`` for the parameters. Raises InputError."""
    body = hoppers.hopper(robot)
    speed = STYLE.speed(body) if speed is None else speed
    period = STYLE.period(body, speed) if period is None else period
    times, lift = (duty * period, (1 - duty) * period), STYLE.clearance * body.length
    named = dict(zip(("stance", "flight"), times, strict=True))
    schedule = common.schedule_of(named, ((hoppers.foot_of(body),), ()))
    schedule = common.freed(schedule, FREE) if durations == "free" else schedule
    return common.problem(
        "hopper-gait",
        body,
        schedule,
        partial(_guess, body, speed, times, lift),
        costs=goal_terms(goal, body, schedule, travel=abs(speed) * period),
        clearance=lift,
        end=(),
        parameters={"speed": speed, "period": period},
        default_intervals=INTERVALS,
        **limits,
        periodicity=Periodicity(velocity=(speed, 0.0, 0.0)),
    )


FAMILY = Family(
    name="hopper-gait",
    robots=hoppers.ROBOTS,
    phases=("stance", "flight"),
    summary="hop on one leg, periodic at a commanded speed",
    parameters=(
        forward(STYLE),
        common.duration("period", None, "duration of a hop (default: from length and speed)", (0.02, 20.0)),
        common.share("duty", 0.5, "duty factor"),
        common.choice("durations", "durations of stance and flight", "fixed", "free"),
        common.goal("effort", "transport", "smooth"),
        common.friction(0.7),
        common.TORQUE_SHARE,
    ),
    build=build,
)
