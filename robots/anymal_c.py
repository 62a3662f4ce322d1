"""ANYmal C of ANYbotics, a quadruped of 52 kg."""

from __future__ import annotations

from trajopt.robot import Robot

from ._quadrupeds import anymal

KIND = "quadruped"


def build() -> Robot:
    """Return ANYmal C on four point feet, standing as its SRDF says.

    A foot frame lies 7.5 mm above the lowest point of a ball of 30 mm radius. Limits are those of the URDF.
    """
    return anymal("anymal_c", "anymal_c_simple_description/urdf/anymal.urdf")
