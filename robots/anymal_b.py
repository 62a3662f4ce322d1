"""ANYmal B of ANYbotics, a quadruped of 30 kg."""

from trajopt.robot import Robot

from ._quadrupeds import anymal

KIND = "quadruped"
# Collision sphere of a foot: radius, and height of its centre above the foot frame, m.
RADIUS, RISE = 0.031, 0.02325


def build() -> Robot:
    """Return ANYmal B on four point feet, standing as its SRDF says.

    The foot frames of its URDF lie 8 mm above the lowest point of a ball. Limits are those of the URDF: legs
    turn by one and a half turns either way.
    """
    return anymal("anymal_b", "anymal_b_simple_description/robots/anymal.urdf", radius=RADIUS, rise=RISE)
