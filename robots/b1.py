"""Unitree B1, a quadruped of 56 kg."""

from __future__ import annotations

from trajopt.robot import Robot

from ._quadrupeds import unitree

KIND = "quadruped"


def build() -> Robot:
    """Return B1 standing as its SRDF says; a foot frame is the centre of a ball of 40 mm radius.

    Limits are those of the URDF.
    """
    return unitree("b1", "b1_description/urdf/b1.urdf", thigh=0.8, calf=-1.6)
