"""Unitree Go1, a quadruped of 13.1 kg."""

from trajopt.robot import Robot

from ._quadrupeds import unitree

KIND = "quadruped"
RADIUS = 0.02  # m, of the collision sphere at a foot frame


def build() -> Robot:
    """Return Go1 with its feet below its hips; a foot frame is the centre of a ball of 20 mm radius.

    The SRDF stands lower (calves at -1.853 rad, feet ahead of the hips). Limits are those of the URDF.
    """
    return unitree("go1", "go1_description/urdf/go1.urdf", radius=RADIUS, thigh=0.8, calf=-1.6)
