"""Task-space inverse dynamics: accelerations and contact forces of one tick, by a quadratic program.

Unknowns are x = (a, f): accelerations (nv,) and the forces of the active contacts in world axes. With

    M a + h = S' tau + J' f

split into unactuated rows u and actuated ones, torques are eliminated: tau = M_a a + h_a - J_a' f. Rows:

    M_u a - J_u' f = -h_u                                      rows without actuators
    J a = -dJ v - d J v                                        contacts stand still
    tau_min <= M_a a + h_a - J_a' f + friction <= tau_max      drives
    a_min <= a_j <= a_max                                      joints stay within position and rate limits
    friction pyramids, normal forces, centres of pressure      `ActiveContact.force_rows`

The objective is that of the tasks (`trajopt.control.tasks`). If a program has no solution, rows are relaxed
in this order, and the result says so: limits of joint acceleration; contacts (penalised instead). If that
fails too, there is no torque, and the caller has to hold the joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from trajopt.control.contact_forces import ActiveContact
from trajopt.control.quadratic_programs import UNBOUNDED, QpSolverName, QuadraticSolver, quadratic_solver
from trajopt.control.robot_state import RobotState
from trajopt.control.tasks import Task
from trajopt.errors import InputError

# Weight of contact rows where they are relaxed, over that of a task of weight one.
PENALTY = 1e4
# Of every unknown over its unit: keeps programs strictly convex.
REGULARISATION = 1e-8
RELAXED = ("nothing", "joint limits", "contacts", "everything")


@dataclass(frozen=True, kw_only=True)
class TickLimits:
    """Limits at a tick: torques (nu,) N m, and accelerations (nu,) that keep joints within theirs."""

    torque: tuple[np.ndarray, np.ndarray]
    acceleration: tuple[np.ndarray, np.ndarray]
    friction: np.ndarray


@dataclass(frozen=True, kw_only=True)
class TickResult:
    """Torques (nu,), accelerations (nv,) and forces (nc', 6) of the active contacts, in their order.

    relaxed: index into `RELAXED`. With "everything" torques are zero and say nothing.
    slack: largest violation of the rows that were relaxed, over their units: accelerations of contacts, g,
    and of joints beyond their limits, g or g / l. Zero where none was, and with "everything".
    """

    torque: np.ndarray
    acceleration: np.ndarray
    forces: np.ndarray
    relaxed: int
    iterations: int
    slack: float = 0.0


@dataclass
class InverseDynamics:
    """Programs of one robot, set up once for each number of contact rows.

    Args:
        state: of the robot.
        n_unactuated: rows of v without an actuator, which come first.
        acceleration_unit: (nv,), m/s^2 and rad/s^2, which scales unknowns and rows.
        force_units: of forces and moments, N and N m.
        torque_unit: (nv,) of the rows of the dynamics.
        damping: d of contact rows, 1/s.
        solver: of the programs.
    """

    state: RobotState
    n_unactuated: int
    acceleration_unit: np.ndarray
    force_units: tuple[float, float]
    torque_unit: np.ndarray
    damping: float
    solver: QpSolverName = "piqp"
    _solvers: dict[tuple[object, ...], QuadraticSolver] = field(default_factory=dict, init=False)

    def solve(
        self, contacts: Sequence[ActiveContact], tasks: Sequence[Task], limits: TickLimits
    ) -> TickResult:
        """Solve at the state that was last given to `RobotState.update`."""
        program = _Program(self, contacts, limits)
        first, after = ([task for task in tasks if task.priority == level] for level in (1, 2))
        cost, slope, kept = program.objective(first)
        second = program.objective(after)[:2] if after else None
        iterations = 0
        for relaxed in range(3):
            rows = program.rows(relaxed)
            if relaxed == 2:
                cost, slope = program.with_penalty(cost, slope)
            found = self._solver(("first", relaxed == 2), contacts, rows).solve(cost, slope, *rows)
            iterations += found.iterations
            if not found.solved:
                continue
            x = found.x
            if second is not None:
                held = kept @ x
                rows = np.vstack([rows[0], kept]), np.append(rows[1], held), np.append(rows[2], held)
                lower = self._solver(("second", relaxed == 2, len(kept)), contacts, rows).solve(
                    *second, *rows
                )
                iterations += lower.iterations
                x = lower.x if lower.solved else x
            return program.result(x, relaxed, iterations)
        return program.result(np.zeros(program.n), 3, iterations)

    def _solver(
        self,
        key: tuple[object, ...],
        contacts: Sequence[ActiveContact],
        rows: tuple[np.ndarray, np.ndarray, np.ndarray],
    ) -> QuadraticSolver:
        shape = rows[0].shape
        known = (
            *key,
            tuple((c.number, c.dimension, c.bilateral, c.sliding is None) for c in contacts),
            shape,
        )
        if known not in self._solvers:
            self._solvers[known] = quadratic_solver(self.solver, shape[1], shape[0])
        return self._solvers[known]


class _Program:
    """The program of one tick in scaled unknowns."""

    def __init__(self, owner: InverseDynamics, contacts: Sequence[ActiveContact], limits: TickLimits) -> None:
        self.owner, self.contacts, self.limits = owner, contacts, limits
        state = owner.state
        self.nv = state.model.nv
        sizes = [contact.dimension for contact in contacts]
        self.first = np.concatenate([[0], np.cumsum(sizes)]).astype(int) + self.nv
        self.n = int(self.first[-1])
        unit = [owner.force_units[row > 2] for size in sizes for row in range(size)]
        self.unit = np.concatenate([owner.acceleration_unit, unit])
        stacked = [state.frame(c.frame).jacobian[: c.dimension] for c in contacts]
        jacobian = np.vstack([np.zeros((0, self.nv)), *stacked])
        self.dynamics = np.hstack([state.mass, -jacobian.T])
        motion = [contact.motion_rows(state, owner.damping) for contact in contacts]
        self.motion = np.vstack([np.zeros((0, self.nv)), *(rows for rows, _ in motion)])
        self.still = np.concatenate([np.zeros(0), *(value for _, value in motion)])

    def rows(self, relaxed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows (m, n) on the scaled unknowns and their bounds; see `RELAXED`."""
        owner, state, limits, n = self.owner, self.owner.state, self.limits, self.n
        u, h = owner.n_unactuated, state.nonlinear
        scale = owner.torque_unit
        blocks, lows, highs = (
            [self.dynamics[:u] / scale[:u, None]],
            [-h[:u] / scale[:u]],
            [-h[:u] / scale[:u]],
        )
        if relaxed < 2 and len(self.motion):
            unit = owner.acceleration_unit[0]
            blocks.append(np.hstack([self.motion, np.zeros((len(self.motion), n - self.nv))]) / unit)
            lows.append(self.still / unit)
            highs.append(self.still / unit)
        own = h[u:] + limits.friction
        blocks.append(self.dynamics[u:] / scale[u:, None])
        lows.append((limits.torque[0] - own) / scale[u:])
        highs.append((limits.torque[1] - own) / scale[u:])
        for contact, first in zip(self.contacts, self.first, strict=False):
            rows, low, high = contact.force_rows(state)
            whole = np.zeros((len(rows), n))
            whole[:, first : first + contact.dimension] = rows / owner.force_units[0]
            blocks.append(whole)
            lows.append(low / owner.force_units[0])
            highs.append(high / owner.force_units[0])
        units = owner.acceleration_unit[u:]
        joints = np.zeros((self.nv - u, n))
        joints[np.arange(self.nv - u), np.arange(u, self.nv)] = 1.0 / units
        blocks.append(joints)
        low, high = limits.acceleration
        lows.append(np.full(len(units), -UNBOUNDED) if relaxed else low / units)
        highs.append(np.full(len(units), UNBOUNDED) if relaxed else high / units)
        return np.vstack(blocks) * self.unit, np.concatenate(lows), np.concatenate(highs)

    def objective(self, tasks: Sequence[Task]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """P (n, n) and c (n,) of the tasks of one priority, and their rows (r, n), on scaled unknowns."""
        n, blocks, values = self.n, [np.zeros((0, self.n))], [np.zeros(0)]
        for task in tasks:
            found = task.rows(self.owner.state, self.contacts)
            if not np.isfinite(found.value).all():
                raise InputError(
                    f"{type(task).__name__} asks for what is not finite", "allowed: finite numbers"
                )
            whole = np.zeros((len(found.value), n))
            whole[:, : self.nv] = found.acceleration
            if found.force is not None:
                whole[:, self.nv :] = found.force
            root = np.sqrt(task.weight)
            blocks.append(root * whole * self.unit)
            values.append(root * found.value)
        rows, value = np.vstack(blocks), np.concatenate(values)
        return rows.T @ rows + REGULARISATION * np.eye(n), -rows.T @ value, rows

    def with_penalty(self, cost: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The objective with contact rows penalised."""
        unit = self.owner.acceleration_unit[0]
        rows = np.hstack([self.motion, np.zeros((len(self.motion), self.n - self.nv))]) * self.unit / unit
        return cost + PENALTY * rows.T @ rows, slope - PENALTY * rows.T @ (self.still / unit)

    def result(self, scaled: np.ndarray, relaxed: int, iterations: int) -> TickResult:
        """Torques, accelerations and forces of scaled unknowns."""
        x, u, state = scaled * self.unit, self.owner.n_unactuated, self.owner.state
        forces = np.zeros((len(self.contacts), 6))
        for row, (contact, first) in enumerate(zip(self.contacts, self.first, strict=False)):
            forces[row, : contact.dimension] = x[first : first + contact.dimension]
        torque = self.dynamics[u:] @ x + state.nonlinear[u:] + self.limits.friction
        if relaxed == 3:
            torque = np.zeros_like(torque)
        return TickResult(
            torque=np.clip(torque, *self.limits.torque),
            acceleration=x[: self.nv],
            forces=forces,
            relaxed=relaxed,
            iterations=iterations,
            slack=self._slack(x[: self.nv], relaxed),
        )

    def _slack(self, acceleration: np.ndarray, relaxed: int) -> float:
        """Largest violation of the rows that are relaxed by accelerations (nv,), over their units."""
        if relaxed not in (1, 2):
            return 0.0
        unit, own = self.owner.acceleration_unit, slice(self.owner.n_unactuated, None)
        low, high = self.limits.acceleration
        beyond = np.maximum(low - acceleration[own], acceleration[own] - high) / unit[own]
        moved = np.abs(self.motion @ acceleration - self.still) / unit[0]
        return float(max(0.0, beyond.max(initial=0.0), moved.max(initial=0.0) if relaxed == 2 else 0.0))
