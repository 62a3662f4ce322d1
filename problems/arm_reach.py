"""An arm reaches: its tool goes to a pose, from rest to rest, with little torque."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError
from trajopt.problem.family import Family, Parameter
from trajopt.problem.problem import Problem
from trajopt.robot.kinematics import inverse_kinematics
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.terms import AccelerationCost, FramePose, TerminalRest, TorqueCost
from trajopt.terrain.flat import FlatGround

from . import arms, common

# The goal where none is given: the tool of the reference turned about the base and raised.
TURN = math.radians(60)
UP = 0.15  # of the reach
# The default duration over what the limits need at least.
UNHURRIED = 2.0


def build(
    *,
    robot: str,
    x: float | None,
    y: float | None,
    z: float | None,
    roll: float,
    pitch: float,
    yaw: float,
    duration: float | None,
) -> Problem:
    """Build the reach; see ``FAMILY`` for the parameters. Raises InputError.

    The guess ends where inverse kinematics from the reference gets closest to the goal: a goal that it does
    not reach still makes a problem, whose solution then reports the row that fails.
    """
    arm = arms.load(robot)
    goal, end = _goal(arm, (x, y, z), pin.rpy.rpyToMatrix(roll, pitch, yaw))
    start = arm.robot.reference
    least = arms.least_duration(arm.robot, (start, end))
    if not (duration or least > 0):
        raise InputError("start and goal of arm-reach are the same pose", "allowed: another goal")
    time = duration or UNHURRIED * least
    return Problem(
        name="arm-reach",
        robot=arm.robot,
        schedule=Schedule((Phase(name="reach", duration=time),)),
        terrain=FlatGround(),
        initial_q=start,
        initial_v=np.zeros(arm.robot.nv),
        terms=(
            TorqueCost(weight=1.0),
            AccelerationCost(weight=1e-2),
            *arms.limits(arm.robot),
            FramePose(frame=arm.tool, position=goal.translation, rotation=goal.rotation),
            TerminalRest(q=end),
        ),
        guess=arms.ArmPath(model=arm.robot.model, start=start, end=end, duration=time),
        parameters=dict(zip("xyz", goal.translation.tolist(), strict=True)) | {"duration": time},
        default_intervals=30,
    )


def _goal(arm: arms.Arm, given: tuple[float | None, ...], turn: np.ndarray) -> tuple[pin.SE3, np.ndarray]:
    """Pose of the tool and a posture (nq,) there, or as near as inverse kinematics gets."""
    default = arm.pose(TURN, 0.0, UP).translation
    position = np.where([own is None for own in given], default, np.array(given, dtype=float))
    distance = float(np.linalg.norm(position - arm.axis))
    if distance > arm.robot.length:
        raise InputError(
            f"the goal is {distance:.3f} m from the first joint of '{arm.robot.name}'",
            f"allowed: within its reach, {arm.robot.length:.3f} m",
        )
    where = arm.cylinder(position)
    goal = pin.SE3(turn @ arm.pose(*where).rotation, position)
    end = arm.follow(*where).q
    return goal, inverse_kinematics(arm.robot, end, {arm.tool: goal}).q


def _place(name: str) -> Parameter:
    meaning = "goal of the tool, world (default: the start's, turned by 60 degrees, raised by 0.15 reach)"
    return common.length(name, None, meaning, (-20.0, 20.0))


def _turn(name: str, axis: str) -> Parameter:
    meaning = f"turn of the tool about the world's {axis} axis, from the start's at the goal's heading"
    return common.angle(name, 0.0, meaning, (-math.pi, math.pi))


FAMILY = Family(
    name="arm-reach",
    robots=arms.ARMS,
    phases=("reach",),
    summary="bring an arm's tool to a pose, from rest to rest, within torque, velocity and position limits",
    parameters=(
        *(_place(name) for name in "xyz"),
        _turn("roll", "x"),
        _turn("pitch", "y"),
        _turn("yaw", "z"),
        common.duration("duration", None, "duration (default: twice what the limits need)", (1e-3, 60.0)),
    ),
    build=build,
)
