"""Shared by the hops: robots on one point foot, in the plane or in space, and the position of their base."""

import numpy as np

from trajopt.errors import InputError
from trajopt.robot import Robot, contact_positions, inverse_kinematics
from trajopt_library import robots

ROBOTS = ("hopper", "hopper_space")
# Coordinates of the base along the world's x and z axes, by kind of base.
FORWARD_UP = {"planar": [0, 1], "freeflyer": [0, 2]}


def hopper(name: str | Robot) -> Robot:
    """The robot of that name, if it floats and stands on one point. Raises InputError."""
    robot = robots.load(name)
    if robot.base not in FORWARD_UP or [contact.kind for contact in robot.contacts] != ["point"]:
        raise InputError(
            f"robot '{robot.name}' is not a hopper", f"allowed: one point foot, as {', '.join(ROBOTS)}"
        )
    return robot


def foot_of(robot: Robot) -> str:
    """Name of the hopper's contact."""
    return robot.contacts[0].name


def base_frame(robot: Robot) -> str:
    """A frame of the base link."""
    frames = [frame for frame in robot.model.frames if frame.parentJoint == 1]
    return str(frames[0].name)


def standing_foot(robot: Robot) -> np.ndarray:
    """Position (3,) of the foot at the reference, m, world."""
    return contact_positions(robot, robot.reference)[foot_of(robot)]


def moved(robot: Robot, forward: float, up: float) -> np.ndarray:
    """The reference (nq,) with the base moved along the world's x and z, m."""
    q = robot.reference.copy()
    q[FORWARD_UP[robot.base]] += [forward, up]
    return q


def posture(robot: Robot, forward: float, up: float, foot: np.ndarray) -> np.ndarray:
    """Configuration (nq,) with the base moved and the foot at ``foot`` (3,) m, or as near as possible."""
    frame = robot.contacts[0].frame
    return inverse_kinematics(robot, moved(robot, forward, up), {frame: foot}).q
