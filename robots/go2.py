"""Unitree Go2, a quadruped of 16 kg."""

from trajopt.robot import Robot

from ._quadrupeds import unitree

KIND = "quadruped"
# The collision mesh of the foot is not a ball. With this centre in the foot frame and radius, m, the mesh
# protrudes by at most 0.7 mm while the shank leans by up to 80 degrees forward or backward and 40 degrees
# sideways; the ball protrudes from the mesh by at most 2.0 mm up to 50 and 30 degrees.
CENTRE, RADIUS = (-0.0012, 0.0, 0.0012), 0.0248


def build() -> Robot:
    """Return Go2 standing as its SRDF says, on balls of 25 mm radius at frames ``FL_ball``, ...

    Limits are those of the URDF, which carries the gears' and the knee linkage's published torques.
    """
    path = "go2_description/urdf/go2.urdf"
    return unitree("go2", path, radius=RADIUS, centre=CENTRE, thigh=0.785, calf=-1.44, hip=0.068)
