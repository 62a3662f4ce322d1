"""A transfer of the IRB 1600: rest to rest between two tool poses, with least effort or in least time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError
from trajopt.problem.family import Choice, Family, Parameter
from trajopt.problem.problem import Problem
from trajopt.robot.kinematics import inverse_kinematics_branches
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.terms import (
    AccelerationCost,
    DriveLimits,
    MotorTorqueCost,
    PositionLimits,
    Term,
    TerminalRest,
    TerminalState,
    TimeCost,
    VelocityLimits,
)
from trajopt.terrain.flat import FlatGround
from trajopt_library.robots import irb1600

from . import common

GOALS = ("effort", "time")
# Weights of what makes every direction of the motion priced: small against the motors' torques (mean
# squares of about 0.1), and against a transfer of about one sqrt(l / g).
SMOOTH_EFFORT, SMOOTH_TIME = 1e-3, 1e-4
# Torques of least time jump between limits. A scheme of one point has constant torques in an interval,
# within limits wherever they are at the point; a polynomial through two points overshoots at the nodes.
_TRANSCRIPTIONS: dict[str, dict[str, Any]] = {
    "effort": {"default_intervals": 40, "default_transcription": "legendre:2"},
    "time": {"default_intervals": 80, "default_transcription": "legendre:1"},
}
# A free duration lies within these multiples of the guessed one.
SHORTEST, LONGEST = 0.1, 4.0
# Peak rate and acceleration of the guess, 10 s^3 - 15 s^4 + 6 s^5, over a unit of time.
PEAK_RATE, PEAK_ACCELERATION = 1.875, 10 / math.sqrt(3)


def nearest_posture(robot: Robot, position: np.ndarray, tilt: float, near: np.ndarray) -> np.ndarray:
    """The branch (nq,) nearest to ``near`` that brings the tool to ``position`` (3,) m, world.

    The tool points away from the base's axis, turned down by ``tilt`` rad. Raises `InputError` where no
    posture within the limits does.
    """
    heading = math.atan2(position[1], position[0])
    rotation = pin.rpy.rpyToMatrix(0.0, math.pi / 2 + tilt, heading)
    branches = inverse_kinematics_branches(
        robot, {irb1600.TOOL: pin.SE3(rotation, np.asarray(position))}, near=near
    )
    if not branches:
        x, y, z = position
        raise InputError(
            f"the IRB 1600 cannot bring its tool to ({x:g}, {y:g}, {z:g}) m, tilted by {tilt:g} rad",
            "allowed: poses within reach (1.45 m from the base's axis to the wrist) and joint ranges",
        )
    return branches[0].q


def least_duration(robot: Robot, start: np.ndarray, end: np.ndarray) -> float:
    """Duration of the guess, s: what rates allow, and drives as if each joint moved its own inertia.

    An estimate for a start of the search, not a bound: gravity and coupling are left out.
    """
    travel = np.abs(end - start)
    inertia = np.diag(pin.crba(robot.model, robot.model.createData(), start))
    by_rate = PEAK_RATE * travel / robot.velocity_limit
    acceleration = (np.inf if robot.effort_limit is None else robot.effort_limit) / inertia
    by_torque = np.sqrt(PEAK_ACCELERATION * travel / acceleration)
    return float(max(by_rate.max(), by_torque.max()))


def build(
    *,
    minimise: str,
    duration: float | None,
    payload: float,
    motor_inertia: float,
    start_x: float,
    start_y: float,
    start_z: float,
    goal_x: float,
    goal_y: float,
    goal_z: float,
    tilt: float,
) -> Problem:
    """Build the transfer; see ``FAMILY`` for the parameters. Raises InputError."""
    robot = irb1600.build(payload=payload, motor_inertia=motor_inertia)
    start = nearest_posture(robot, np.array([start_x, start_y, start_z]), tilt, robot.reference)
    goal = nearest_posture(robot, np.array([goal_x, goal_y, goal_z]), tilt, start)
    guessed = least_duration(robot, start, goal)
    if not guessed > 0:
        raise InputError("start and goal of irb1600-transfer are the same pose", "allowed: two poses")
    given = duration if duration is not None else (guessed if minimise == "time" else 2 * guessed)
    return Problem(
        name="irb1600-transfer",
        robot=robot,
        schedule=Schedule((_phase(minimise, given),)),
        terrain=FlatGround(),
        initial_q=start,
        initial_v=np.zeros(robot.nv),
        terms=_terms(minimise, goal),
        guess=common.JointPath(start, goal, given),
        parameters={
            "minimise": minimise,
            "duration": given,
            "payload": payload,
            "motor_inertia": motor_inertia,
            "start": [start_x, start_y, start_z],
            "goal": [goal_x, goal_y, goal_z],
            "tilt": tilt,
        },
        **_TRANSCRIPTIONS[minimise],
    )


def _phase(minimise: str, duration: float) -> Phase:
    bounds = (SHORTEST * duration, LONGEST * duration) if minimise == "time" else None
    return Phase(name="transfer", duration=duration, duration_bounds=bounds)


def _terms(minimise: str, goal: np.ndarray) -> tuple[Term, ...]:
    priced: dict[str, tuple[Term, ...]] = {
        "effort": (MotorTorqueCost(weight=1.0), AccelerationCost(weight=SMOOTH_EFFORT)),
        "time": (TimeCost(weight=1.0), AccelerationCost(weight=SMOOTH_TIME)),
    }
    limits = (DriveLimits(), PositionLimits(), VelocityLimits())
    return (*priced[minimise], *limits, TerminalState(q=goal), TerminalRest(q=goal))


def _coordinate(name: str, default: float) -> Parameter:
    end, axis = name.split("_")
    return common.length(name, default, f"tool at the {end}, world {axis}", (-2.0, 2.5))


FAMILY = Family(
    name="irb1600-transfer",
    robot="irb1600",
    phases=("transfer",),
    summary="bring the tool from one pose to another, from rest to rest, with least effort or in least time",
    parameters=(
        Choice(name="minimise", default="effort", choices=GOALS, meaning="copper losses, or time"),
        common.duration(
            "duration",
            None,
            "duration (default: twice what the drives need; for least time, its guess)",
            (1e-2, 60.0),
        ),
        Parameter(
            name="payload", default=8.0, unit="kg", lower=0.0, upper=20.0, meaning="steel cube on the flange"
        ),
        Parameter(
            name="motor_inertia",
            default=0.75,
            unit="",
            lower=0.0,
            upper=2.0,
            meaning="reflected motor inertia over the link's",
        ),
        _coordinate("start_x", 0.9),
        _coordinate("start_y", -0.7),
        _coordinate("start_z", 0.5),
        _coordinate("goal_x", 0.7),
        _coordinate("goal_y", 0.8),
        _coordinate("goal_z", 1.1),
        common.angle("tilt", math.pi / 3, "angle of the tool below the horizontal", (-math.pi / 2, math.pi)),
    ),
    build=build,
)
