"""Forward and inverse dynamics of a model whose active contacts are bilateral constraints.

    M a + h = tau + J^T f,      J a + Jdot v = 0                                        (KKT)

tau (nv,) has all generalised forces except those of the contacts; f are the contact wrenches on the robot, in
world axes at the frames' origins (Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 8).
With M = L L^T, y = L^T a, B = L^-1 (D J)^T and D the scale of the rows this is the projection of y onto
B^T y = const (Gauss's principle; Udwadia and Kalaba 1992). So a is unique even for dependent rows; if rows
contradict each other, it has the least contact acceleration. f then has minimum norm.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from trajopt import _numeric
from trajopt.arguments import checked
from trajopt.certify.contact.contact_response import (
    ContactRank,
    cholesky,
    cholesky_solve,
    contact_rank,
    contact_response,
    mass_factor,
)
from trajopt.certify.contact.contact_set import ContactSet, contact_kinematics
from trajopt.dynamics.base_joint import BASE_ROWS, base_of
from trajopt.dynamics.model_quantities import generalized_force, without_rolling
from trajopt.errors import InputError


@dataclass(frozen=True, kw_only=True)
class ContactMotion:
    """Solution of the forward dynamics with contacts.

    Args:
        acceleration: Generalised acceleration (nv,).
        wrenches: Wrenches (n, 6) on the robot, N and N m, world axes, at frame origins; point contacts have
            no moment unless they roll.
        rank: Rank of the contact rows; if it is redundant, the wrenches have minimum norm.
        dynamics_residual: RNEA(q, v, a) - tau - J^T f (nv,), N and N m.
        contact_acceleration: Classical acceleration (n, 6) of the contacts from forward kinematics, m/s^2 and
            rad/s^2; zero unless rows contradict each other. Angular rows of point contacts are zero.
    """

    acceleration: np.ndarray
    wrenches: np.ndarray
    rank: ContactRank
    dynamics_residual: np.ndarray
    contact_acceleration: np.ndarray


@dataclass(frozen=True, kw_only=True)
class InverseDynamics:
    """``torque`` (nu,) of the actuated rows, and ``base_residual`` of the others, which must vanish."""

    torque: np.ndarray
    base_residual: np.ndarray


@checked
def forward_dynamics(
    model: pin.Model, q: np.ndarray, v: np.ndarray, tau: np.ndarray, contacts: ContactSet
) -> ContactMotion:
    """Solve (KKT) for acceleration and contact wrenches, with a rank report and both residuals.

    q (nq,), v (nv,), tau (nv,) as from `actuated_force`. Raises `InputError` for wrong shapes, numbers that
    are not finite, or a mass matrix that is not positive definite.
    """
    require_arrays({"q": (q, model.nq), "v": (v, model.nv), "tau": (tau, model.nv)})
    data = model.createData()
    lower = mass_factor(pin.crba(model, data, q))
    free = cholesky_solve(lower, tau - pin.nle(model, data, q, v))
    rows = contact_kinematics(model, data, q, v, contacts)
    response = contact_response(lower, contacts, rows.jacobian)
    change, forces = response.least(-contacts.scale * (rows.drift + rows.jacobian @ free))
    acceleration = free + change
    wrenches = contacts.wrenches(contacts.scale * forces)
    residual = generalized_force(model, data, (q, v, acceleration), contacts.frames, wrenches) - tau
    return ContactMotion(
        acceleration=acceleration,
        wrenches=wrenches,
        rank=contact_rank(contacts, rows.jacobian, response),
        dynamics_residual=residual,
        contact_acceleration=_contact_acceleration(model, data, (q, v, acceleration), contacts),
    )


@checked
def inverse_dynamics(
    model: pin.Model,
    motion: tuple[np.ndarray, np.ndarray, np.ndarray],
    contacts: ContactSet,
    wrenches: np.ndarray,
    *,
    actuated_rows: np.ndarray | None = None,
) -> InverseDynamics:
    """Return torques and base rows of ``RNEA(q, v, a) - J^T f`` for a motion (q, v, a).

    ``wrenches`` (n, 6) are in N and N m, world axes, at the frames' origins. ``actuated_rows`` (nu,) of v
    have an actuator; default: all but the base's. Raises `InputError` for wrong shapes or values.
    """
    q, v, a = motion
    require_arrays({"q": (q, model.nq), "v": (v, model.nv), "a": (a, model.nv)})
    table = np.asarray(wrenches, dtype=float)
    if table.shape != (len(contacts.names), 6) or not np.isfinite(table).all():
        raise InputError(f"wrenches have shape {table.shape}", f"finite, shape ({len(contacts.names)}, 6)")
    force = generalized_force(model, model.createData(), motion, contacts.frames, table)
    rows = rows_with_actuator(model, actuated_rows)
    return InverseDynamics(torque=force[rows], base_residual=np.delete(force, rows))


def rows_with_actuator(model: pin.Model, given: np.ndarray | None = None) -> np.ndarray:
    """Return the actuated rows of v: ``given``, or all but those of the base. Raises `InputError`."""
    if given is None:
        return np.arange(BASE_ROWS[base_of(model)], model.nv)
    if not np.isin(given, np.arange(model.nv)).all() or (np.diff(given) <= 0).any():
        raise InputError(f"actuated_rows are {np.asarray(given).tolist()}", f"ascending, 0 to {model.nv - 1}")
    return np.asarray(given, dtype=int)


@checked
def actuated_force(
    model: pin.Model, torque: np.ndarray, actuated_rows: np.ndarray | None = None
) -> np.ndarray:
    """Return ``S^T torque`` (nv,): torques (nu,) in the actuated rows, zeros in the others."""
    rows, force = rows_with_actuator(model, actuated_rows), np.zeros(model.nv)
    require_arrays({"torque": (torque, len(rows))})
    force[rows] = torque
    return force


def require_arrays(arrays: dict[str, tuple[np.ndarray, int]]) -> None:
    """Raise `InputError` for the first named array that is not finite or does not have the given size."""
    for name, (array, size) in arrays.items():
        if np.shape(array) != (size,) or not np.isfinite(array).all():
            raise InputError(f"{name} of shape {np.shape(array)} is not allowed", f"finite, shape ({size},)")


def _contact_acceleration(
    model: pin.Model,
    data: pin.Data,
    motion: tuple[np.ndarray, np.ndarray, np.ndarray],
    contacts: ContactSet,
) -> np.ndarray:
    pin.forwardKinematics(model, data, *motion)
    table, axes = np.zeros((len(contacts.names), 6)), pin.LOCAL_WORLD_ALIGNED
    for index, (frame, size) in enumerate(zip(contacts.frames, contacts.dimensions, strict=True)):
        moved = pin.getFrameClassicalAcceleration(model, data, frame, axes).vector
        table[index, :size] = moved[:size]
        if contacts.levers and (lever := contacts.levers[index]) is not None:
            table[index, :3] = without_rolling(moved, lever)
    return table


class ContactDynamics:
    """Forward dynamics for many calls with the same contacts; computes only the acceleration.

    It solves the equations of `forward_dynamics`, without the report. ``independent`` is E (nv, ny) in
    v = E y for mimic joints. Results are NaN if the mass matrix is not positive definite.
    """

    def __init__(self, model: pin.Model, contacts: ContactSet, independent: np.ndarray | None = None) -> None:
        self.model = model
        self.contacts = contacts
        self.independent = independent
        self._data = model.createData()

    @cached_property
    def compiled(self) -> _numeric.Dynamics | None:
        """The same dynamics, compiled, for many states and whole integrations; None with mimic joints."""
        if self.independent is not None:
            return None
        contacts = self.contacts
        frames, dimensions = [int(frame) for frame in contacts.frames], list(contacts.dimensions)
        compiled = _numeric.Dynamics(self.model, frames, dimensions, contacts.moment_arm)
        for number, lever in enumerate(contacts.levers):
            if lever is not None:
                compiled.roll(number, np.array(lever))
        return compiled

    def accelerations(self, q: np.ndarray, v: np.ndarray, generalized_force: np.ndarray) -> np.ndarray:
        """Return the accelerations (n, nv) at n states."""
        if self.compiled is None:
            rows = zip(q, v, generalized_force, strict=True)
            return np.array([self.acceleration(*row) for row in rows])
        states = [np.ascontiguousarray(part, dtype=float) for part in (q, v, generalized_force)]
        return self.compiled.accelerations(*states)

    def acceleration(self, q: np.ndarray, v: np.ndarray, generalized_force: np.ndarray) -> np.ndarray:
        """Return the acceleration (nv,) under ``generalized_force`` (nv,) and the contact wrenches."""
        model, data, contacts = self.model, self._data, self.contacts
        e, mass = self.independent, pin.crba(model, data, q).T
        force = generalized_force - pin.nle(model, data, q, v)
        if e is not None:  # for the rates y of v = E y
            mass, force = e.T @ (np.tril(mass) + np.tril(mass, -1).T) @ e, e.T @ force
        lower = cholesky(mass)
        if lower is None:
            return np.full(model.nv, np.nan)
        change = cholesky_solve(lower, force)
        if contacts.n_rows:
            rows = contact_kinematics(model, data, q, v, contacts)
            jacobian = rows.jacobian if e is None else rows.jacobian @ e
            wanted = -contacts.scale * (rows.drift + jacobian @ change)
            change = change + contact_response(lower, contacts, jacobian).least_change(wanted)
        return np.asarray(change if e is None else e @ change)
