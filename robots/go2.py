"""Unitree Go2, a quadruped of 16 kg."""

from trajopt.robot import Robot

from ._quadrupeds import unitree

KIND = "quadruped"
# The foot's collision mesh is no ball. Of this one, by its centre in the foot frame and its radius in m, the
# mesh stands out by at most 0.7 mm where the shank leans by up to 80 degrees forward or backward and 40
# degrees sideways, and it stands out of the mesh by at most 2.0 mm up to 50 and 30 degrees.
CENTRE, RADIUS = (-0.0012, 0.0, 0.0012), 0.0248


def build() -> Robot:
    """Return Go2 standing as its SRDF says, on balls of 25 mm radius at frames ``FL_ball``, ...

    Limits are those of the URDF, which carries the gears' and the knee linkage's published torques.
    """
    path = "go2_description/urdf/go2.urdf"
    return unitree("go2", path, radius=RADIUS, centre=CENTRE, thigh=0.785, calf=-1.44, hip=0.068)
