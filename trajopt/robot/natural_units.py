"""Natural units of a robot, from its model alone: weight, reach and gravity.

Errors, grades, controllers and simulations use them; a solution file states them as ``units``. An NLP has
other scales (`trajopt.robot.Units`): the same weight and gravity, but for legs the height l of the base over
its contacts, to which the lengths of gaits and the times of falls are proportional. That height depends on
the problem's contacts and reference, and a motion has to be judged alike whatever problem it came from. The
reach is 1 to 2.7 times as long (UR5 1, G1 1.2, Talos 1.9, Go2 2.3), so no factor converts one to the other.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
import pinocchio as pin

from trajopt.dynamics.model_quantities import gravity_of, mass_of
from trajopt.robot.building import reach

# A column of a joint's motion subspace is a translation if its angular part is below this fraction of its
# norm.
TRANSLATION = 1e-9


@dataclass(frozen=True, kw_only=True)
class NaturalUnits:
    """Weight m g in N, length l (the robot's reach, 1 m where it has none) in m, gravity g in m/s^2."""

    weight: float
    length: float
    gravity: float

    @classmethod
    def of(cls, model: pin.Model) -> NaturalUnits:
        """Units of a model; a massless one counts as 1 kg."""
        gravity = gravity_of(model)
        return cls(weight=(mass_of(model) or 1.0) * gravity, length=reach(model) or 1.0, gravity=gravity)

    def describe(self) -> dict[str, float]:
        """JSON-able entry ``units`` of a solution file, SI."""
        return {**asdict(self), "time": self.time}

    @property
    def time(self) -> float:
        """sqrt(l / g) in s."""
        return math.sqrt(self.length / self.gravity)

    def acceleration(self, model: pin.Model) -> np.ndarray:
        """Units (nv,) of accelerations: g, and g / l of rotations."""
        return np.where(turning_rows(model), self.gravity / self.length, self.gravity)

    def generalized_force(self, model: pin.Model) -> np.ndarray:
        """Units (nv,) of the rows of the dynamics: m g for forces, m g l for moments."""
        return np.where(turning_rows(model), self.weight * self.length, self.weight)


def turning_rows(model: pin.Model) -> np.ndarray:
    """Mask (nv,) of the rows of v that are rotations."""
    data = model.createData()
    columns = pin.computeJointJacobians(model, data, pin.neutral(model)).reshape(6, model.nv)
    return np.asarray(np.linalg.norm(columns[3:], axis=0) > TRANSLATION * np.linalg.norm(columns, axis=0))
