"""Jaco 2 of Kinova (j2s6s200: six joints, spherical wrist, two fingers, which the URDF fixes)."""

import math

from trajopt.robot import Robot, robot_file

KIND = "arm"
# Frame between the fingers, x pointing out of the hand.
TOOL = "j2s6s200_end_effector"

# Elbow up, hand pointing down in front of the base, far from singularities. The SRDF's "arm_up" violates the
# limits of the third joint.
ELBOW_UP = {
    "j2s6s200_joint_1": -math.pi / 2,
    "j2s6s200_joint_2": 3.34,
    "j2s6s200_joint_3": 1.54,
    "j2s6s200_joint_4": 0.0,
    "j2s6s200_joint_5": 4.44,
    "j2s6s200_joint_6": 0.0,
}


def build() -> Robot:
    """Return the arm with a fixed base and no contacts; limits are those of its URDF.

    Its first, fourth and sixth joints turn without end: their coordinates are (cos, sin).
    """
    return Robot.from_urdf(
        robot_file("kinova_description/robots/kinova.urdf"),
        name="kinova",
        base="fixed",
        reference=ELBOW_UP,
    )
