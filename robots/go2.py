"""Unitree Go2, a quadruped of 16 kg."""

from __future__ import annotations

from trajopt.robot import Robot

from ._quadrupeds import unitree

KIND = "quadruped"


def build() -> Robot:
    """Return Go2 standing as its SRDF says; a foot frame is the centre of a ball of 22 mm radius.

    Limits are those of the URDF, which carries the gears' and the knee linkage's published torques.
    """
    return unitree("go2", "go2_description/urdf/go2.urdf", thigh=0.785, calf=-1.44, hip=0.068)
