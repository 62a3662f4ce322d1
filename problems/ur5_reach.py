"""A reach of the UR5: rest to rest to a pose of its tool, with torques, accelerations or rates as inputs."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from trajopt.problem.family import Choice, Family, Parameter
from trajopt.problem.problem import Problem
from trajopt.robot.kinematics import frame_pose, inverse_kinematics
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.terms import (
    AccelerationCost,
    FramePose,
    PositionLimits,
    Term,
    TerminalRest,
    TorqueCost,
    VelocityCost,
    VelocityLimits,
)
from trajopt.terms.context_symbols import ACTUATIONS, Actuation
from trajopt.terrain.flat import FlatGround
from trajopt_library import robots
from trajopt_library.robots.ur5 import TOOL

from . import common


def _effort(robot: Robot, share: float, end: np.ndarray) -> dict[Actuation, tuple[Term, ...]]:
    """What each kind of source can price and limit; a source of velocity stops when it likes."""
    limits = common.share_of_effort(robot, share)
    rest = TerminalRest(q=end)
    return {
        "torque": (TorqueCost(weight=1.0), AccelerationCost(weight=1e-2), limits, rest),
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
    goal = pin.SE3(turn @ frame_pose(robot, start, TOOL).rotation, np.array([x, y, z]))
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
        guess=common.JointPath(start, end, duration),
        actuation=actuation,
        default_intervals=30,
    )


def _turn(name: str, axis: str) -> Parameter:
    meaning = f"turn of the tool about the world's {axis} axis from its start orientation"
    return common.angle(name, 0.0, meaning, (-math.pi, math.pi))


FAMILY = Family(
    name="ur5-reach",
    robot="ur5",
    phases=("reach",),
    summary="bring the tool to a pose, from rest to rest, within torque, velocity and position limits",
    parameters=(
        common.length("x", 0.3, "goal of the tool, world", (-5.0, 5.0)),
        common.length("y", 0.45, "goal of the tool, world", (-5.0, 5.0)),
        common.length("z", 0.45, "goal of the tool, world", (-5.0, 5.0)),
        _turn("roll", "x"),
        _turn("pitch", "y"),
        _turn("yaw", "z"),
        common.duration("duration", 1.5, "duration of the motion", (1e-3, 60.0)),
        common.effort_share(),
        Choice(
            name="actuation",
            default="torque",
            choices=ACTUATIONS,
            meaning="what the joints' actuators are sources of",
        ),
    ),
    build=build,
)
