"""An arm moves between two postures, from rest to rest, in least time or with least torque."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from trajopt.errors import InputError
from trajopt.problem.family import Choice, Family, Parameter
from trajopt.problem.problem import Problem
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.terms import AccelerationCost, Term, TerminalRest, TerminalState, TimeCost, TorqueCost
from trajopt.terrain.flat import FlatGround

from . import arms, common

GOALS = ("time", "effort")
# Weights of what makes every direction of the motion priced: small against torques (mean squares of about
# 1e-2 of weight times reach), and against a transfer of about one sqrt(l / g).
SMOOTH_EFFORT, SMOOTH_TIME = 1e-2, 1e-4
# Torques of least time jump between limits. A scheme of one point has constant torques in an interval,
# within limits wherever they are at the point; a polynomial through two points overshoots at the nodes.
_TRANSCRIPTIONS: dict[str, dict[str, Any]] = {
    "effort": {"default_intervals": 30, "default_transcription": "legendre:2"},
    "time": {"default_intervals": 60, "default_transcription": "legendre:1"},
}
# A free duration lies within these multiples of the guessed one.
SHORTEST, LONGEST = 0.1, 4.0
# The default duration of least effort over what the limits need at least.
UNHURRIED = 2.0


def build(*, robot: str, goal: str, turn: float, out: float, up: float, duration: float | None) -> Problem:
    """Build the transfer; see ``FAMILY`` for the parameters. Raises InputError."""
    arm = arms.load(robot)
    start, end = (arm.posture(side * turn / 2, side * out / 2, side * up / 2) for side in (-1, 1))
    least = arms.least_duration(arm.robot, (start, end))
    if not least > 0:
        raise InputError("start and goal of arm-transfer are the same posture", "allowed: turn, out or up")
    given = duration or (least if goal == "time" else UNHURRIED * least)
    bounds = (SHORTEST * given, LONGEST * given) if goal == "time" else None
    return Problem(
        name="arm-transfer",
        robot=arm.robot,
        schedule=Schedule((Phase(name="transfer", duration=given, duration_bounds=bounds),)),
        terrain=FlatGround(),
        initial_q=start,
        initial_v=np.zeros(arm.robot.nv),
        terms=(
            *_priced(goal),
            *arms.limits(arm.robot),
            TerminalState(q=end),
            TerminalRest(q=end),
        ),
        guess=arms.ArmPath(model=arm.robot.model, start=start, end=end, duration=given),
        parameters={"duration": given},
        **_TRANSCRIPTIONS[goal],
    )


def _priced(goal: str) -> tuple[Term, ...]:
    if goal == "time":
        return (TimeCost(weight=1.0), AccelerationCost(weight=SMOOTH_TIME))
    return (TorqueCost(weight=1.0), AccelerationCost(weight=SMOOTH_EFFORT))


def _part(name: str, default: float, meaning: str) -> Parameter:
    return Parameter(
        name=name, default=default, unit="", lower=-1.0, upper=1.0, meaning=f"{meaning}, part of the reach"
    )


FAMILY = Family(
    name="arm-transfer",
    robots=arms.ARMS,
    phases=("transfer",),
    summary="move an arm between two postures, from rest to rest, in least time or with least torque",
    parameters=(
        Choice(name="goal", default="time", choices=GOALS, meaning="duration, or torques"),
        common.angle("turn", math.radians(90), "of the tool about the base", (-math.pi, math.pi)),
        _part("out", 0.1, "by how much the goal is farther from the base's axis"),
        _part("up", 0.2, "by how much the goal is higher"),
        common.duration(
            "duration",
            None,
            "duration (default: twice what the limits need; for least time its guess, what they need)",
            (1e-3, 60.0),
        ),
    ),
    build=build,
)
