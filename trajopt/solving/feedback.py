"""Feedback gains of a plan: the derivative of its optimal torques in the state, by a Riccati recursion.

At the start of each interval the rest of the motion is a problem of its own, from a state that may differ
from the plan's. To first order its solution minimises the quadratic form of the Lagrangian's Hessian on the
linearised rows (Fiacco, "Introduction to sensitivity and stability analysis in nonlinear programming", 1983,
ch. 3). An inequality with the multiplier lambda at the distance s from its limit adds lambda / s times the
square of its row, as in the last matrix of an interior-point method: those that are active hold. With the
cost-to-go dx^T P dx / 2 of the next node, the controls and the next node z of a stage follow from

    [W  A^T] [dz]     [B]
    [A   0 ] [dy] = - [C] dx,    P <- S + B^T dz/dx + C^T dy/dx,    K = dtau/dx + dtau/dz dz/dx

with the Hessian's blocks W, B and S, and the rows A dz + C dx = 0. Accelerations that are states may jump
where the feedback begins. Free durations of what is left adapt, unless their sum is bounded. At the end of a
cycle the cost-to-go is that of the next one, with all durations held.

Hard rows at later nodes would ask for infinite gains shortly before, or where few inputs reach them. They are
springs instead, `STIFFNESS` times as stiff as the costs of the inputs.
"""

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from trajopt.arguments import Positive, checked
from trajopt.errors import InputError
from trajopt.motion.grid import mesh_of
from trajopt.motion.solution import Solution
from trajopt.problem.problem import Problem
from trajopt.robot.units import Units
from trajopt.solving.extraction import torques_at_start
from trajopt.solving.solving import prepare
from trajopt.transcription.nlp import Nlp
from trajopt.transcription.timeline import StageKind

# Stiffness of rows and bounds at nodes over the median curvature of the Lagrangian in an input, per natural
# time. With 1e6 gains equal those of hard rows within 1e-4 half a natural time before a row.
STIFFNESS = 1e6
# Least distance from a limit that has a multiplier, scaled units.
LEAST_DISTANCE = 1e-9
# Compliance of rows that may depend on others, relative to units.
COMPLIANCE = 1e-12
# Step of central differences: of the state in natural units, of scaled variables.
STEP = 1e-6
# Least curvature in a duration over the largest: those of phases that are over have none.
LEAST_CURVATURE = 1e-9
# Cycles after which the cost-to-go of a periodic motion counts as that of endless ones.
CYCLES = 4


@checked
def with_gains(problem: Problem, solution: Solution, *, stiffness: Positive = STIFFNESS) -> Solution:
    """Return a plan with its feedback gains, see `Solution.gains`.

    Args:
        problem: the problem that the plan solves.
        solution: the plan, with its multipliers.
        stiffness: of rows and bounds at nodes, see `STIFFNESS`; less makes gains smaller before landings, and
            more robust where few inputs reach a row.

    Raises:
        InputError: for a plan without multipliers or of another problem, and for inputs that are no torques.
    """
    require_gains(problem)
    if solution.row_multiplier is None or solution.bound_multiplier is None:
        raise InputError("gains of a plan without multipliers", "allowed: a plan as its solver has found it")
    prepared = prepare(problem, mesh=mesh_of(solution), start=solution)
    rows, known = prepared.transcription.n_rows, len(solution.row_multiplier)
    if rows != known:
        raise InputError(
            f"gains of a plan with {known} multipliers for a problem with {rows} rows",
            "allowed: the problem of the plan; where bodies keep apart, solve with gains=True",
        )
    multipliers = solution.row_multiplier, solution.bound_multiplier
    tail = _Tail(prepared.nlp, prepared.guess, solution, multipliers, stiffness)
    return replace(solution, gain=tail.gains())


def require_gains(problem: Problem) -> None:
    """Raise `InputError` for a problem whose inputs are not the robot's torques: its plans have no gains."""
    if problem.actuation == "velocity":
        raise InputError(
            "gains of a plan whose inputs are velocities", "allowed: torque or jerk as actuation"
        )
    if problem.dynamics_kind == "own":
        raise InputError("gains of a plan whose dynamics are its own", "allowed: the dynamics of the robot")


@dataclass(frozen=True)
class _Form:
    """A quadratic form: scaled variables ``columns`` (n,), ascending, and its matrix (n, n)."""

    columns: np.ndarray
    matrix: np.ndarray


NOTHING = _Form(np.zeros(0, dtype=int), np.zeros((0, 0)))


class _Tail:
    """The linearised rest of a plan from each of its nodes, at scaled variables ``x``."""

    def __init__(
        self,
        nlp: Nlp,
        x: np.ndarray,
        plan: Solution,
        multipliers: tuple[np.ndarray, np.ndarray],
        stiffness: float,
    ) -> None:
        t = self.transcription = nlp.transcription
        self.layout, self.x, self.plan = t.layout, x, plan
        self.jacobian, (rows, bounds) = nlp.jacobian(x), multipliers
        self.hessian = nlp.lagrangian_hessian(x, rows)
        self.equal = t.lower_g == t.upper_g
        self.row_weight = _weights(np.array(nlp.engine.g(x)), t.lower_g, t.upper_g, rows)
        self.stiffness = stiffness * self._curvature_of_inputs()
        self.bound_weight = np.minimum(_weights(x, t.lower_x, t.upper_x, bounds), self.stiffness)
        self.adapts = t.problem.periodicity is None and t.problem.duration_bounds is None
        scales = [self.layout.node(k).start + form.time_scales for k, form in enumerate(self.layout.forms)]
        self.held = np.concatenate(scales)[: 0 if self.adapts else None]
        self.rows = [self._rows(k) for k in range(self.layout.n_stages + 1)]

    def _curvature_of_inputs(self) -> float:
        """Median curvature of the Lagrangian in an input, per natural time, scaled units."""
        layout, curvature = self.layout, self.hessian.diagonal()
        time = Units(self.transcription.problem.robot).time
        inputs = [
            curvature[layout.node(k).stop : layout.window(k).stop] * time / layout.steps[k]
            for k in layout.interval_stages
        ]
        positive = np.concatenate(inputs)
        positive = positive[positive > 0]
        return float(np.median(positive)) if len(positive) else 1.0

    def gains(self) -> np.ndarray:
        """Gains (I, nu, 2 nv) at the start of every interval."""
        layout, last = self.layout, self.layout.n_stages
        to_go = self._with_node(last, NOTHING)
        if self.transcription.problem.periodicity is not None:
            for _ in range(CYCLES):
                start = to_go
                for k in reversed(range(last)):
                    start = self._with_node(k, self._eliminated(k, start)[0])
                to_go = self._image(start)
        gains = []
        for k in reversed(range(last)):
            stage = self._eliminated(k, to_go)
            if layout.stages[k].kind is StageKind.INTERVAL:
                joined = stage[0].columns[0] < layout.node(k).start
                gains.append(self._gain(k, *(self._eliminated(k, to_go, joined=False) if joined else stage)))
            to_go = self._with_node(k, stage[0])
        return np.array(gains[::-1])

    # Elimination

    def _rows(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Rows of node k alone or with nodes before, and rows of stage k."""
        rows = np.flatnonzero(self.transcription.rows.stage == k)
        part = self.jacobian[rows]
        last = np.maximum.reduceat(np.append(part.indices, 0), part.indptr[:-1]) if len(rows) else rows
        return rows[last < self.layout.node(k).stop], rows[last >= self.layout.node(k).stop]

    def _used(self, columns: np.ndarray) -> np.ndarray:
        """The columns without durations that are held."""
        return np.setdiff1d(columns, self.held)

    def _with_node(self, k: int, form: _Form) -> _Form:
        """The form with the springs of the rows and bounds of node k."""
        node = self.layout.node(k)
        columns = np.union1d(self._used(np.arange(node.start, node.stop)), form.columns)
        rows, matrix = self.rows[k][0], np.zeros((len(columns), len(columns)))
        place = np.searchsorted(columns, form.columns)
        matrix[np.ix_(place, place)] = form.matrix
        if k == self.layout.n_stages:
            matrix += self._curvature(columns, columns)
        own = np.isin(columns, np.arange(node.start, node.stop))
        matrix[own, own] += self.bound_weight[columns[own]]
        slopes = self.jacobian[rows][:, columns].toarray()
        weight = np.where(self.equal[rows], self.stiffness, np.minimum(self.row_weight[rows], self.stiffness))
        return _Form(columns, matrix + slopes.T @ (weight[:, None] * slopes))

    def _curvature(self, columns: np.ndarray, window: np.ndarray) -> np.ndarray:
        """Hessian over the columns, zero outside of a window."""
        matrix, place = np.zeros((len(columns), len(columns))), np.searchsorted(columns, window)
        matrix[np.ix_(place, place)] = self.hessian[window][:, window].toarray()
        return matrix

    def _eliminated(self, k: int, to_go: _Form, joined: bool = True) -> tuple[_Form, np.ndarray, np.ndarray]:
        """Eliminate stage k: the form at its node, what is eliminated, and its derivative in the node.

        ``joined`` keeps the rows that join its inputs to those before.
        """
        window, rows = self.layout.window(k), self.rows[k][1]
        if not joined:
            touched = self.jacobian[rows]
            first = np.minimum.reduceat(touched.indices, touched.indptr[:-1])
            rows = rows[first >= window.start]
        own = self._used(np.arange(window.start, window.stop))
        columns = np.union1d(own, to_go.columns)
        columns = self._used(np.union1d(columns, np.unique(self.jacobian[rows].indices)))
        matrix, place = self._curvature(columns, own), np.searchsorted(columns, to_go.columns)
        matrix[np.ix_(place, place)] += to_go.matrix
        slopes, equal = self.jacobian[rows][:, columns].toarray(), self.equal[rows]
        matrix += slopes[~equal].T @ (self.row_weight[rows[~equal], None] * slopes[~equal])
        slopes = slopes[equal & (np.abs(slopes).max(axis=1, initial=0.0) > 0)]
        gone = columns >= self.layout.node(k).stop
        compliance = -COMPLIANCE * np.eye(len(slopes))
        system = np.block([[matrix[np.ix_(gone, gone)], slopes[:, gone].T], [slopes[:, gone], compliance]])
        side = np.vstack([matrix[np.ix_(gone, ~gone)], slopes[:, ~gone]])
        try:
            response = -np.linalg.solve(system, side)
        except np.linalg.LinAlgError:
            raise InputError(
                "gains of a plan whose inputs are not determined", "allowed: with a cost of the inputs"
            ) from None
        matrix = matrix[np.ix_(~gone, ~gone)] + side.T @ response
        return _Form(columns[~gone], (matrix + matrix.T) / 2), columns[gone], response[: gone.sum()]

    def _image(self, start: _Form) -> _Form:
        """The cost-to-go at the end of a cycle, from that at its start."""
        described, nv = self.plan.description.periodicity, self.plan.model.nv
        assert described is not None
        image = np.zeros((nv, nv))
        image[np.arange(nv), described.index] = described.sign
        turn, last = np.kron(np.eye(2), image), self.layout.n_stages
        change = self._change(0, start, 0) @ turn.T
        end = self._with_node(last, NOTHING)
        back = np.linalg.pinv(self._change(last, None, -1))
        return replace(end, matrix=back.T @ (change.T @ start.matrix @ change) @ back)

    # Torques

    def _gain(self, k: int, form: _Form, gone: np.ndarray, response: np.ndarray) -> np.ndarray:
        """Gain (nu, 2 nv) at the start of interval k, from its elimination."""
        sample = int(np.argmax(self.plan.interval == np.searchsorted(self.layout.interval_stages, k)))
        node = self._change(k, form, sample)
        window, t = self.layout.window(k), self.transcription
        change = np.zeros((len(self.x), node.shape[1]))
        change[form.columns], change[gone] = node, response @ node
        change, size = change[window].T, np.abs(change[window]).max(axis=0)
        step = STEP / np.maximum(size, STEP)
        ends = self.x[window] + np.array([1.0, -1.0])[:, None, None] * step[:, None] * change
        torques = torques_at_start(
            t.problem, self.layout, k, (ends * t.scale[window]).reshape(-1, len(self.x[window]))
        )
        plus, minus = torques.reshape(2, len(step), -1)
        return np.asarray(((plus - minus) / (2 * step[:, None])).T)

    def _change(self, k: int, to_go: _Form | None, sample: int) -> np.ndarray:
        """Derivative (n, 2 nv) of node k's used variables in the state, in Pinocchio's tangent.

        What may jump or adapt there is at its optimum for ``to_go``, or held.
        """
        layout, form, nv = self.layout, self.layout.forms[k], self.plan.model.nv
        node, unit = self.x[layout.node(k)], self.transcription.scale[layout.node(k)]
        state, second = form.state(node * unit)[0], np.zeros(form.coordinates.nv)
        if form.order == 3:
            second = form.acceleration(node * unit)

        def moved(change: np.ndarray) -> np.ndarray:
            q = pin.integrate(self.plan.model, self.plan.q[sample], change[:nv])
            v = self.plan.v[sample] + change[nv : 2 * nv]
            q, v, _ = layout.in_coordinates_of(form, q, v, np.zeros(nv))
            own = form.coordinates.continued(form.coordinates.node_from_pinocchio(q, v), state)
            return form.node(own, (node * unit)[form.time_scales] + change[2 * nv :], second)

        steps = STEP * np.eye(2 * nv + form.n_time_scales)
        slopes = np.array([(moved(step) - moved(-step)) / (2 * STEP) for step in steps]).T / unit[:, None]
        used = self._used(np.arange(layout.node(k).start, layout.node(k).stop)) - layout.node(k).start
        change = slopes[used, : 2 * nv]
        if to_go is None:
            return change
        free = np.hstack([slopes[:, 2 * nv :], np.eye(form.size)[:, form.accelerations]])[used]
        matrix = to_go.matrix.copy()
        if self.adapts:  # durations have their bounds at the first node
            scales = np.searchsorted(used, form.time_scales)
            matrix[scales, scales] += self.bound_weight[layout.forms[0].time_scales]
        inverse = np.linalg.pinv(free.T @ matrix @ free, rcond=LEAST_CURVATURE, hermitian=True)
        return np.asarray(change - free @ inverse @ (free.T @ matrix @ change))


def _weights(value: np.ndarray, lower: np.ndarray, upper: np.ndarray, multiplier: np.ndarray) -> np.ndarray:
    """Multipliers over the distances from the limits that they hold, zero without one."""
    with np.errstate(invalid="ignore"):
        distance = np.where(multiplier > 0, upper - value, value - lower)
    return np.where(multiplier != 0, np.abs(multiplier) / np.maximum(distance, LEAST_DISTANCE), 0.0)
