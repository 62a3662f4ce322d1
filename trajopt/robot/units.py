"""Scales of the variables, constraints and costs of a robot's NLP."""

from __future__ import annotations

import copy
import math

import numpy as np

from trajopt.dynamics.model_quantities import gravity_of
from trajopt.robot.natural_units import turning_rows
from trajopt.robot.robot import Robot

# A limit this many scaled units away cannot bind in a motion that the robot's own weight drives:
# 30 sqrt(g / l) is a full turn of a leg in about a fifth of its swing time, 30 m g l thirty times the
# moment of the whole weight at the leg's length. Placeholder limits of URDF files (1000 rad/s,
# 1000 N m) lie beyond it. Their rows are left out; ``check`` verifies the limits all the same.
UNREACHABLE = 30.0


class Units:
    """Scales from the weight m g, the length l and the gravity g of ``robot``, or of ``part_of`` if given.

    l is `Robot.length`, which for legs is the height at which they carry the base; `NaturalUnits` says why
    motions are judged over the reach instead.

    ``position``, ``velocity``, ``acceleration`` are arrays (nv,) over the local coordinates (m or rad and
    their derivatives), ``generalized_force`` (nv,) their forces (N or N m), ``torque_rate`` (nv,) in N m/s;
    ``force`` in N, ``torque`` in N m, ``time`` in s; ``twist``, ``contact_acceleration`` and ``wrench`` (6,),
    linear part first.
    """

    def __init__(self, robot: Robot, part_of: Robot | None = None) -> None:
        whole = part_of or robot
        gravity, length = gravity_of(whole.model), whole.length
        linear = ~turning_rows(robot.model)
        self.length, self.gravity = length, gravity
        self.time = math.sqrt(length / gravity)
        self.force = whole.weight
        self.torque = whole.weight * length
        self.twist = np.array([length] * 3 + [1.0] * 3) / self.time
        self.contact_acceleration = self.twist / self.time
        self.wrench = np.array([self.force] * 3 + [self.torque] * 3)
        self.generalized_force = np.where(linear, self.force, self.torque)
        self.position = np.where(linear, length, 1.0)
        self.velocity = self.position / self.time
        self.acceleration = self.velocity / self.time
        self.jerk = self.acceleration / self.time
        self.torque_rate = np.full(robot.nv, self.torque / self.time)
        self.unreachable_torque = UNREACHABLE * self.torque
        self.unreachable_velocity = UNREACHABLE / self.time

    def impulsive(self) -> Units:
        """The same units with forces and torques replaced by impulses, N s and N m s."""
        units = copy.copy(self)
        for name in ("force", "torque", "wrench", "generalized_force"):
            setattr(units, name, getattr(self, name) * self.time)
        return units
