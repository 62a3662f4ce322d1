"""Open-loop re-integration: what the planned torques really do, by numeric Pinocchio alone.

Within an interval the torque is the Lagrange polynomial through its collocation points. With the
active contacts of the interval the acceleration solves

    M a + h = S^T tau + J^T f,      J a + Jdot v = 0                                    (KKT)

(Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 8) without any stabilisation, so that a
plan which is inconsistent between its points drifts away here. States are integrated on the
manifold, q = q_k (+) delta, with the eighth-order method of Dormand and Prince.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.linalg.lapack import dpotrf, dpotrs

from trajopt.robot_building import BASE_ROWS, base_of
from trajopt.solution import Solution

# Far below what is measured (1e-6 at best), far above rounding.
RELATIVE_ERROR = 1e-10
ABSOLUTE_ERROR = 1e-12
# An interval of a sane plan takes about five steps; one that needs so many has run away.
MAX_STEPS = 300

# Redundant contacts (four feet in a plane, a sole given as points) make J M^-1 J^T singular. A shift
# of this part of its mean eigenvalue, refined away by proximal iterations, finds the acceleration.
PROXIMAL = 1e-9
PROXIMAL_STEPS = 10
PROXIMAL_RESIDUAL = 1e-13


@dataclass(frozen=True, kw_only=True)
class OpenLoopError:
    """Largest error at the nodes of a phase: base m and rad (None for a fixed base), joints rad or m."""

    position: float | None
    orientation: float | None
    joints: float


class ContactDynamics:
    """Forward dynamics of a model with a fixed set of active contacts.

    ``frames`` are frame ids, ``dimensions`` 3 (the origin does not accelerate) or 6 (nor does it turn).
    """

    def __init__(self, model: pin.Model, frames: Sequence[int], dimensions: Sequence[int]) -> None:
        self.model = model
        self._data = model.createData()
        self._contacts = tuple(zip(frames, dimensions, strict=True))
        rows = int(sum(dimensions))
        self._jacobian, self._drift = np.zeros((rows, model.nv)), np.zeros(rows)
        self._no_acceleration = np.zeros(model.nv)

    def acceleration(self, q: np.ndarray, v: np.ndarray, generalized_force: np.ndarray) -> np.ndarray:
        """Return the acceleration (nv,) under ``generalized_force`` (nv,) and the contact forces."""
        model, data = self.model, self._data
        mass = pin.crba(model, data, q)
        free = generalized_force - pin.nle(model, data, q, v)
        factor, failed = dpotrf(mass, lower=0)
        if failed:
            return np.full(model.nv, np.nan)
        if not self._contacts:
            return dpotrs(factor, free, lower=0)[0]
        self._update_contacts(q, v)
        solved = dpotrs(factor, np.column_stack([self._jacobian.T, free]), lower=0)[0]
        response, unconstrained = solved[:, :-1], solved[:, -1]
        wanted = -self._drift - self._jacobian @ unconstrained
        return unconstrained + response @ _least_squares(self._jacobian @ response, wanted)

    def _update_contacts(self, q: np.ndarray, v: np.ndarray) -> None:
        model, data, row = self.model, self._data, 0
        pin.forwardKinematics(model, data, q, v, self._no_acceleration)
        pin.computeJointJacobians(model, data)
        for frame, dimension in self._contacts:
            rows = slice(row, row + dimension)
            jacobian = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            drift = pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            self._jacobian[rows] = jacobian[:dimension]
            self._drift[rows] = drift.vector[:dimension]
            row += dimension


def _least_squares(matrix: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Solve a positive semi-definite system whose right side may leave its range by rounding."""
    size = len(wanted)
    shifted = matrix + (PROXIMAL * np.trace(matrix) / size) * np.eye(size)
    factor, failed = dpotrf(shifted, lower=0)
    if failed:
        return np.full(size, np.nan)
    solution, residual = np.zeros(size), wanted
    enough = PROXIMAL_RESIDUAL * float(np.abs(wanted).max())
    for _ in range(PROXIMAL_STEPS):
        solution = solution + dpotrs(factor, residual, lower=0)[0]
        residual = wanted - matrix @ solution
        if np.abs(residual).max() <= enough:
            break
    return solution


def lagrange_coefficients(fractions: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return polynomial coefficients (s, n), lowest power first, through ``values`` (s, n)."""
    return np.linalg.solve(np.vander(fractions, increasing=True), values)


def open_loop(solution: Solution) -> tuple[OpenLoopError, ...]:
    """Integrate every phase from its first sample with the planned torques; errors at its nodes.

    An error is inf where the integration ran away before the phase's end.
    """
    return tuple(_phase_error(solution, phase) for phase in solution.phases)


def _phase_error(solution: Solution, phase: range) -> OpenLoopError:
    q, v = solution.q[phase.start].copy(), solution.v[phase.start].copy()
    worst: np.ndarray = np.zeros(3)
    for rows in solution.intervals[solution.interval[phase.start] : solution.interval[phase.stop - 1] + 1]:
        end = integrate_interval(solution, rows, q, v)
        if end is None:
            worst[:] = np.inf
            break
        q, v = end
        worst = np.maximum(worst, _distance(solution.model, solution.q[rows.stop - 1], q))
    if base_of(solution.model) == "fixed":
        return OpenLoopError(position=None, orientation=None, joints=float(worst[2]))
    return OpenLoopError(position=float(worst[0]), orientation=float(worst[1]), joints=float(worst[2]))


def _distance(model: pin.Model, planned: np.ndarray, reached: np.ndarray) -> np.ndarray:
    """Distance of base position (m), base orientation (rad) and worst joint (rad or m)."""
    base = base_of(model)
    rows = BASE_ROWS[base]
    difference = pin.difference(model, planned, reached)
    position = {"freeflyer": 3, "planar": 2, "fixed": 0}[base]
    return np.array(
        [
            np.linalg.norm(reached[:position] - planned[:position]),
            np.linalg.norm(difference[position:rows]),
            np.abs(difference[rows:]).max(initial=0.0),
        ]
    )


def integrate_interval(
    solution: Solution, rows: range, q: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Integrate one interval from ``q``, ``v`` with its torques; None where it runs away."""
    model, nv = solution.model, solution.model.nv
    start, end = (float(time) for time in solution.interval_t[solution.interval[rows.start]])
    points = [row for row in rows if solution.collocation[row]]
    torque = lagrange_coefficients((solution.t[points] - start) / (end - start), solution.tau[points])
    powers = np.arange(len(points))
    dynamics = _dynamics(solution, solution.active[rows.start])
    force = np.zeros(nv)

    def rate(fraction: float, state: np.ndarray) -> np.ndarray:
        delta, velocity = state[:nv], state[nv:]
        force[solution.n_unactuated :] = fraction**powers @ torque
        here = pin.integrate(model, q, delta)
        to_local = pin.dIntegrate(model, q, delta, pin.ArgumentPosition.ARG1)
        moved = np.linalg.solve(to_local, velocity)
        return (end - start) * np.concatenate([moved, dynamics.acceleration(here, velocity, force)])

    final = _run(rate, np.concatenate([np.zeros(nv), v]))
    return None if final is None else (pin.integrate(model, q, final[:nv]), final[nv:])


def _run(rate: Callable[[float, np.ndarray], np.ndarray], state: np.ndarray) -> np.ndarray | None:
    """Integrate from 0 to 1, or return None if that takes too many steps or is not finite."""
    from scipy.integrate import DOP853  # takes longer to load than all the rest

    try:
        with np.errstate(over="ignore", invalid="ignore"):
            method = DOP853(rate, 0.0, state, 1.0, rtol=RELATIVE_ERROR, atol=ABSOLUTE_ERROR)
            for _ in range(MAX_STEPS):
                method.step()
                if method.status != "running":
                    break
    except (ValueError, np.linalg.LinAlgError):
        return None
    return method.y if method.status == "finished" and np.isfinite(method.y).all() else None


def _dynamics(solution: Solution, active: np.ndarray) -> ContactDynamics:
    chosen = [index for index, on in enumerate(active) if on]
    frames = [solution.model.getFrameId(solution.contact_frames[index]) for index in chosen]
    dimensions = [3 if solution.meta["contact_kinds"][index] == "point" else 6 for index in chosen]
    return ContactDynamics(solution.model, frames, dimensions)
