"""Numeric Pinocchio at every sample of a solution: generalised forces and contact motion."""

import warnings
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt import _numeric
from trajopt.dynamics.base_joint import BASE_JOINT, BASE_POSITION, BASE_ROWS, base_of
from trajopt.motion.robot_motion import RobotMotion
from trajopt.motion.solution import Solution
from trajopt.robot.payload import payload_wrench


@dataclass(frozen=True, kw_only=True)
class ContactPlaces:
    """Contact frames at K samples, in world axes.

    position (K, nc, 3), rotation (K, nc, 3, 3), velocity (K, nc, 6) at the frame's origin, linear rows first.
    """

    position: np.ndarray
    rotation: np.ndarray
    velocity: np.ndarray


@dataclass(frozen=True, kw_only=True)
class SampleQuantities(ContactPlaces):
    """Forces and contact motion at K samples.

    generalized_force: (K, nv) RNEA(q, v, a) - sum J^T f of the robot with its payload, minus the forces of
    joint springs and friction and of known wrenches. acceleration: (K, nc, 6) of the contact frames,
    classical, at the same points and in the same axes as their velocity.
    """

    generalized_force: np.ndarray
    acceleration: np.ndarray


def contact_places(solution: RobotMotion) -> ContactPlaces:
    """Return the contact frames at every sample of ``solution``."""
    still, unloaded = np.zeros_like(solution.v), np.zeros_like(solution.f)
    _, moved = _sampled(solution.model, solution, slice(None), still, unloaded)
    return ContactPlaces(position=moved[..., 9:12], rotation=_rotations(moved), velocity=moved[..., 12:18])


def sample_quantities(solution: Solution) -> SampleQuantities:
    """Evaluate forces and contact motion at every sample of ``solution``."""
    runs = ((int(solution.phase[rows.start]), slice(rows.start, rows.stop)) for rows in solution.phases)
    parts = [
        _sampled(solution.carrying_model(phase), solution, rows, solution.a, solution.f)
        for phase, rows in runs
    ]
    force, moved = (np.concatenate(part) for part in zip(*parts, strict=True))
    return SampleQuantities(
        generalized_force=force - solution.known_force(solution.t, solution.q, solution.v),
        position=moved[..., 9:12],
        rotation=_rotations(moved),
        velocity=moved[..., 12:18],
        acceleration=moved[..., 18:],
    )


def payload_wrenches(plan: Solution) -> np.ndarray:
    """Return the wrenches (K, nc, 6) of carried bodies on the robot, recomputed from the motion."""
    model, data = plan.model, plan.model.createData()
    wrenches = np.zeros_like(plan.f)
    for row in range(plan.n_samples):
        for body in plan.description.carried_in(int(plan.phase[row])):
            index = plan.contact_frames.index(body.frame)
            state = (plan.q[row], plan.v[row], plan.a[row])
            wrenches[row, index] += payload_wrench(model, data, body.frame, body.spatial, state)
    return wrenches


def _sampled(
    model: pin.Model, plan: RobotMotion, rows: slice, a: np.ndarray, f: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return forces (k, nv) and the motion of the contact frames (k, nc, 24), see `_numeric.sampled`."""
    frames = plan.contact_ids
    q, v = plan.q[rows], plan.v[rows]
    force, moved = _numeric.sampled(model, frames, q, v, a[rows], f[rows].reshape(len(q), 6 * len(frames)))
    return force, moved.reshape(len(force), len(frames), 24)


def _rotations(moved: np.ndarray) -> np.ndarray:
    return moved[..., :9].reshape(*moved.shape[:2], 3, 3)


def largest(values: np.ndarray) -> float | None:
    """Return the largest value, or None if there is none."""
    return float(np.max(values)) if values.size else None


def least(values: np.ndarray) -> float | None:
    """Return the smallest value, or None if there is none."""
    return float(np.min(values)) if values.size else None


def largest_known(values: Iterable[float | None]) -> float | None:
    """Return the largest value that is not None, or None if there is none."""
    return max((value for value in values if value is not None), default=None)


def state_distance(model: pin.Model, planned: np.ndarray, reached: np.ndarray) -> np.ndarray:
    """Return the distance (3,) of base position (m), base orientation (rad) and worst joint (rad or m)."""
    base = base_of(model)
    rows = BASE_ROWS[base]
    difference = pin.difference(model, planned, reached)
    position = BASE_POSITION[base]
    turn = difference[position:rows]
    if base == "virtual":  # the difference of its angles is not a rotation vector
        joint = BASE_JOINT[base]
        turn = pin.log3(_rotation(model, joint, planned).T @ _rotation(model, joint, reached))
    return np.array(
        [
            np.linalg.norm(reached[:position] - planned[:position]),
            np.linalg.norm(turn),
            np.abs(difference[rows:]).max(initial=0.0),
        ]
    )


def _rotation(model: pin.Model, joint: int, q: np.ndarray) -> np.ndarray:
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    return np.array(data.oMi[joint].rotation)


def warn_of_payloads(plans: Iterable[Solution], format: str) -> None:
    """Warn of carried bodies and wrenches that a format leaves out; torques and forces include them."""
    for plan in plans:
        left_out = [f"payload: {body.mass:g} kg on {body.frame}" for body in plan.description.payloads]
        left_out += [f"wrench on {wrench.frame}" for wrench in plan.description.wrenches]
        if left_out:
            text = f"{format} leaves out the {', '.join(left_out)}; torques and forces are those with it"
            warnings.warn(text, UserWarning, stacklevel=2)
