"""From a motion q(t) to a guess of all unknowns: rates by differences, forces that carry the motion."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from trajopt.dynamics.model_quantities import contact_jacobian
from trajopt.transcription.layout import Layout
from trajopt.transcription.timeline import NodeForm, StageKind
from trajopt.transcription.transcription import Transcription
from trajopt.transcription.variable_bounds import start_of

# Step of the differences that turn q(t) into v and a, s: errors far below a guess's own.
DIFFERENCE_STEP = 1e-3

State = tuple[np.ndarray, np.ndarray, np.ndarray]


def initial_guess(transcription: Transcription) -> np.ndarray:
    """Scaled unknowns (n_unknowns,) from the problem's guess; the start is the problem's own."""
    layout, problem = transcription.layout, transcription.problem
    x = np.zeros(layout.n_unknowns)
    previous: dict[int, np.ndarray] = {}
    for k, form in enumerate(layout.forms):
        if k == 0 and problem.periodicity is None:
            q, v = start_of(problem, layout)
        else:
            q, v, _ = in_form(
                layout, form, _state(transcription, layout.node_times[k], node_phase(layout, k))
            )
        state = form.coordinates.node_from_pinocchio(q, v)
        state = form.coordinates.continued(state, previous.get(id(form.coordinates), state))
        previous[id(form.coordinates)] = state
        x[layout.node(k)] = form.node(state, np.ones(form.n_clocks))
    for k, stage in enumerate(layout.stages):
        window = x[layout.window(k)]
        if stage.kind is StageKind.INTERVAL:
            _fill_interval(transcription, k, window)
        elif stage.kind is StageKind.IMPACT:
            fill_impact(layout, k, window, x[layout.node(k + 1)])
    return x / transcription.scale


def _fill_interval(transcription: Transcription, k: int, window: np.ndarray) -> None:
    layout, phase, form = (
        transcription.layout,
        int(transcription.layout.phase_of[k]),
        transcription.layout.forms[k],
    )
    for i, c in enumerate(layout.scheme_of(phase).c):
        whole = _state(transcription, layout.node_times[k] + c * layout.steps[k], phase)
        q, v, a = in_form(layout, form, whole)
        if layout.order == 2:
            highest = form.coordinates.acceleration_from_pinocchio(q, v, a)
        else:
            highest = form.coordinates.node_from_pinocchio(q, v)[-form.coordinates.nv :]
            v, a = np.zeros_like(v), np.zeros_like(a)
        window[layout.local_derivative(phase, i)] = highest
        window[layout.local_wrench(phase, i)] = _carrying_wrenches(layout, phase, q, v, a)


def fill_impact(layout: Layout, k: int, window: np.ndarray, after: np.ndarray) -> None:
    """The jump between the rates of both nodes, and least impulses for it: M (v+ - v-) = J^T impulses."""
    form, contacts = layout.forms[k], layout.touching[layout.stages[k].phase]
    window[layout.local_jump(k)] = after[form.rates] - window[form.rates]
    states = [form.coordinates.node_to_pinocchio(form.state(node)) for node in (window[: form.size], after)]
    (q, before), (_, behind) = ((q[0], v[0]) for q, v in states)
    mass = pin.crba(form.robot.model, form.robot.model.createData(), q)
    jacobian = contact_jacobian(form.robot.model, q, [(c.frame, c.rows) for c in contacts])
    window[layout.local_impulse(k)] = np.linalg.lstsq(jacobian.T, mass @ (behind - before), rcond=None)[0]


def in_form(layout: Layout, form: NodeForm, state: State) -> State:
    """A state of the whole robot in the coordinates of a form."""
    for mode in layout.modes.values():
        if mode.robot is form.robot:
            q, v, a, _ = mode.dropped(*state)
            return q, v, a
    return state


def node_phase(layout: Layout, k: int) -> int:
    """Phase whose motion node k follows.

    Of two phases that meet there, the one with more contacts: its feet do not move. Across an impact
    each side has its own.
    """
    meeting = layout.meeting(k)
    if meeting.before is None or meeting.after is None:
        only = meeting.after if meeting.before is None else meeting.before
        return int(layout.phase_of[only])
    before, after = int(layout.phase_of[meeting.before]), int(layout.phase_of[meeting.after])
    if meeting.impact_ahead or meeting.impact_behind:
        return before if meeting.impact_ahead else after
    return before if len(layout.touching[before]) > len(layout.touching[after]) else after


def _state(transcription: Transcription, t: float, phase: int) -> State:
    """(q, v, a) of the guess at time t by differences on the manifold, taken within the phase.

    A motion may have kinks between phases (a foot that leaves, a push that ends).
    """
    layout, motion = transcription.layout, transcription.problem.guess_at
    model = layout.robot.model
    stages = layout.intervals_of(phase)
    low, high = layout.node_times[stages[0]], layout.node_times[stages[-1] + 1]
    step = min(DIFFERENCE_STEP, (high - low) / 4)
    middle = min(max(t, low + step), high - step)
    before, centre, after = (motion(middle + offset) for offset in (-step, 0.0, step))
    forward, backward = pin.difference(model, centre, after), pin.difference(model, before, centre)
    return (
        centre if middle == t else motion(t),
        (forward + backward) / (2 * step),
        (forward - backward) / step**2,
    )


def _carrying_wrenches(layout: Layout, phase: int, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Least wrenches at active contacts whose base rows carry the motion (nothing for a fixed base)."""
    robot, contacts = layout.form_of(phase).robot, layout.contacts[phase]
    n = robot.n_unactuated
    if n == 0 or not contacts:
        return np.zeros(layout.n_wrench(phase))
    needed = pin.rnea(robot.model, robot.model.createData(), q, v, a)[:n]
    places = [(contact.frame, contact.rows) for contact in contacts]
    jacobian = contact_jacobian(robot.model, q, places)[:, :n]
    return np.linalg.lstsq(jacobian.T, needed, rcond=None)[0]


def perturbed(transcription: Transcription, x: np.ndarray, seed: int, sigma: float) -> np.ndarray:
    """The guess with normal noise of standard deviation ``sigma`` in scaled units, fixed unknowns left alone.

    Rotations are normalised again, so that the perturbed guess is on the manifold; free durations stay
    within their bounds, the same at all nodes.
    """
    noise = np.random.default_rng(seed).normal(0.0, sigma, x.shape)
    free = transcription.lower_x < transcription.upper_x
    moved = np.where(free, x + noise, x)
    layout = transcription.layout
    first, clocks = layout.node(0), layout.forms[0].clocks
    bounds = transcription.lower_x[first][clocks], transcription.upper_x[first][clocks]
    durations = np.clip(moved[first][clocks], *bounds)
    for k, form in enumerate(layout.forms):
        node = moved[layout.node(k)]
        node[form.clocks] = durations
        for i in range(form.coordinates.n_rotations):
            node[4 * i : 4 * i + 4] /= np.linalg.norm(node[4 * i : 4 * i + 4])
    return moved
