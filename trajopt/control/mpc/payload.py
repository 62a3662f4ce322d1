"""A mass that a legged robot carries on its base, as numbers of its horizons.

A point mass m at c in the base's axes changes the balance of the base and no other rows. It adds

    force  m (a + w x v + dw x c + w x (w x c) - R^T g),      moment  c x force

with v, w the base's velocity in its axes and a, dw their rates (Newton's law for a point of a moving body).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
from typing_extensions import override

from trajopt.control.mpc.horizon import Numbers
from trajopt.dynamics.rotations import rotation_matrix
from trajopt.errors import finite_array, require_not_negative
from trajopt.robot.payload import loaded_model
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.dynamics import BaseDynamics
from trajopt.terms.interfaces import Rows

PAYLOAD = "payload"


@dataclass(frozen=True, kw_only=True)
class LoadedBaseDynamics(BaseDynamics):
    """Rows of `BaseDynamics` with a point mass on the base; m and c are the `Numbers` named `PAYLOAD`."""

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        mass, place = ca.vertsplit(context.varying(Numbers(PAYLOAD, 4), 4), [0, 1, 4])
        v, w, gravity = context.v[:3], context.v[3:6], context.robot.model.gravity.linear
        upright = ca.mtimes(rotation_matrix(context.q[3:7]).T, ca.DM(gravity))
        rise = context.a[:3] + ca.cross(w, v) - upright
        turning = ca.cross(context.a[3:6], place) + ca.cross(w, ca.cross(w, place))
        force = mass * (rise + turning)
        balance = ca.SX(context.base_rows)
        balance[:6] += ca.vertcat(force, ca.cross(place, force))
        scale = context.robot.actuation.balance_unit(units.generalized_force)
        return Rows.create(balance, 0, 0, scale)


def payload_numbers(mass: float, place: Any) -> np.ndarray:
    """Numbers (4,) for a mass in kg at a place (3,) in the base's axes, m. Raises `InputError`."""
    require_not_negative("mass on the base", mass, "kg")
    return np.append(mass, finite_array("place on the base", place, (3,), unit="m"))


def carrying(model: pin.Model, numbers: np.ndarray) -> pin.Model:
    """A copy of a model with a free base, with the mass of `payload_numbers` on the base."""
    body = pin.Inertia(float(numbers[0]), np.array(numbers[1:]), np.zeros((3, 3)))
    return loaded_model(model, model.names[1], body)
