"""Numeric Pinocchio at every sample of a solution: generalised forces and motion of the contacts."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import BASE_JOINT, BASE_POSITION, BASE_ROWS, base_of
from trajopt.dynamics.model_quantities import generalized_force
from trajopt.motion.carried import carrying_model
from trajopt.solution.solution import Solution


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
    """What the robot does at K samples.

    generalized_force: (K, nv) RNEA(q, v, a) - sum J^T f, of the robot with what it carries, without what
    springs and friction of joints give. acceleration (K, nc, 6, classical): of the contact frames, like their
    velocity.
    """

    generalized_force: np.ndarray
    acceleration: np.ndarray


def contact_places(solution: Solution) -> ContactPlaces:
    """The contact frames at every sample of ``solution``."""
    model = solution.model
    data = model.createData()
    frames = [model.getFrameId(frame) for frame in solution.contact_frames]
    size = (solution.n_samples, len(frames))
    position, rotation, velocity = np.zeros((*size, 3)), np.zeros((*size, 3, 3)), np.zeros((*size, 6))
    for row, (q, v) in enumerate(zip(solution.q, solution.v, strict=True)):
        pin.forwardKinematics(model, data, q, v)
        for index, frame in enumerate(frames):
            placement = pin.updateFramePlacement(model, data, frame)
            position[row, index], rotation[row, index] = placement.translation, placement.rotation
            velocity[row, index] = pin.getFrameVelocity(model, data, frame, pin.LOCAL_WORLD_ALIGNED).vector
    return ContactPlaces(position=position, rotation=rotation, velocity=velocity)


def sample_quantities(solution: Solution) -> SampleQuantities:
    """Evaluate every sample of ``solution``."""
    model = solution.model
    loaded = {number: carrying_model(solution, number) for number in np.unique(solution.phase).tolist()}
    frames = [model.getFrameId(frame) for frame in solution.contact_frames]
    count, contacts = solution.n_samples, len(frames)
    force = np.zeros((count, model.nv))
    position, rotation = np.zeros((count, contacts, 3)), np.zeros((count, contacts, 3, 3))
    velocity, acceleration = np.zeros((count, contacts, 6)), np.zeros((count, contacts, 6))
    axes = pin.LOCAL_WORLD_ALIGNED
    for row in range(count):
        if row == 0 or solution.phase[row] != solution.phase[row - 1]:
            model = loaded[int(solution.phase[row])]
            data = model.createData()
        q, v, a = solution.q[row], solution.v[row], solution.a[row]
        force[row] = generalized_force(model, data, (q, v, a), frames, solution.f[row])
        pin.forwardKinematics(model, data, q, v, a)
        for index, frame in enumerate(frames):
            placement = pin.updateFramePlacement(model, data, frame)
            position[row, index], rotation[row, index] = placement.translation, placement.rotation
            velocity[row, index] = pin.getFrameVelocity(model, data, frame, axes).vector
            acceleration[row, index] = pin.getFrameClassicalAcceleration(model, data, frame, axes).vector
    return SampleQuantities(
        generalized_force=force - solution.joint_force(solution.q, solution.v),
        position=position,
        rotation=rotation,
        velocity=velocity,
        acceleration=acceleration,
    )


def largest(values: np.ndarray) -> float | None:
    """Return the largest value, None where there is none."""
    return float(np.max(values)) if values.size else None


def least(values: np.ndarray) -> float | None:
    """Return the least value, None where there is none."""
    return float(np.min(values)) if values.size else None


def largest_known(values: Iterable[float | None]) -> float | None:
    """Return the largest of the values that are not None, None without any."""
    return max((value for value in values if value is not None), default=None)


def state_distance(model: pin.Model, planned: np.ndarray, reached: np.ndarray) -> np.ndarray:
    """Distance of base position (m), base orientation (rad) and worst joint (rad or m)."""
    base = base_of(model)
    rows = BASE_ROWS[base]
    difference = pin.difference(model, planned, reached)
    position = BASE_POSITION[base]
    turn = difference[position:rows]
    if base == "virtual":  # differences of its angles are not a rotation
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
