"""ANYmal B of ANYbotics, a quadruped of 30 kg."""

from __future__ import annotations

from trajopt.robot import Robot

from ._quadrupeds import anymal

KIND = "quadruped"


def build() -> Robot:
    """Return ANYmal B on four point feet, standing as its SRDF says.

    A foot frame lies 8 mm above the lowest point of a ball of 31 mm radius.
    Limits are those of the URDF: legs turn by one and a half turns either way.
    """
    return anymal("anymal_b", "anymal_b_simple_description/robots/anymal.urdf")
