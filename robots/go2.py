"""Unitree Go2, a quadruped of 16 kg."""

from __future__ import annotations

from trajopt.robot import Robot

from ._quadrupeds import unitree

KIND = "quadruped"
# The foot's collision mesh is no ball. This one, of centre in the foot frame and radius in m, lies between
# 0.9 mm inside and 2 mm outside of it where the shank leans by up to 80 degrees forward or backward and 40
# degrees sideways.
CENTRE, RADIUS = (-0.0017, 0.0, 0.0004), 0.024


def build() -> Robot:
    """Return Go2 standing as its SRDF says, on balls of 24 mm radius at frames ``FL_ball``, ...

    Limits are those of the URDF, which carries the gears' and the knee linkage's published torques.
    """
    path = "go2_description/urdf/go2.urdf"
    return unitree("go2", path, radius=RADIUS, centre=CENTRE, thigh=0.785, calf=-1.44, hip=0.068)
