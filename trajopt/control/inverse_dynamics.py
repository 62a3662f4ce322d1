"""Task-space inverse dynamics: accelerations and contact forces of one tick, by a quadratic program.

The unknowns are x = (a, f): accelerations (nv,) and the forces of the active contacts in world axes. With

    M a + h = S' tau + J' f

split into unactuated rows u and actuated rows a, torques are eliminated: tau = M_a a + h_a - J_a' f. Rows:

    M_u a - J_u' f = -h_u                                      rows without actuators
    J a = -dJ v - d J v                                        contacts stand still
    tau_min <= M_a a + h_a - J_a' f + friction <= tau_max      torque limits of drives
    a_min <= a_j <= a_max                                      joints stay within position and rate limits
    friction pyramids, normal forces, centres of pressure      `ActiveContact.force_rows`

The objective is the sum of the tasks (`trajopt.control.tasks`). If a program has no solution, the limits of
joint accelerations are dropped first, then the rows of contacts are penalised instead; the result reports it.
If that fails too, there is no torque, and the caller has to hold the joints.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate, pairwise
from typing import Self

import numpy as np
import pinocchio as pin

from trajopt.control.contact_forces import ActiveContact
from trajopt.control.gains import TrackerGains
from trajopt.control.limits import TickLimits
from trajopt.control.quadratic_programs import (
    UNBOUNDED,
    QpRows,
    QpSolverName,
    QuadraticSolver,
    quadratic_solver,
)
from trajopt.control.robot_state import RobotState
from trajopt.control.tasks import Task
from trajopt.errors import InputError
from trajopt.robot.actuators.actuation import Actuation
from trajopt.robot.natural_units import NaturalUnits

# Weight of relaxed contact rows, relative to a task of weight one.
PENALTY = 1e4
REGULARISATION = 1e-8  # weight of every scaled unknown: keeps programs strictly convex
# Relative singular value below which contact rows are dependent: several points on one link, up to rounding.
DEPENDENT = 1e-8
RELAXED = ("nothing", "joint limits", "contacts", "everything")


@dataclass(frozen=True, kw_only=True)
class TickResult:
    """Torques (nu,), accelerations (nv,) and forces (nc', 6) of the active contacts, in their order.

    ``relaxed`` is an index into `RELAXED`; for "everything" torques are zero and meaningless. ``slack`` is
    the largest scaled violation of the relaxed rows: accelerations of contacts over g, and those of joints
    beyond their limits over g or g / l. It is zero if nothing was relaxed, and for "everything".
    """

    torque: np.ndarray
    acceleration: np.ndarray
    forces: np.ndarray
    relaxed: int
    iterations: int
    slack: float = 0.0


@dataclass
class TaskSpaceInverseDynamics:
    """Quadratic programs of one robot, set up once for each combination of contacts.

    Args:
        state: state of the robot.
        actuation: actuation of the robot.
        acceleration_unit: scale of accelerations in unknowns and rows (nv,), m/s^2 and rad/s^2.
        force_units: scales of forces and moments, N and N m.
        torque_unit: scale of the rows of the dynamics (nv,), N or N m.
        damping: coefficient d of contact rows, 1/s.
        solver: solver of the programs.
    """

    state: RobotState
    actuation: Actuation
    acceleration_unit: np.ndarray
    force_units: tuple[float, float]
    torque_unit: np.ndarray
    damping: float
    solver: QpSolverName = "piqp"
    _solvers: dict[tuple[object, ...], QuadraticSolver] = field(default_factory=dict, init=False)

    @classmethod
    def of(
        cls,
        state: RobotState,
        actuation: Actuation,
        units: NaturalUnits,
        *,
        damping: float = TrackerGains().contact,
        solver: QpSolverName = "piqp",
    ) -> Self:
        """Programs scaled by the natural units of the robot; ``damping`` is in these units, too."""
        return cls(
            state=state,
            actuation=actuation,
            acceleration_unit=units.acceleration(state.model),
            force_units=(units.weight, units.weight * units.length),
            torque_unit=units.generalized_force(state.model),
            damping=damping / units.time,
            solver=solver,
        )

    def held(self, bandwidth: float, q: np.ndarray, v: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """Torques (nu,) with joint feedback towards q (nq,), v (nv,), for ticks without a solution.

        The bandwidth is in 1/s.
        """
        state, rows, held = self.state, self.actuation.rows, torque.copy()
        error, rate = pin.difference(state.model, state.q, q)[rows], (v - state.v)[rows]
        inertia = np.diagonal(state.mass)[rows]
        held[: len(rows)] += inertia * (bandwidth**2 * error + 2 * bandwidth * rate)
        return held

    def solve(
        self, contacts: Sequence[ActiveContact], tasks: Sequence[Task], limits: TickLimits
    ) -> TickResult:
        """Solve at the last state of `RobotState.update`."""
        program = _Program(self, contacts, limits)
        first, after = ([task for task in tasks if task.priority == level] for level in (1, 2))
        cost, slope, kept = program.objective(first)
        second = program.objective(after)[:2] if after else None
        iterations = 0
        for relaxed in range(3):
            rows = program.rows(relaxed)
            if relaxed == 2:
                cost = cost + PENALTY * program.motion.T @ program.motion
                slope = slope - PENALTY * (program.still @ program.motion)
            solution = self._solver(("first", relaxed == 2), contacts, rows).solve(cost, slope, rows)
            iterations += solution.iterations
            if not solution.solved:
                continue
            x = solution.x
            if second is not None:
                equal, value = np.vstack([rows.equal, kept]), np.append(rows.value, kept @ x)
                rows = replace(rows, equal=equal, value=value)
                lower = self._solver(("second", relaxed == 2), contacts, rows).solve(*second, rows)
                iterations += lower.iterations
                x = lower.x if lower.solved else x
            return program.result(x, relaxed, iterations)
        return program.result(np.zeros(program.n), 3, iterations)

    def _solver(
        self, key: tuple[object, ...], contacts: Sequence[ActiveContact], rows: QpRows
    ) -> QuadraticSolver:
        kinds = tuple((c.number, c.dimension, c.bilateral, c.sliding is None) for c in contacts)
        known = (*key, kinds, rows.shape)
        if known not in self._solvers:
            self._solvers[known] = quadratic_solver(self.solver, rows.shape)
        return self._solvers[known]


def _independent(rows: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Independent combinations of rows (m, n) and values (m,), with the same least-squares solution."""
    left, singular, _ = np.linalg.svd(rows, full_matrices=False)
    span = left[:, singular > DEPENDENT * singular.max(initial=0.0)].T
    return span @ rows, span @ value


class _Program:
    """The program of one tick in scaled unknowns."""

    def __init__(
        self, owner: TaskSpaceInverseDynamics, contacts: Sequence[ActiveContact], limits: TickLimits
    ) -> None:
        self.owner, self.contacts, self.limits = owner, contacts, limits
        state = owner.state
        self.nv = state.model.nv
        sizes = [contact.dimension for contact in contacts]
        self.first = [self.nv, *(self.nv + total for total in accumulate(sizes))]
        self.n = self.first[-1]
        unit = [owner.force_units[row > 2] for size in sizes for row in range(size)]
        self.unit = np.concatenate([owner.acceleration_unit, unit])
        self.dynamics = np.empty((self.nv, self.n))
        self.dynamics[:, : self.nv] = state.mass
        for contact, first in zip(contacts, self.first, strict=False):
            self.dynamics[:, first : first + contact.dimension] = -contact.jacobian(state).T
        motion = [contact.motion_rows(state, owner.damping) for contact in contacts]
        count = sum(len(value) for _, value in motion)
        self.motion, self.still = np.zeros((count, self.n)), np.zeros(count)
        row = 0
        for rows, value in motion:
            self.motion[row : row + len(value), : self.nv] = rows
            self.still[row : row + len(value)] = value
            row += len(value)
        self.motion *= self.unit / owner.acceleration_unit[0]
        self.still /= owner.acceleration_unit[0]
        joints = [state.joint(contact.frame) for contact in contacts]
        if len(set(joints)) < len(joints):
            self.motion, self.still = _independent(self.motion, self.still)

    def rows(self, relaxed: int) -> QpRows:
        """Rows on the scaled unknowns; see `RELAXED`."""
        owner, limits, n = self.owner, self.limits, self.n
        actuation, h = owner.actuation, owner.state.nonlinear
        driven, scaled = actuation.rows, (self.dynamics * self.unit).T
        unit, scale = (of(owner.torque_unit) for of in (actuation.balance_unit, actuation.input_unit))
        equal, value = actuation.balanced(scaled).T / unit[:, None], -actuation.balanced(h) / unit
        if actuation.leading.size < owner.state.model.nv:
            follow = actuation.coupling * self.unit[: self.nv]
            rows = np.hstack([follow, np.zeros((len(follow), n - self.nv))])
            equal, value = np.vstack([equal, rows]), np.append(value, np.zeros(len(follow)))
        if relaxed < 2 and len(self.still):
            equal, value = np.vstack([equal, self.motion]), np.append(value, self.still)
        bias = actuation.inputs(h) + limits.friction
        forces = [contact.force_rows(owner.state) for contact in self.contacts]
        row = len(scale)
        between = np.zeros((row + sum(len(low) for _, low, _ in forces), n))
        between[:row] = actuation.inputs(scaled).T / scale[:, None]
        for contact, first, (own_rows, low, _) in zip(self.contacts, self.first, forces, strict=False):
            columns = slice(first, first + contact.dimension)
            between[row : row + len(low), columns] = own_rows * (self.unit[columns] / owner.force_units[0])
            row += len(low)
        low, high = ((limit - bias) / scale for limit in limits.torque)
        lows = [low, *(low / owner.force_units[0] for _, low, _ in forces)]
        highs = [high, *(high / owner.force_units[0] for *_, high in forces)]
        units, (least, most) = owner.acceleration_unit[driven], limits.acceleration
        return QpRows(
            equal=equal,
            value=value,
            between=between,
            low=np.concatenate(lows),
            high=np.concatenate(highs),
            bounded=driven,
            least=np.full(len(driven), -UNBOUNDED) if relaxed else least / units,
            most=np.full(len(driven), UNBOUNDED) if relaxed else most / units,
        )

    def objective(self, tasks: Sequence[Task]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """P (n, n) and c (n,) of the tasks of one priority, and their rows (r, n), on scaled unknowns."""
        parts = [task.rows(self.owner.state, self.contacts) for task in tasks]
        ends = [0, *accumulate(len(part.value) for part in parts)]
        rows, value = np.zeros((ends[-1], self.n)), np.zeros(ends[-1])
        for task, part, (begin, end) in zip(tasks, parts, pairwise(ends), strict=True):
            root = math.sqrt(task.weight)
            rows[begin:end, : self.nv] = root * part.acceleration
            if part.force is not None:
                rows[begin:end, self.nv :] = root * part.force
            value[begin:end] = root * part.value
        if not np.isfinite(value).all():
            bad = next(
                task for task, part in zip(tasks, parts, strict=True) if not np.isfinite(part.value).all()
            )
            raise InputError(f"{type(bad).__name__} asks for what is not finite", "allowed: finite numbers")
        rows *= self.unit
        cost = rows.T @ rows
        cost.flat[:: self.n + 1] += REGULARISATION
        return cost, -(value @ rows), rows

    def result(self, scaled: np.ndarray, relaxed: int, iterations: int) -> TickResult:
        """Torques, accelerations and forces of scaled unknowns."""
        x, state = scaled * self.unit, self.owner.state
        forces = np.zeros((len(self.contacts), 6))
        for row, (contact, first) in enumerate(zip(self.contacts, self.first, strict=False)):
            forces[row, : contact.dimension] = x[first : first + contact.dimension]
        torque = self.owner.actuation.inputs(self.dynamics @ x + state.nonlinear) + self.limits.friction
        if relaxed == 3:
            torque = np.zeros_like(torque)
        return TickResult(
            torque=np.clip(torque, *self.limits.torque),
            acceleration=x[: self.nv],
            forces=forces,
            relaxed=relaxed,
            iterations=iterations,
            slack=self._slack(scaled, relaxed),
        )

    def _slack(self, scaled: np.ndarray, relaxed: int) -> float:
        """Largest scaled violation of the relaxed rows at scaled unknowns (n,)."""
        if relaxed not in (1, 2):
            return 0.0
        joints = self.owner.actuation.rows
        low, high = self.limits.acceleration
        unit, accelerations = self.owner.acceleration_unit[joints], scaled[joints]
        beyond = np.maximum(low / unit - accelerations, accelerations - high / unit)
        moved = np.abs(self.motion @ scaled - self.still)
        return float(max(0.0, beyond.max(initial=0.0), moved.max(initial=0.0) if relaxed == 2 else 0.0))
