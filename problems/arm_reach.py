"""An arm reaches: its tool moves to a pose, from rest to rest, with little torque."""

import math

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError
from trajopt.problem import Family, Parameter, Problem
from trajopt.robot import Posture, frame_pose, inverse_kinematics
from trajopt.terms import AccelerationCost, TorqueCost

from . import arms, common

# The default goal is the tool of the reference posture turned about the base and raised.
TURN = math.radians(60)
UP = 0.15  # of the reach
PARTS = (1.0, 0.5, 0.25, 0.125)
PLACE = (
    "goal of the tool, world (default: the start turned by 60 degrees and raised by 0.15 reach,"
    " or the largest part of it that the arm reaches)"
)
# Default duration over the least duration estimated from the limits.
UNHURRIED = 2.0


def build(
    *,
    robot: str,
    duration: float | None,
    orientation: str,
    roll: float,
    pitch: float,
    yaw: float,
    actuation: str,
    **place: float | None,
) -> Problem:
    """Build the reach; see ``FAMILY`` for the parameters. Raises InputError.

    The guess ends where inverse kinematics from the reference gets closest to the goal. A goal that is not
    reached still gives a problem, whose solution then reports the violated constraint; an arm with too few
    joints for a pose is refused.
    """
    arm, turned, turn = arms.load(robot), orientation == arms.GIVEN, pin.rpy.rpyToMatrix(roll, pitch, yaw)
    if not turned and (roll or pitch or yaw):
        raise InputError(
            f"arm-reach has {arms.ORIENTATION}={arms.FREE} and a turn of the tool",
            f"allowed: one of them; roll, pitch and yaw need {arms.ORIENTATION}={arms.GIVEN}",
        )
    goal, posture = _goal(arm, tuple(place[axis] for axis in "xyz"), turn, turned)
    end = posture.q if not turned or arm.robot.nv >= arms.POSE_ROWS else arm.reached(posture, goal)
    ends = (arm.robot.reference, end)
    least = arms.least_duration(arm.robot, ends)
    if not (duration or least > 0):
        raise InputError("start and goal of arm-reach are the same pose", "allowed: another goal")
    time = duration or UNHURRIED * least
    return arms.between(
        "arm-reach",
        arm.robot,
        ends,
        time,
        phase="reach",
        costs=(TorqueCost(weight=1.0), AccelerationCost(weight=1e-2)),
        torques=arms.torque_limits(arm.robot),
        end=arm.arrival(goal, end, turned=turned),
        parameters=dict(zip("xyz", goal.translation.tolist(), strict=True)) | {"duration": time},
        default_intervals=30,
        actuation=actuation,
    )


def _goal(
    arm: arms.Arm, given: tuple[float | None, ...], turn: np.ndarray, turned: bool
) -> tuple[pin.SE3, Posture]:
    """Return the pose of the tool and a posture there, or as near as inverse kinematics get."""
    default = _default(arm, turned) if given == (None,) * 3 else arm.pose(TURN, 0.0, UP).translation
    position = np.where([coordinate is None for coordinate in given], default, np.array(given, dtype=float))
    distance = float(np.linalg.norm(position - arm.axis))
    if distance > arm.robot.length:
        raise InputError(
            f"the goal is {distance:.3f} m from the first joint of '{arm.robot.name}'",
            f"allowed: within its reach, {arm.robot.length:.3f} m",
        )
    where = arm.cylinder(position)
    goal = pin.SE3(turn @ arm.pose(*where).rotation, position)
    wanted = goal if turned else position
    return goal, inverse_kinematics(arm.robot, arm.towards(*where, turned=turned).q, {arm.tool: wanted})


def _default(arm: arms.Arm, turned: bool) -> np.ndarray:
    """Place (3,) of the tool turned about the base and raised, or by the largest of `PARTS` that it reaches.

    An arm that reaches none, such as one that moves in a plane, gets as near as it can if it may turn freely.
    """
    for part in PARTS:
        way = (part * TURN, 0.0, part * UP)
        posture = arm.towards(*way, turned=turned)
        if posture.error <= arms.REACHED and arm.is_clear(posture.q):
            return arm.pose(*way).translation
    nearest = arm.towards(TURN, 0.0, UP, turned=False).q
    return (
        arm.pose(TURN, 0.0, UP).translation
        if turned
        else frame_pose(arm.robot, nearest, arm.tool).translation
    )


def turns(origin: str) -> tuple[Parameter, ...]:
    """Rotations of the tool about the world's axes; ``origin`` names the orientation they start from."""
    axes = {"roll": "x", "pitch": "y", "yaw": "z"}
    about = "rotation of the tool about the world's"
    meanings = {name: f"{about} {axis} axis, from {origin}" for name, axis in axes.items()}
    limits = (-math.pi, math.pi)
    return tuple(common.angle(name, 0.0, meaning, limits) for name, meaning in meanings.items())


FAMILY = Family(
    name="arm-reach",
    robots=arms.ARMS,
    phases=("reach",),
    summary="bring an arm's tool to a pose, from rest to rest, within torque, velocity and position limits",
    parameters=(
        *(common.length(name, None, PLACE, (-20.0, 20.0)) for name in "xyz"),
        common.choice(
            arms.ORIENTATION, "of the tool at the goal: by roll, pitch and yaw, or any", arms.GIVEN, arms.FREE
        ),
        *turns("the start orientation turned to the goal's heading"),
        common.duration("duration", None, "duration (default: estimated from the limits)", (1e-3, 60.0)),
        common.ACTUATION,
    ),
    build=build,
    variants=arms.VARIANTS,
)
