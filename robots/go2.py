"""Unitree Go2, a quadruped of 16 kg."""

from __future__ import annotations

from trajopt.robot import Robot

from ._quadrupeds import unitree

KIND = "quadruped"
# The foot is no ball: its collision mesh reaches 22.1 to 23.9 mm below its frame while the shank leans by
# up to 40 degrees, forward or backward, and 24.9 mm at 60 degrees, as on stairs: so it is at most 1 mm deep.
RADIUS = 0.024


def build() -> Robot:
    """Return Go2 standing as its SRDF says; a foot frame is nearly the centre of a ball of 24 mm radius.

    Limits are those of the URDF, which carries the gears' and the knee linkage's published torques.
    """
    return unitree("go2", "go2_description/urdf/go2.urdf", radius=RADIUS, thigh=0.785, calf=-1.44, hip=0.068)
