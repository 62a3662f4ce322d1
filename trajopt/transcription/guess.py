"""The guess of all variables from a motion q(t): rates by differences, forces that balance the motion.

Accelerations in an interval are derivatives of the polynomial through its rates. At a kink of the motion,
second differences would be as large as the jump of the rate over the difference step.
"""

import math
import time
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import pinocchio as pin
from typing_extensions import override

from trajopt.dynamics.model_quantities import contact_jacobian
from trajopt.robot.link_wrench import wrench_force
from trajopt.transcription.layout import Layout
from trajopt.transcription.timeline import StageKind
from trajopt.transcription.transcription import Transcription
from trajopt.transcription.variable_bounds import initial_state

# Step of the differences that turn q(t) into v, s; their error is far below that of a guess.
DIFFERENCE_STEP = 1e-3


class MotionSource(Protocol):
    """A motion from which variables are computed, in SI units and in the coordinates of each node's form."""

    def node_state(self, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return configuration, velocity and acceleration at node k, in Pinocchio's convention."""

    def at_point(self, k: int, i: int, node: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the second derivative and wrenches at point i of interval k, which starts at ``node``.

        A velocity source has the first derivative.
        """

    def impulses(self, k: int) -> np.ndarray | None:
        """Return the impulses of the impact at stage k; None for the least-norm ones that cause its jump."""


def unknowns_from_motion(
    layout: Layout, source: MotionSource, time_scales: np.ndarray, near: np.ndarray | None = None
) -> np.ndarray:
    """Return the unscaled variables (n_unknowns,) of a motion.

    Quaternion signs and whole turns continue from node to node.

    Args:
        layout: layout of the variables.
        source: the motion.
        time_scales: (n_time_scales,) durations of the free phases over their nominal ones.
        near: state from which the first node continues; None if it may take any sign and turn.
    """
    x = np.zeros(layout.n_unknowns)
    previous = {} if near is None else {id(layout.coordinates): near}
    for k, form in enumerate(layout.forms):
        q, v, a = source.node_state(k)
        state = form.coordinates.node_from_pinocchio(q, v)
        state = form.coordinates.continued(state, previous.get(id(form.coordinates), state))
        previous[id(form.coordinates)] = state
        second = form.coordinates.acceleration_from_pinocchio(q, v, a) if layout.order == 3 else None
        x[layout.node(k)] = form.node(state, time_scales, second)
    for k, stage in enumerate(layout.stages):
        window = x[layout.window(k)]
        if stage.kind is StageKind.INTERVAL:
            _fill_interval(layout, k, window, source)
        elif stage.kind is StageKind.IMPACT:
            _fill_impact(layout, k, window, x[layout.node(k + 1)], source.impulses(k))
    return x


def _fill_interval(layout: Layout, k: int, window: np.ndarray, source: MotionSource) -> None:
    """Set the highest derivative and the wrenches; jerks by the polynomial through the accelerations."""
    phase, form = layout.stages[k].phase, layout.forms[k]
    scheme, node = layout.scheme_of(phase), window[: form.size]
    values, wrenches = zip(*(source.at_point(k, i, node) for i in range(scheme.s)), strict=True)
    highest = np.array(values)
    if layout.order == 3:
        highest = scheme.differentiation[1] @ np.vstack([node[form.accelerations], highest]) / layout.steps[k]
    for i, wrench in enumerate(wrenches):
        window[layout.local_derivative(phase, i)] = highest[i]
        window[layout.local_wrench(phase, i)] = wrench


def _fill_impact(
    layout: Layout, k: int, window: np.ndarray, after: np.ndarray, impulses: np.ndarray | None
) -> None:
    """Set the jump of the rates and the impulses, by default the least-norm M (v+ - v-) = J^T impulses."""
    form, contacts = layout.forms[k], layout.touching[layout.stages[k].phase]
    window[layout.local_jump(k)] = after[form.rates] - window[form.rates]
    if impulses is None:
        (q, _), v = form.coordinates.node_to_pinocchio(form.state(np.array([window[: form.size], after])))
        mass = pin.crba(form.robot.model, form.robot.model.createData(), q)
        jacobian = contact_jacobian(form.robot.model, q, [(c.frame, c.rows) for c in contacts])
        impulses = np.linalg.lstsq(jacobian.T, mass @ (v[1] - v[0]), rcond=None)[0]
    window[layout.local_impulse(k)] = impulses


def initial_guess(transcription: Transcription, deadline: float = math.inf) -> np.ndarray:
    """Return scaled variables (n_unknowns,) from the problem's guess; a fixed start is kept.

    After ``deadline``, by `time.perf_counter`, the robot stays in the last posture that was computed.
    """
    time_scales = np.ones(transcription.layout.forms[0].n_time_scales)
    source = _ProblemGuess(transcription, deadline)
    unknowns = unknowns_from_motion(transcription.layout, source, time_scales)
    return unknowns / transcription.scale


@dataclass
class _ProblemGuess(MotionSource):
    """Variables of a problem's guess q(t): rates by differences, forces that balance the motion.

    ``last`` is the last posture that was computed, in which the robot stays after the deadline. ``states``
    holds q, v and a at the points of the current interval.
    """

    transcription: Transcription
    deadline: float
    last: np.ndarray | None = None
    states: dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]] = field(default_factory=dict)

    @override
    def node_state(self, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        layout, problem = self.transcription.layout, self.transcription.problem
        if k == 0 and problem.periodicity is None:
            return initial_state(problem, layout)
        phase, a = node_phase(layout, k), np.zeros(problem.robot.nv)
        q, v = self._state(layout.node_times[k], phase)
        if layout.order == 3:
            steps = (-DIFFERENCE_STEP, DIFFERENCE_STEP)
            before, after = (self._state(layout.node_times[k] + step, phase)[1] for step in steps)
            a = (after - before) / (2 * DIFFERENCE_STEP)
        return layout.in_coordinates_of(layout.forms[k], q, v, a)

    @override
    def at_point(self, k: int, i: int, node: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        layout = self.transcription.layout
        phase, form = layout.stages[k].phase, layout.forms[k]
        if k not in self.states:
            self.states = {k: self._states(k)}
        q, v, a = layout.in_coordinates_of(form, *(each[i] for each in self.states[k]))
        if layout.order >= 2:
            highest = form.coordinates.acceleration_from_pinocchio(q, v, a)
        else:
            highest = form.coordinates.node_from_pinocchio(q, v)[-form.coordinates.nv :]
            v, a = np.zeros_like(v), np.zeros_like(a)
        t, model = layout.node_times[k] + layout.scheme_of(phase).c[i] * layout.steps[k], form.robot.model
        given = wrench_force(model, self.transcription.problem.wrenches, t, q)
        needed = pin.rnea(model, model.createData(), q, v, a) - given
        return highest, _carrying_wrenches(layout, phase, q, needed)

    @override
    def impulses(self, k: int) -> None:
        return None

    def _states(self, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Configurations, rates and accelerations at the points of interval k, (s, nq), (s, nv), (s, nv)."""
        layout, phase = self.transcription.layout, self.transcription.layout.stages[k].phase
        method, step = layout.scheme_of(phase), layout.steps[k]
        fractions, matrix = method.differentiation
        samples = [self._state(float(layout.node_times[k] + f * step), phase) for f in fractions]
        q, v = (np.array(each) for each in zip(*samples, strict=True))
        points = np.searchsorted(fractions, method.c)
        return q[points], v[points], matrix @ v / step

    def _state(self, t: float, phase: int) -> tuple[np.ndarray, np.ndarray]:
        """Configuration and velocity at time t, by differences on the manifold within the phase.

        A motion may have kinks between phases, for example at lift-off.
        """
        layout, motion = self.transcription.layout, self.transcription.problem.guess_at
        model, stages = layout.robot.model, layout.intervals_of(phase)
        if self.last is not None and time.perf_counter() > self.deadline:
            return self.last, np.zeros(model.nv)
        low, high = layout.node_times[stages[0]], layout.node_times[stages[-1] + 1]
        step = min(DIFFERENCE_STEP, (high - low) / 4)
        middle = min(max(t, low + step), high - step)
        v = pin.difference(model, motion(middle - step), motion(middle + step)) / (2 * step)
        self.last = motion(t)
        return self.last, v


def node_phase(layout: Layout, k: int) -> int:
    """Phase whose motion node k follows.

    Where two phases meet it is the one with more contacts, because its feet do not move. At an impact, the
    nodes before and after it follow the phases before and after it.
    """
    adjacent = layout.adjacent_intervals(k)
    if adjacent.before is None or adjacent.after is None:
        only = adjacent.after if adjacent.before is None else adjacent.before
        return int(layout.phase_of[only])
    before, after = int(layout.phase_of[adjacent.before]), int(layout.phase_of[adjacent.after])
    if adjacent.impact_ahead or adjacent.impact_behind:
        return before if adjacent.impact_ahead else after
    return before if len(layout.touching[before]) > len(layout.touching[after]) else after


def _carrying_wrenches(layout: Layout, phase: int, q: np.ndarray, needed: np.ndarray) -> np.ndarray:
    """Least-norm contact wrenches with the base rows of ``needed`` (nv,); zero for a fixed base."""
    robot, contacts = layout.form_of(phase).robot, layout.contacts[phase]
    balanced = robot.actuation.balanced
    if not len(robot.actuation.balance) or not contacts:
        return np.zeros(layout.n_wrench(phase))
    places = [(contact.frame, contact.rows) for contact in contacts]
    jacobian = contact_jacobian(robot.model, q, places)
    return np.linalg.lstsq(balanced(jacobian).T, balanced(needed), rcond=None)[0]


def perturbed(transcription: Transcription, x: np.ndarray, seed: int, sigma: float) -> np.ndarray:
    """The guess with normal noise of standard deviation ``sigma`` in scaled units; fixed variables stay.

    Rotations are normalised again, so that the perturbed guess lies on the manifold. Free durations stay
    within their bounds and are the same at all nodes.
    """
    noise = np.random.default_rng(seed).normal(0.0, sigma, x.shape)
    free = transcription.lower_x < transcription.upper_x
    moved = np.where(free, x + noise, x)
    layout = transcription.layout
    first, time_scales = layout.node(0), layout.forms[0].time_scales
    bounds = transcription.lower_x[first][time_scales], transcription.upper_x[first][time_scales]
    durations = np.clip(moved[first][time_scales], *bounds)
    for k, form in enumerate(layout.forms):
        node = moved[layout.node(k)]
        node[form.time_scales] = durations
        for i in range(form.coordinates.n_rotations):
            node[4 * i : 4 * i + 4] /= np.linalg.norm(node[4 * i : 4 * i + 4])
    return moved
