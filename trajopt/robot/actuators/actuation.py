"""Actuation: the map from control inputs, joint motors and thrusters, to generalised forces.

    force = S^T tau = sum of tau_j over joints with a motor + sum of J_frame(q)^T [u d; c u d] over thrusters

A thruster pushes along an axis d fixed in a frame of the base, so its column of S^T is constant in the base's
axes. The pseudo-inverse of S^T gives the inputs for a generalised force, with least norm if inputs are
redundant. The left null space of S^T gives the balance: rows that no input reaches, which must vanish.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.arguments import NonNegative, UnboundedPositive, checked
from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.errors import InputError, require_fields
from trajopt.robot.actuators.mimic import MimicJoint, independent_rates

# Singular values of the map below this fraction of the largest count as zero.
RANK = 1e-9


@checked
@dataclass(frozen=True, kw_only=True)
class Thruster:
    """A propeller or jet on the base: a force u >= 0 on the robot along an axis of a frame.

    Args:
        name: name of the input.
        frame: frame on the base; the force passes through its origin.
        axis: direction of the force (3,) in the frame's axes, of any length.
        drag: moment about the axis per unit of force, N m/N: the ratio of drag to thrust of a propeller,
            negative if it turns counter-clockwise about the axis.
        least: smallest force, N.
        most: largest force, N.

    Raises:
        InputError: for an axis without direction, or ``least`` above ``most``.
    """

    name: str
    frame: str
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    drag: float = 0.0
    least: NonNegative = 0.0
    most: UnboundedPositive = math.inf

    def __post_init__(self) -> None:
        if not np.linalg.norm(self.axis) > 0:
            raise InputError(f"axis of thruster '{self.name}' is {self.axis}", "allowed: a direction")
        if self.least > self.most:
            raise InputError(f"least of thruster '{self.name}' is {self.least:g} N", f"at most {self.most:g}")

    @classmethod
    def from_meta(cls, meta: Any) -> "Thruster":
        """Thruster from its description in a solution file. Raises `InputError` for a malformed one."""
        require_fields(cls, meta, "a thruster")
        most = math.inf if meta["most"] is None else meta["most"]
        return cls(**{**meta, "axis": tuple(meta["axis"]), "most": most})

    def to_meta(self) -> dict[str, Any]:
        """Fields for JSON, which has no infinity: null means no limit."""
        return asdict(self) | {"most": self.most if math.isfinite(self.most) else None}

    def column(self, model: pin.Model) -> np.ndarray:
        """Generalised force (nv,) of 1 N. Raises `InputError` unless the frame is on a moving base."""
        kind = base_of(model)
        known = model.existFrame(self.frame)
        if kind not in ("freeflyer", "planar"):
            raise InputError(
                f"thruster '{self.name}' is on a {kind} base", "allowed: base 'freeflyer' or 'planar'"
            )
        if not known or model.frames[model.getFrameId(self.frame)].parentJoint != BASE_JOINT[kind]:
            on_base = [frame.name for frame in model.frames if frame.parentJoint == BASE_JOINT[kind]]
            raise InputError(
                f"thruster '{self.name}' is at frame '{self.frame}', which is "
                + ("a link that moves against the base" if known else "unknown"),
                "frames of the base: " + ", ".join(on_base),
            )
        data, axis = model.createData(), np.array(self.axis) / np.linalg.norm(self.axis)
        q, frame = pin.neutral(model), model.getFrameId(self.frame)
        jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
        return np.asarray(jacobian.T @ np.concatenate([axis, self.drag * axis]))


def least_inputs(limit: np.ndarray, thrusters: Sequence[Thruster]) -> np.ndarray:
    """Lower bounds (nu,) of the inputs for upper bounds ``limit`` (nu,): ``-limit`` for joints."""
    return np.append(-limit[: len(limit) - len(thrusters)], [thruster.least for thruster in thrusters])


@dataclass(frozen=True, eq=False)
class Actuation:
    """The map S^T (nv, nu) of a robot; the last axis of arrays runs over forces, inputs or rates.

    Args:
        rows: rows of v that have a motor.
        thrust: columns of the thrusters (nv, n); their inputs come last.
        unit: scales of the balance (nv,), N and N m, used with thrusters or mimic joints.
        leading: rows of v (ny,) of joints that follow no other.
        independent: E (nv, ny) of v = E y, see `trajopt.robot.actuators.mimic`.
    """

    rows: np.ndarray
    thrust: np.ndarray
    unit: np.ndarray
    leading: np.ndarray
    independent: np.ndarray

    @classmethod
    def of(
        cls,
        model: pin.Model,
        rows: np.ndarray,
        thrusters: Sequence[Thruster],
        mimics: Sequence[MimicJoint],
        unit: np.ndarray,
    ) -> "Actuation":
        """The map of a model's joints with a motor and its thrusters. Raises `InputError`."""
        columns = [thruster.column(model) for thruster in thrusters]
        thrust = np.array(columns).reshape(-1, model.nv).T
        followers = [mimic.joints(model)[0].idx_v for mimic in mimics]
        leading = np.setdiff1d(np.arange(model.nv), followers)
        return cls(rows, thrust, unit, leading, independent_rates(model, mimics))

    @cached_property
    def free(self) -> np.ndarray:
        """Rows of v without a motor."""
        return np.setdiff1d(np.arange(len(self.unit)), self.rows)

    @property
    def is_selection(self) -> bool:
        """Whether S only selects rows of v: there are no thrusters and no mimic joints."""
        return self.thrust.shape[1] == 0 and len(self.leading) == len(self.unit)

    @cached_property
    def matrix(self) -> np.ndarray:
        """S^T (nv, nu)."""
        return np.hstack([np.eye(len(self.unit))[:, self.rows], self.thrust])

    @cached_property
    def inverse(self) -> np.ndarray:
        """Pseudo-inverse of E^T S^T times E^T (nu, nv), with rows scaled by ``unit``."""
        unit = self._unit
        moved = self.independent.T @ self.matrix / unit[:, None]
        return np.asarray((np.linalg.pinv(moved) / unit) @ self.independent.T)

    @property
    def _unit(self) -> np.ndarray:
        """Units (ny,) of the independent rows."""
        return self.unit[self.leading]

    @cached_property
    def balance(self) -> np.ndarray:
        """Rows (ny - rank, nv) that no input reaches; scaled by ``unit``, or rows of the identity."""
        if self.is_selection:
            return np.eye(len(self.unit))[self.free]
        unit = self._unit
        left, singular, _ = np.linalg.svd(self.independent.T @ self.matrix / unit[:, None])
        rank = int(np.sum(singular > RANK * singular.max(initial=0.0)))
        return np.asarray((left[:, rank:].T / unit) @ self.independent.T)

    @cached_property
    def coupling(self) -> np.ndarray:
        """C (nv - ny, nv) of the constraint C v = 0, with one row for each mimic joint."""
        followers = np.setdiff1d(np.arange(len(self.unit)), self.leading)
        rows = np.eye(len(self.unit))[followers]
        rows[:, self.leading] -= self.independent[followers]
        return rows

    def force(self, inputs: np.ndarray) -> np.ndarray:
        """Generalised forces S^T tau (..., nv) of inputs tau (..., nu)."""
        force = inputs[..., len(self.rows) :] @ self.thrust.T
        force[..., self.rows] += inputs[..., : len(self.rows)]
        return np.asarray(force)

    def inputs(self, force: np.ndarray) -> np.ndarray:
        """Inputs (..., nu) that produce generalised forces (..., nv), in the least-squares sense."""
        return np.asarray(force[..., self.rows] if self.is_selection else force @ self.inverse.T)

    def balanced(self, force: np.ndarray) -> np.ndarray:
        """Part of generalised forces (..., nv) that no input can produce, see `balance`."""
        return np.asarray(force[..., self.free] if self.is_selection else force @ self.balance.T)

    def residual_force(self, force: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        """Residual (..., nv) of the generalised forces that inputs should produce; zero for mimic joints."""
        left = np.zeros(force.shape)
        left[..., self.leading] = (force - self.force(inputs)) @ self.independent
        return left

    def rates(self, v: np.ndarray) -> np.ndarray:
        """Rates S v (..., nu) conjugate to the inputs: of joints, and of thrusters along their axes."""
        return np.asarray(v[..., self.rows] if self.is_selection else v @ self.matrix)

    def balance_unit(self, unit: np.ndarray) -> np.ndarray:
        """Units of the rows of the balance, from those of generalised forces (nv,)."""
        return unit[self.free] if self.is_selection else np.ones(len(self.balance))

    def input_unit(self, unit: np.ndarray) -> np.ndarray:
        """Units (nu,) of the inputs, from those of generalised forces (nv,)."""
        return np.concatenate([unit[self.rows], np.full(self.thrust.shape[1], unit[0])])
