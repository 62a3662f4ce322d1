"""Natural units of a robot: what scales unknowns, rows and costs."""

from __future__ import annotations

import math

import numpy as np

from trajopt.model_quantities import gravity_of
from trajopt.robot import Robot

# A limit this many natural units away cannot bind in a motion that the robot's own weight drives:
# 30 sqrt(g / l) is a full turn of a leg in about a fifth of its swing time, 30 m g l thirty times the
# moment of the whole weight at the leg's length. Placeholder limits of URDF files (1000 rad/s,
# 1000 N m) lie beyond. Rows for them are left out; ``check`` verifies the limits all the same.
UNREACHABLE = 30.0


class Units:
    """Natural units from weight m g, length l and g.

    ``position``, ``velocity``, ``acceleration`` are arrays (nv,) over the local coordinates (m or rad and
    their derivatives); ``force`` in N, ``torque`` in N m, ``time`` in s; ``wrench`` (6,).
    """

    def __init__(self, robot: Robot) -> None:
        gravity, length = gravity_of(robot.model), robot.length
        linear = _is_linear(robot)
        self.length, self.gravity = length, gravity
        self.time = math.sqrt(length / gravity)
        self.force = robot.weight
        self.torque = robot.weight * length
        self.wrench = np.array([self.force] * 3 + [self.torque] * 3)
        self.position = np.where(linear, length, 1.0)
        self.velocity = self.position / self.time
        self.acceleration = self.velocity / self.time
        self.unreachable_torque = UNREACHABLE * self.torque
        self.unreachable_velocity = UNREACHABLE / self.time


def _is_linear(robot: Robot) -> np.ndarray:
    """Which entries of v are linear velocities (nv,)."""
    linear = np.zeros(robot.nv, dtype=bool)
    for joint in list(robot.model.joints)[1:]:
        kind = joint.shortname().removeprefix("JointModel")
        start = joint.idx_v
        if kind == "FreeFlyer" or kind == "Translation":
            linear[start : start + 3] = True
        elif kind == "Planar":
            linear[start : start + 2] = True
        elif kind.startswith("P"):
            linear[start] = True
    return linear
