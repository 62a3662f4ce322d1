"""Placements of all joints at many configurations at once, by numpy instead of a loop over Pinocchio."""

import numpy as np
import pinocchio as pin

from trajopt.dynamics.manifold import CONTINUOUS_JOINTS
from trajopt.dynamics.rerooting import joint_motion

Placements = tuple[np.ndarray, np.ndarray]


def joint_placements(model: pin.Model, configurations: np.ndarray) -> Placements:
    """Rotations (njoints, K, 3, 3) and origins (njoints, K, 3) m, world, at configurations (K, nq)."""
    q = np.asarray(configurations, dtype=float)
    rotation = np.empty((model.njoints, len(q), 3, 3))
    origin = np.empty((model.njoints, len(q), 3))
    rotation[0], origin[0] = np.eye(3), 0.0
    for index in range(1, model.njoints):
        parent, place = int(model.parents[index]), model.jointPlacements[index]
        turn, shift = _within(model, index, q)
        before = rotation[parent] @ place.rotation
        rotation[index] = before @ turn
        origin[index] = origin[parent] + rotation[parent] @ place.translation
        origin[index] += np.einsum("kij,kj->ki", before, shift)
    return rotation, origin


def _within(model: pin.Model, index: int, q: np.ndarray) -> Placements:
    """What joint ``index`` adds: rotations (K, 3, 3) and displacements (K, 3) m."""
    joint = model.joints[index]
    kind = joint.shortname().removeprefix("JointModel")
    q_joint = q[:, joint.idx_q : joint.idx_q + joint.nq]
    still, straight = np.zeros((len(q), 3)), np.broadcast_to(np.eye(3), (len(q), 3, 3))
    if kind == "FreeFlyer":
        return _of_quaternions(q_joint[:, 3:]), q_joint[:, :3]
    if kind == "Spherical":
        return _of_quaternions(q_joint), still
    if kind == "Translation":
        return straight, q_joint
    if kind == "Planar":
        moved = np.column_stack([q_joint[:, :2], np.zeros(len(q))])
        return _about(np.array([0.0, 0.0, 1.0]), q_joint[:, 2], q_joint[:, 3]), moved
    if joint.nv == 1 and not kind.startswith(("H", "Composite", "Mimic")):
        motion = joint_motion(joint)
        if kind in CONTINUOUS_JOINTS:
            return _about(motion.angular, q_joint[:, 0], q_joint[:, 1]), still
        if motion.angular.any():
            return _about(motion.angular, np.cos(q_joint[:, 0]), np.sin(q_joint[:, 0])), still
        return straight, q_joint * motion.linear
    return _one_by_one(joint, q)


def _one_by_one(joint: pin.JointModel, q: np.ndarray) -> Placements:
    """The same for any joint, by Pinocchio."""
    data, rows = joint.createData(), []
    for row in q:
        joint.calc(data, row)
        rows.append(data.M.homogeneous)
    places = np.array(rows).reshape(-1, 4, 4)
    return places[:, :3, :3], places[:, :3, 3]


def _about(axis: np.ndarray, cosine: np.ndarray, sine: np.ndarray) -> np.ndarray:
    """Rotations (K, 3, 3) about a unit ``axis`` (3,): Rodrigues' formula."""
    cross = pin.skew(axis)
    return np.asarray(np.eye(3) + sine[:, None, None] * cross + (1 - cosine)[:, None, None] * (cross @ cross))


def _of_quaternions(xyzw: np.ndarray) -> np.ndarray:
    """Rotations (K, 3, 3) of unit quaternions (K, 4), the scalar last."""
    x, y, z, w = xyzw.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
