"""Open-loop re-integration: what the planned torques really do, by numeric Pinocchio alone.

Within an interval the torque is the Lagrange polynomial through its collocation points. With the
active contacts of the interval the acceleration solves

    M a + h = S^T tau + J^T f,      J a + Jdot v = 0                                    (KKT)

(Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 8) without any stabilisation, so that a
plan which is inconsistent between its points drifts away here. States are integrated on the
manifold, q = q_k (+) delta, with the eighth-order method of Dormand and Prince.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.certify.contact.contact_dynamics import ContactDynamics
from trajopt.certify.contact.contact_set import ContactSet
from trajopt.certify.payloads import carrying_model
from trajopt.certify.sliding import SlidingDynamics
from trajopt.dynamics.base_joint import BASE_JOINT, BASE_POSITION, BASE_ROWS, base_of
from trajopt.solution.descriptions import surfaces_of
from trajopt.solution.motion import lagrange_coefficients
from trajopt.solution.solution import Solution

PhaseDynamics = ContactDynamics | SlidingDynamics

# Far below what is measured (1e-6 at best), far above rounding.
RELATIVE_ERROR = 1e-10
ABSOLUTE_ERROR = 1e-12
# An interval of a sane plan takes about five steps of a dozen evaluations; one that needs so many has run
# away, or its accelerations are rounding: those of joints that move nothing.
MAX_EVALUATIONS = 3600


class _RunAwayError(Exception):
    """An integration takes too many evaluations."""


@dataclass(frozen=True, kw_only=True)
class OpenLoopError:
    """Largest error at the nodes of a phase: base m and rad (None for a fixed base), joints rad or m."""

    position: float | None
    orientation: float | None
    joints: float


def open_loop(solution: Solution) -> tuple[OpenLoopError, ...]:
    """Integrate every phase from its first sample with the planned torques; errors at its nodes.

    Of a velocity source the planned rates are integrated instead. An error is inf where the integration
    ran away before the phase's end.
    """
    return tuple(_phase_error(solution, phase) for phase in solution.phases)


def _phase_error(solution: Solution, phase: range) -> OpenLoopError:
    q, v = solution.q[phase.start].copy(), solution.v[phase.start].copy()
    worst: np.ndarray = np.zeros(3)
    dynamics = phase_dynamics(solution, phase.start)
    for rows in solution.intervals[solution.interval[phase.start] : solution.interval[phase.stop - 1] + 1]:
        if solution.meta.get("actuation") == "velocity":
            end = follow_rates(solution, rows, q)
        else:
            end = integrate_interval(solution, dynamics, rows, q, v)
        if end is None:
            worst[:] = np.inf
            break
        q, v = end
        worst = np.maximum(worst, state_distance(solution.model, solution.q[rows.stop - 1], q))
    if base_of(solution.model) == "fixed":
        return OpenLoopError(position=None, orientation=None, joints=float(worst[2]))
    return OpenLoopError(position=float(worst[0]), orientation=float(worst[1]), joints=float(worst[2]))


def state_distance(model: pin.Model, planned: np.ndarray, reached: np.ndarray) -> np.ndarray:
    """Distance of base position (m), base orientation (rad) and worst joint (rad or m)."""
    base = base_of(model)
    rows = BASE_ROWS[base]
    difference = pin.difference(model, planned, reached)
    position = BASE_POSITION[base]
    turn = difference[position:rows]
    if base == "virtual":  # differences of its angles are no rotation
        turn = pin.log3(_base_rotation(model, planned).T @ _base_rotation(model, reached))
    return np.array(
        [
            np.linalg.norm(reached[:position] - planned[:position]),
            np.linalg.norm(turn),
            np.abs(difference[rows:]).max(initial=0.0),
        ]
    )


def _base_rotation(model: pin.Model, q: np.ndarray) -> np.ndarray:
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    return np.array(data.oMi[BASE_JOINT[base_of(model)]].rotation)


def integrate_interval(
    solution: Solution, dynamics: ContactDynamics | SlidingDynamics, rows: range, q: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Integrate one interval from ``q``, ``v`` with its torques and contacts; None where it runs away."""
    model, nv = solution.model, solution.model.nv
    start, end = (float(time) for time in solution.interval_t[solution.interval[rows.start]])
    points = [row for row in rows if solution.collocation[row]]
    torque = lagrange_coefficients((solution.t[points] - start) / (end - start), solution.tau[points])
    powers = np.arange(len(points))
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


def follow_rates(solution: Solution, rows: range, q: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Integrate the rates of one interval, polynomials through its points, from ``q``; None if not finite."""
    model = solution.model
    start, end = (float(time) for time in solution.interval_t[solution.interval[rows.start]])
    points = [row for row in rows if solution.collocation[row]]
    velocity = lagrange_coefficients((solution.t[points] - start) / (end - start), solution.v[points])
    powers = np.arange(len(points))

    def rate(fraction: float, delta: np.ndarray) -> np.ndarray:
        to_local = pin.dIntegrate(model, q, delta, pin.ArgumentPosition.ARG1)
        return (end - start) * np.linalg.solve(to_local, fraction**powers @ velocity)

    final = _run(rate, np.zeros(model.nv))
    return None if final is None else (pin.integrate(model, q, final), velocity.sum(axis=0))


def _run(rate: Callable[[float, np.ndarray], np.ndarray], state: np.ndarray) -> np.ndarray | None:
    """Integrate from 0 to 1, or return None if that takes too many evaluations or is not finite."""
    from scipy.integrate import DOP853  # takes longer to load than all the rest

    left = itertools.count(MAX_EVALUATIONS, -1)

    def counted(fraction: float, state: np.ndarray) -> np.ndarray:
        if not next(left):  # not between steps: one that is rejected again and again has no end of its own
            raise _RunAwayError
        return rate(fraction, state)

    try:
        with np.errstate(over="ignore", invalid="ignore"):
            method = DOP853(counted, 0.0, state, 1.0, rtol=RELATIVE_ERROR, atol=ABSOLUTE_ERROR)
            while method.status == "running":
                method.step()
    except (ValueError, np.linalg.LinAlgError, _RunAwayError):
        return None
    return method.y if method.status == "finished" and np.isfinite(method.y).all() else None


def phase_dynamics(solution: Solution, row: int) -> PhaseDynamics:
    """Dynamics of the phase of a sample: the contacts that are active in it, and what is carried."""
    phase = int(solution.phase[row])
    model = carrying_model(solution, phase)
    held = active_contacts(solution, model, row)
    described = surfaces_of(solution.meta.get("surfaces"))
    surfaces = described[phase] if described else {}
    sliding = {
        index: surfaces[frame]
        for index, frame in enumerate(held.names)
        if frame in surfaces and surfaces[frame].slip_speed is not None
    }
    return SlidingDynamics(model, held, sliding) if sliding else ContactDynamics(model, held)


def active_contacts(solution: Solution, model: pin.Model, row: int) -> ContactSet:
    """The contacts of ``model`` that are active at a sample, by their frames."""
    kinds = zip(solution.contact_frames, solution.meta["contact_kinds"], solution.active[row], strict=True)
    contacts = [(frame, 3 if kind == "point" else 6) for frame, kind, on in kinds if on]
    return ContactSet.of(model, contacts)
