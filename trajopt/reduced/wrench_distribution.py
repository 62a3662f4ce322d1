"""Redistribution of contact wrenches at every point for the least torques within limits, motion unchanged.

Let w_0 be the wrenches of the active contacts and N an orthonormal basis of the internal forces, the changes
that leave the base rows unchanged, J_base^T N = 0. With w = w_0 + N y and tau(y) = tau_0 - J_joints^T N y,
OSQP solves at every point

    min  sum (tau(y) / (m g l))^2 + eps |y|^2 + rho s
    s.t. the problem's contact terms                 friction, pressure, soles
         lower - s tau_max <= tau(y) <= upper + s tau_max,   s >= 0

By the exact penalty on the largest excess s, torques exceed their limits only if no distribution keeps them
within. The contact terms are the problem's own, affine in the wrenches. The smooth friction cone is replaced
by its inscribed pyramid, widened to contain w_0; a step that would leave the cone itself is shortened.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import osqp
from scipy import sparse
from scipy.linalg import null_space

from trajopt.arguments import checked
from trajopt.dynamics.manifold import Coordinates
from trajopt.dynamics.model_quantities import contact_jacobian
from trajopt.errors import InputError
from trajopt.motion.grid import interpolated
from trajopt.motion.samples import SampleQuantities, sample_quantities
from trajopt.motion.solution import Solution
from trajopt.problem.problem import Problem
from trajopt.reduced.two_stage import TorqueBounds, problem_torque_limit, torque_bounds
from trajopt.robot.contact import set_rolling_moments
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.friction import ContactConstraint, FrictionCone, FrictionPyramid, NormalForce
from trajopt.terms.interfaces import PointConstraint

# Weight that keeps the wrenches where torques do not depend on them, in natural units.
KEEPING = 1e-6
# Weight of the largest excess. It is above the multipliers of the limits, which are of order one, so that
# limits take precedence; with 100, OSQP does not converge at some points.
PENALTY = 10.0
# OSQP's tolerance, natural units: below that of the motion's solver.
QP_TOLERANCE = 1e-9
QP_ITERATIONS = 20_000
# Contact rows may worsen by this fraction of their unit, half of what ``check`` allows, because OSQP's
# polishing sometimes fails. Larger violations are removed by bisection of the step.
TRUSTED = 5e-7
BISECTIONS = 20


@checked
def redistribute_wrenches(problem: Problem, solution: Solution) -> Solution:
    """Return the solution with redistributed wrenches and the torques that follow; the motion is unchanged.

    Between the points, wrenches and torques follow the interpolating polynomials as in any solution. Wrenches
    stay if there is no internal force, or if OSQP finds nothing better. In ``more`` of the statistics,
    ``redistributed`` counts the points that changed and those that did not. ``effort_limit`` is the full
    problem's.

    Args:
        problem: The full problem, with its limits and contact terms.
        solution: A motion of its schedule.

    Raises:
        InputError: If the problem has phases in minimal coordinates, or the solution is of another robot.
    """
    if problem.modes or solution.v.shape[1] != problem.robot.nv:
        raise InputError("wrenches are redistributed for the whole robot in its own coordinates", "no modes")
    samples, bounds = sample_quantities(solution), torque_bounds(problem, solution.v)
    phases = {i: _Phase(problem, i) for i, phase in enumerate(problem.schedule.phases) if phase.contacts}
    f, torque = solution.f.copy(), problem.robot.actuation.inputs(samples.generalized_force)
    changed, points = 0, np.flatnonzero(solution.collocation)
    for row in points:
        phase = phases.get(int(solution.phase[row]))
        shared = phase.share(solution, samples, bounds, int(row)) if phase else None
        if shared is not None:
            f[row], torque[row] = shared
            changed += 1
    f, torque = interpolated(solution, f), interpolated(solution, torque)
    limit = np.asarray(problem.robot.actuated_row_limit(problem_torque_limit(problem)))
    counts = {"points": changed, "kept": len(points) - changed}
    return replace(
        solution.with_description(effort_limit=np.minimum(limit, sys.float_info.max)),
        statistics=replace(solution.statistics, more={**solution.statistics.more, "redistributed": counts}),
        f=f,
        tau=torque,
    )


@dataclass(frozen=True)
class _Rows:
    """Contact rows (n,) over their units and their Jacobian, as functions of (w, frames, parameters)."""

    function: ca.Function
    parameters: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    @classmethod
    def of(cls, terms: list[PointConstraint], context: Context, units: Units) -> _Rows:
        term_rows = [rows for rows in (term.rows(context, units) for term in terms) if rows is not None]
        none = np.zeros(0)
        w = ca.vertcat(*context.unknown_wrenches.values())
        unit = np.concatenate([none, *[rows.unit for rows in term_rows]])
        phi = ca.vertcat(ca.SX(0, 1), *[rows.expression for rows in term_rows]) / ca.DM(unit)
        inputs = [w, context.frame_symbols(), context.parameters]
        function = ca.Function("contact_rows", inputs, [phi, ca.jacobian(phi, w)])
        lower = np.concatenate([none, *[rows.lower for rows in term_rows]]) / unit
        upper = np.concatenate([none, *[rows.upper for rows in term_rows]]) / unit
        return cls(function, context.parameter_values, lower, upper)

    def at(self, w: np.ndarray, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the rows (n,) and their Jacobian (n, n_w) at wrenches w."""
        values, jacobian = self.function(w, frames, self.parameters)
        return np.asarray(values).ravel(), np.asarray(ca.densify(jacobian))


class _Phase:
    """Contact terms of one phase, and the quadratic program at its points."""

    def __init__(self, problem: Problem, index: int) -> None:
        self.robot, phase = problem.robot, problem.schedule.phases[index]
        self.units = Units(self.robot)
        self.contacts = tuple(self.robot.contact(name) for name in phase.contacts)
        self.arms = problem.levers[index]
        self.entries = [
            (self.robot.contacts.index(contact), row) for contact in self.contacts for row in contact.rows
        ]
        terms: list[PointConstraint] = [
            term
            for term in problem.terms
            if isinstance(term, ContactConstraint | NormalForce) and term.acts_in(phase.name)
        ]
        coordinates, surfaces = Coordinates(self.robot.model), problem.surfaces_of(index)
        contexts = [Context(self.robot, coordinates, self.contacts, surfaces=surfaces) for _ in range(2)]
        self.exact = _Rows.of(terms, contexts[0], self.units)
        inscribed = [
            FrictionPyramid(friction=term.friction, contacts=term.contacts, during=term.during)
            if isinstance(term, FrictionCone)
            else term
            for term in terms
        ]
        self.affine = _Rows.of(inscribed, contexts[1], self.units)
        self.frames = [list(context.frames) for context in contexts]

    def share(
        self, solution: Solution, samples: SampleQuantities, bounds: TorqueBounds, row: int
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return wrenches (nc, 6) and torques (nu,) at one sample, or None if they stay."""
        which, rows = (np.array(part) for part in zip(*self.entries, strict=True))
        w = solution.f[row][which, rows]
        places = [(contact.frame, 6) for contact in self.contacts]
        arms = [self.arms.get(contact.name) for contact in self.contacts]
        full = contact_jacobian(self.robot.model, solution.q[row], places, arms)
        jacobian = full[[6 * i + k for i, contact in enumerate(self.contacts) for k in contact.rows]]
        unit, actuation = self.units.wrench[rows], self.robot.actuation
        basis = unit[:, None] * null_space(
            (unit[:, None] * actuation.balanced(jacobian)).T / self.robot.weight
        )
        if basis.shape[1] == 0:
            return None
        torque = actuation.inputs(samples.generalized_force[row])
        levers = -actuation.inputs(jacobian).T @ basis
        exact, affine = (
            (contact_rows, _frame_values(self.robot.contacts, samples, row, names))
            for contact_rows, names in zip((self.exact, self.affine), self.frames, strict=True)
        )
        limits = (bounds.lower[row], bounds.upper[row], bounds.scale)
        y = _program((torque, levers, self.units.torque), basis, limits, affine, w)
        if y is None:
            return None
        y *= _longest_step(exact, w, basis @ y)
        f = solution.f[row].copy()
        f[which, rows] = w + basis @ y
        set_rolling_moments(f, self.robot.contacts, self.arms)
        return f, torque + levers @ y


def _frame_values(contacts: tuple, samples: SampleQuantities, row: int, names: list[str]) -> np.ndarray:
    """Return values of a context's frame symbols: rotation by columns, position, velocity, acceleration."""
    order = [contact.frame for contact in contacts]
    parts = [np.zeros(0)]
    for name in names:
        i = order.index(name)
        parts += [samples.rotation[row, i].ravel(order="F"), samples.position[row, i]]
        parts += [samples.velocity[row, i], samples.acceleration[row, i]]
    return np.concatenate(parts)


def _program(
    joints: tuple[np.ndarray, np.ndarray, float],
    basis: np.ndarray,
    limits: tuple[np.ndarray, np.ndarray, np.ndarray],
    contact: tuple[_Rows, np.ndarray],
    w: np.ndarray,
) -> np.ndarray | None:
    """Solve the module's quadratic program for internal forces y (k,); None if OSQP finds nothing better."""
    (torque, levers, unit), (low, high, scale), k = joints, limits, basis.shape[1]
    use, slope = torque / scale, levers / scale[:, None]
    values, jacobian = contact[0].at(w, contact[1])
    ones, still = np.ones((len(torque), 1)), np.zeros((len(values), 1))
    rows = np.block([
        [slope, ones], [slope, -ones], [jacobian @ basis, still], [np.zeros((1, k)), np.ones((1, 1))],
    ])  # fmt: skip
    free = np.full(len(torque), np.inf)
    # Bounds admit the residuals of the motion's solver, so that y = 0 is always feasible.
    lower = np.concatenate([low / scale - use, -free, np.minimum(contact[0].lower - values, 0.0), [0.0]])
    upper = np.concatenate([free, high / scale - use, np.maximum(contact[0].upper - values, 0.0), [np.inf]])
    hessian = np.zeros((k + 1, k + 1))
    hessian[:k, :k] = 2 * (levers.T @ levers / unit**2 + KEEPING * np.eye(k))
    gradient = np.append(2 * levers.T @ torque / unit**2, PENALTY)
    solver = osqp.OSQP()
    solver.setup(
        sparse.csc_matrix(np.triu(hessian)), gradient, sparse.csc_matrix(rows), lower, upper,
        verbose=False, polishing=True, eps_abs=QP_TOLERANCE, eps_rel=QP_TOLERANCE, max_iter=QP_ITERATIONS,
    )  # fmt: skip
    result = solver.solve(raise_error=False)
    if result.x is None or not np.isfinite(result.x).all():
        return None
    y = result.x[:k]

    def cost(y: np.ndarray) -> float:
        moved = torque + levers @ y
        beyond = max(0.0, float((np.maximum(moved - high, low - moved) / scale).max()))
        return float(np.sum((moved / unit) ** 2)) + PENALTY * beyond

    return y if cost(y) < cost(np.zeros(k)) else None


def _longest_step(contact: tuple[_Rows, np.ndarray], w: np.ndarray, step: np.ndarray) -> float:
    """Return the largest fraction of the step, at most 1, that does not worsen the exact contact terms."""
    rows, frames = contact

    def violation(at: np.ndarray) -> float:
        values, _ = rows.at(at, frames)
        return float(np.maximum(rows.lower - values, values - rows.upper).max(initial=0.0))

    allowed = violation(w) + TRUSTED
    if violation(w + step) <= allowed:
        return 1.0
    least, most = 0.0, 1.0
    for _ in range(BISECTIONS):
        middle = (least + most) / 2
        least, most = (middle, most) if violation(w + middle * step) <= allowed else (least, middle)
    return least
