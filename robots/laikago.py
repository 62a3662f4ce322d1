"""Unitree Laikago, a quadruped of 25 kg."""

from trajopt.robot import Robot

from ._quadrupeds import unitree

KIND = "quadruped"
RADIUS = 0.0265  # m, of the collision sphere at a foot frame


def build() -> Robot:
    """Return Laikago with its feet below its hips; a foot frame is the centre of a ball of 26.5 mm radius.

    There is no SRDF. Limits are those of the URDF.
    """
    return unitree("laikago", "laikago_description/urdf/laikago.urdf", radius=RADIUS, thigh=0.7, calf=-1.4)
