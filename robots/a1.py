"""Unitree A1, a quadruped of 13.7 kg."""

from trajopt.robot import Robot

from ._quadrupeds import unitree

KIND = "quadruped"
RADIUS = 0.02  # m, of the collision sphere at a foot frame


def build() -> Robot:
    """Return A1 with its feet below its hips; a foot frame is the centre of a ball of 20 mm radius.

    The SRDF stands lower (calves at -1.81 rad, feet ahead of the hips). Limits are those of the URDF.
    """
    return unitree("a1", "a1_description/urdf/a1.urdf", radius=RADIUS, thigh=0.8, calf=-1.6)
