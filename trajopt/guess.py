"""From a motion q(t) to a guess of all unknowns: rates by differences, forces that carry the motion."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from trajopt.layout import Layout
from trajopt.model_quantities import contact_jacobian
from trajopt.transcription import Transcription

# Step of the differences that turn q(t) into v and a, s: errors far below a guess's own.
DIFFERENCE_STEP = 1e-3


def initial_guess(transcription: Transcription) -> np.ndarray:
    """Scaled unknowns (n_unknowns,) from the problem's guess; the start is the problem's own."""
    layout, problem = transcription.layout, transcription.problem
    x = np.zeros(layout.n_unknowns)
    coordinates = layout.coordinates
    previous = coordinates.node_from_pinocchio(problem.initial_q, problem.initial_v)
    x[layout.node(0)] = previous
    for k in range(1, layout.n_intervals + 1):
        q, v, _ = _state(transcription, layout.node_times[k], _firmer_phase(layout, k))
        previous = coordinates.continued(coordinates.node_from_pinocchio(q, v), previous)
        x[layout.node(k)] = previous
    for k in range(layout.n_intervals):
        phase = int(layout.phase_of[k])
        window = x[layout.node_offset[k] : layout.node_offset[k + 1]]
        for i, c in enumerate(layout.scheme.c):
            q, v, a = _state(transcription, layout.node_times[k] + c * layout.steps[k], phase)
            window[layout.local_acceleration(phase, i)] = coordinates.acceleration_from_pinocchio(q, v, a)
            window[layout.local_wrench(phase, i)] = _carrying_wrenches(layout, phase, q, v, a)
    return x / transcription.scale


def _firmer_phase(layout: Layout, k: int) -> int:
    """Of the phases that meet at node k, the one with more contacts: its feet do not move there."""
    before = int(layout.phase_of[k - 1])
    after = int(layout.phase_of[min(k, layout.n_intervals - 1)])
    return before if len(layout.contacts[before]) > len(layout.contacts[after]) else after


def _state(transcription: Transcription, t: float, phase: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(q, v, a) of the guess at time t by differences on the manifold, taken within the phase.

    A motion may have kinks between phases (a foot that leaves, a push that ends).
    """
    layout, motion = transcription.layout, transcription.problem.guess
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
    robot, contacts = layout.robot, layout.contacts[phase]
    n = robot.n_unactuated
    if n == 0 or not contacts:
        return np.zeros(layout.n_wrench(phase))
    needed = pin.rnea(robot.model, robot.model.createData(), q, v, a)[:n]
    places = [(contact.frame, contact.dimension) for contact in contacts]
    jacobian = contact_jacobian(robot.model, q, places)[:, :n]
    return np.linalg.lstsq(jacobian.T, needed, rcond=None)[0]


def perturbed(transcription: Transcription, x: np.ndarray, seed: int, sigma: float) -> np.ndarray:
    """The guess with normal noise of standard deviation ``sigma`` in scaled units, fixed unknowns left alone.

    Rotations are normalised again, so that the perturbed guess is on the manifold.
    """
    noise = np.random.default_rng(seed).normal(0.0, sigma, x.shape)
    free = transcription.lower_x < transcription.upper_x
    moved = np.where(free, x + noise, x)
    layout = transcription.layout
    for k in range(layout.n_intervals + 1):
        node = moved[layout.node(k)]
        for i in range(layout.coordinates.n_rotations):
            node[4 * i : 4 * i + 4] /= np.linalg.norm(node[4 * i : 4 * i + 4])
    return moved
