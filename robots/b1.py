"""Unitree B1, a quadruped of 56 kg."""

from trajopt.robot import Robot

from ._quadrupeds import unitree

KIND = "quadruped"
RADIUS = 0.04  # m, of the collision sphere at a foot frame


def build() -> Robot:
    """Return B1 standing as its SRDF says; a foot frame is the centre of a ball of 40 mm radius.

    Limits are those of the URDF.
    """
    return unitree("b1", "b1_description/urdf/b1.urdf", radius=RADIUS, thigh=0.8, calf=-1.6)
