"""A reach of the UR5: rest to rest to a pose of its tool, with torques, accelerations or rates as inputs."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

import robots
from robots.ur5 import TOOL
from trajopt.context import ACTUATIONS, Actuation
from trajopt.family import Choice, Family, Parameter
from trajopt.kinematics import inverse_kinematics
from trajopt.node_terms import FramePose, TerminalRest
from trajopt.problem import Problem
from trajopt.robot import Robot
from trajopt.schedule import FlatGround, Phase, Schedule
from trajopt.terms import (
    AccelerationCost,
    EffortLimits,
    PositionLimits,
    Term,
    TorqueCost,
    VelocityCost,
    VelocityLimits,
)


class _Guess:
    """Joints along a smooth rest-to-rest polynomial, 10 s^3 - 15 s^4 + 6 s^5."""

    def __init__(self, start: np.ndarray, end: np.ndarray, duration: float) -> None:
        self.start, self.end, self.duration = start, end, duration

    def __call__(self, t: float) -> np.ndarray:
        s = min(max(t / self.duration, 0.0), 1.0)
        return self.start + (self.end - self.start) * s**3 * (10 - 15 * s + 6 * s * s)


def _tool_pose(robot: Robot, q: np.ndarray) -> pin.SE3:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[robot.model.getFrameId(TOOL)].copy()


def _effort(robot: Robot, share: float, end: np.ndarray) -> dict[Actuation, tuple[Term, ...]]:
    """What each kind of source can price and limit; a source of velocity stops when it likes."""
    limit = None if robot.effort_limit is None else share * robot.effort_limit
    rest = TerminalRest(q=end)
    return {
        "torque": (TorqueCost(weight=1.0), AccelerationCost(weight=1e-2), EffortLimits(limit=limit), rest),
        "acceleration": (AccelerationCost(weight=1.0), rest),
        "velocity": (VelocityCost(weight=1.0),),
    }


def build(
    *,
    x: float,
    y: float,
    z: float,
    roll: float,
    pitch: float,
    yaw: float,
    duration: float,
    effort_share: float,
    actuation: Actuation,
) -> Problem:
    """Build the reach; see ``FAMILY`` for the parameters.

    The guess ends where inverse kinematics from the start posture gets closest to the goal: a goal out
    of reach still makes a problem, whose solution then reports the row that fails.
    """
    robot = robots.load("ur5")
    start = robot.reference
    turn = pin.rpy.rpyToMatrix(roll, pitch, yaw)
    goal = pin.SE3(turn @ _tool_pose(robot, start).rotation, np.array([x, y, z]))
    end = inverse_kinematics(robot, start, {TOOL: goal}).q
    terms = (
        *_effort(robot, effort_share, end)[actuation],
        PositionLimits(),
        VelocityLimits(),
        FramePose(frame=TOOL, position=goal.translation, rotation=goal.rotation),
    )
    return Problem(
        name="ur5-reach",
        robot=robot,
        schedule=Schedule((Phase(name="reach", duration=duration),)),
        terrain=FlatGround(),
        initial_q=start,
        initial_v=np.zeros(robot.nv),
        terms=terms,
        guess=_Guess(start, end, duration),
        actuation=actuation,
        default_intervals=30,
    )


def _turn(name: str, axis: str) -> Parameter:
    return Parameter(
        name=name,
        default=0.0,
        unit="rad",
        lower=-math.pi,
        upper=math.pi,
        meaning=f"turn of the tool about the world's {axis} axis from its start orientation",
    )


FAMILY = Family(
    name="ur5-reach",
    robot="ur5",
    phases=("reach",),
    summary="bring the tool to a pose, from rest to rest, within torque, velocity and position limits",
    parameters=(
        Parameter(name="x", default=0.3, unit="m", lower=-5.0, upper=5.0, meaning="goal of the tool, world"),
        Parameter(name="y", default=0.45, unit="m", lower=-5.0, upper=5.0, meaning="goal of the tool, world"),
        Parameter(name="z", default=0.45, unit="m", lower=-5.0, upper=5.0, meaning="goal of the tool, world"),
        _turn("roll", "x"),
        _turn("pitch", "y"),
        _turn("yaw", "z"),
        Parameter(
            name="duration", default=1.5, unit="s", lower=1e-3, upper=60.0, meaning="duration of the motion"
        ),
        Parameter(
            name="effort_share",
            default=1.0,
            unit="",
            lower=1e-3,
            upper=1.0,
            meaning="share of the effort limits to use",
        ),
        Choice(
            name="actuation",
            default="torque",
            choices=ACTUATIONS,
            meaning="what the joints' actuators are sources of",
        ),
    ),
    build=build,
)
