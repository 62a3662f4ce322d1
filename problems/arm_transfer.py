"""An arm moves between two postures, from rest to rest, in least time or with least torque."""

import math
from typing import Any

import numpy as np

from trajopt.errors import InputError
from trajopt.problem import Family, Problem
from trajopt.robot import Robot
from trajopt.terms import AccelerationCost, Term, TimeCost, TorqueCost

from . import arms, common

# Weights of accelerations, which give every direction of the motion a cost. They are small compared with
# torques (mean squares of about 1e-2 of weight times reach) and with a transfer of about one sqrt(l / g).
SMOOTH_EFFORT, SMOOTH_TIME = 1e-2, 1e-4
# Least-time torques jump between limits. A one-point scheme has constant torques in an interval, which are
# within limits if they are at the point; a polynomial through two points overshoots at the nodes. Least time
# therefore uses one point and twice the intervals.
INTERVALS = 30
# Bounds of a free duration, as multiples of the guessed one.
SHORTEST, LONGEST = 0.1, 4.0
# Default duration for least effort over the least duration estimated from the limits.
UNHURRIED = 2.0


def transfer(
    name: str,
    robot: Robot,
    ends: tuple[np.ndarray, np.ndarray],
    *,
    goal: str,
    duration: float | None,
    least: float,
    effort: tuple[Term, ...],
    intervals: int = INTERVALS,
    parameters: dict[str, Any] | None = None,
    actuation: str = "torque",
) -> Problem:
    """From rest to rest between two postures (nq,), in least time or at the costs of ``effort``.

    duration: s, None: from ``least``, estimated from the limits. Raises InputError if both are the same.
    """
    if not least > 0:
        raise InputError(f"start and goal of {name} are the same posture", "allowed: two postures")
    fast = goal == "time"
    given = duration or (least if fast else UNHURRIED * least)
    return arms.between(
        name,
        robot,
        ends,
        given,
        phase="transfer",
        bounds=(SHORTEST * given, LONGEST * given) if fast else None,
        costs=(TimeCost(weight=1.0), AccelerationCost(weight=SMOOTH_TIME)) if fast else effort,
        torques=arms.torque_limits(robot),
        parameters={"duration": given} | (parameters or {}),
        default_intervals=2 * intervals if fast else intervals,
        default_transcription="legendre:1" if fast else "legendre:2",
        actuation=actuation,
        goal=goal,
    )


def build(
    *, robot: str, goal: str, turn: float, out: float, up: float, duration: float | None, actuation: str
) -> Problem:
    """Build the transfer; see ``FAMILY`` for the parameters. Raises InputError."""
    arm = arms.load(robot)
    start, end = (arm.posture(side * turn / 2, side * out / 2, side * up / 2) for side in (-1, 1))
    return transfer(
        "arm-transfer",
        arm.robot,
        (start, end),
        goal=goal,
        duration=duration,
        least=arms.least_duration(arm.robot, (start, end)),
        effort=(TorqueCost(weight=1.0), AccelerationCost(weight=SMOOTH_EFFORT)),
        actuation=actuation,
    )


FAMILY = Family(
    name="arm-transfer",
    robots=arms.ARMS,
    phases=("transfer",),
    summary="move an arm between two postures, from rest to rest, in least time or with least torque",
    parameters=(
        common.goal("time", "effort", meaning="objective: time or torques"),
        common.angle("turn", math.radians(90), "angle about the base, start to goal", (-math.pi, math.pi)),
        arms.part("out", 0.1, "outward distance from start to goal"),
        arms.part("up", 0.2, "upward distance from start to goal"),
        common.duration(
            "duration",
            None,
            "duration, with goal=time its guess (default: estimated from the limits)",
            (1e-3, 60.0),
        ),
        common.ACTUATION,
    ),
    build=build,
    variants=arms.VARIANTS,
)
