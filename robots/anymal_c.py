"""ANYmal C of ANYbotics, a quadruped of 52 kg."""

from trajopt.robot import Robot

from ._quadrupeds import anymal

KIND = "quadruped"
# Collision sphere of a foot: radius, and height of its centre above the foot frame, m.
RADIUS, RISE = 0.03, 0.0225


def build() -> Robot:
    """Return ANYmal C on four point feet, standing as its SRDF says.

    The foot frames of its URDF lie 7.5 mm above the lowest point of a ball. Limits are those of the URDF.
    """
    return anymal("anymal_c", "anymal_c_simple_description/urdf/anymal.urdf", radius=RADIUS, rise=RISE)
