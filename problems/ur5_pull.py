"""The UR5 reaches for a handle on a board, grasps it and pulls: a bilateral contact with six rows."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.problem import Family, Parameter, PosturePath, Problem
from trajopt.robot import Contact, Robot, frame_pose, inverse_kinematics
from trajopt.schedule import Phase, Schedule
from trajopt.terms import AccelerationCost, NormalForce, TorqueCost, WrenchCost
from trajopt.terrain import Surface
from trajopt_library import robots
from trajopt_library.robots.ur5 import TOOL

from . import common

GRIP = "grip"
# Half sizes of the gripped handle, m, only for drawing: a grasp transmits any wrench.
HALF_LENGTH, HALF_WIDTH = 0.04, 0.02


def _gripping() -> Robot:
    """Return the UR5 with a gripper: a frame at the tool whose z axis points back into the arm."""
    robot = robots.load("ur5")
    model = robot.model.copy()
    tool = model.frames[model.getFrameId(TOOL)]
    back = tool.placement * pin.SE3(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    model.addFrame(pin.Frame(GRIP, tool.parentJoint, model.getFrameId(TOOL), back, pin.OP_FRAME))
    handle = Contact(frame=GRIP, kind="surface", half_length=HALF_LENGTH, half_width=HALF_WIDTH)
    return replace(robot, model=model, contacts=(handle,))


def _grasping(robot: Robot, board: Surface) -> np.ndarray:
    """Return a posture with the gripper on the handle, turned as little as the board allows."""
    start = frame_pose(robot, robot.reference, GRIP).rotation
    turn = pin.Quaternion.FromTwoVectors(start[:, 2], board.normal).toRotationMatrix()
    return inverse_kinematics(robot, robot.reference, {GRIP: pin.SE3(turn @ start, board.point)}).q


def build(
    *,
    x: float,
    y: float,
    z: float,
    tilt: float,
    force: float,
    reach: float,
    grasp: float,
    pull: float,
    torque_share: float,
) -> Problem:
    """Build the pull; see ``FAMILY`` for the parameters. Raises InputError."""
    robot = _gripping()
    board = Surface(point=np.array([x, y, z]), normal=common.wall_normal(tilt), bilateral=True)
    held: dict[str, Any] = {"contacts": (GRIP,), "surfaces": {GRIP: board}}
    return common.problem(
        "ur5-pull",
        robot,
        Schedule(
            (
                Phase(name="reach", duration=reach),
                Phase(name="grasp", duration=grasp, footholds={GRIP: board.point}, **held),
                Phase(name="pull", duration=pull, **held),
            )
        ),
        PosturePath(
            model=robot.model, postures=(robot.reference, _grasping(robot, board)), durations=(reach,)
        ),
        costs=(TorqueCost(weight=1.0), AccelerationCost(weight=1e-2), WrenchCost(weight=1e-2)),
        torque_share=torque_share,
        cones=(),  # a grasp transmits any wrench
        end=(NormalForce(contact=GRIP, upper=-force, during="pull"),),
        default_intervals=30,
    )


def _place(name: str, default: float) -> Parameter:
    return common.length(name, default, "position of the handle, world", (-2.0, 2.0))


FAMILY = Family(
    name="ur5-pull",
    robot="ur5",
    phases=("reach", "grasp", "pull"),
    summary="grasp a handle on a board and pull it with a given force, within torque limits",
    parameters=(
        _place("x", 0.6),
        _place("y", 0.1),
        _place("z", 0.4),
        common.angle(
            "tilt",
            math.radians(30),
            "tilt of the board, positive: top away; 0 is a wall, a right angle a table",
            (-math.pi / 3, math.pi / 2),
        ),
        common.number("force", 60.0, "N", "least pull along the normal", (0.0, 500.0)),
        common.duration("reach", 1.2, "duration until the grasp", (1e-2, 60.0)),
        common.duration("grasp", 0.3, "duration in which the force may grow", (1e-2, 60.0)),
        common.duration("pull", 0.5, "duration of the pull", (1e-2, 60.0)),
        common.TORQUE_SHARE,
    ),
    build=build,
)
