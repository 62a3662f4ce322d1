"""Numeric quantities of a Pinocchio model that several modules use: mass, weight, contact forces."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from trajopt.errors import InputError

# Scale of accelerations where a model has no gravity, m/s^2.
STANDARD_GRAVITY = 9.81


def gravity_of(model: pin.Model) -> float:
    """Norm of the model's gravity in m/s^2, or `STANDARD_GRAVITY` where there is none."""
    return float(np.linalg.norm(model.gravity.linear)) or STANDARD_GRAVITY


def joints_of_rows(model: pin.Model) -> list[str]:
    """Name of the joint of every row of v (nv,)."""
    moving = list(model.joints)[1:]  # not the universe
    return [str(model.names[joint.id]) for joint in moving for _ in range(joint.nv)]


def mass_of(model: pin.Model) -> float:
    """Total mass of the moving bodies in kg."""
    return float(sum(inertia.mass for inertia in list(model.inertias)[1:]))


def require_shapes(model: pin.Model, **values: np.ndarray) -> None:
    """Raise `InputError` unless ``q`` is (nq,) and every other value (nv,)."""
    for name, value in values.items():
        size = model.nq if name == "q" else model.nv
        if np.shape(value) != (size,):
            raise InputError(f"{name} has shape {np.shape(value)}", f"shape ({size},)")


def mass_matrix_at(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """M (nv, nv) at q (nq,), symmetric, armature included. Raises `InputError` for another shape."""
    require_shapes(model, q=q)
    upper = np.triu(pin.crba(model, model.createData(), q))
    return upper + np.triu(upper, 1).T


def contact_jacobian(
    model: pin.Model,
    q: np.ndarray,
    contacts: Sequence[tuple[str, int | Sequence[int]]],
    levers: Sequence[np.ndarray | None] = (),
) -> np.ndarray:
    """Rows (n, nv) of the contacts' frame Jacobians at q (nq,), world-aligned axes.

    ``contacts`` are frame names with their dimension, 3 (linear) or 6 (linear, angular), or with the indices
    of the rows to take. ``levers`` holds for each contact None or, for a rolling ball, the vector (3,), m,
    from its point of contact to its centre; its linear rows are then those of v - omega x lever.
    """
    data = model.createData()
    blocks = [np.zeros((0, model.nv))]
    for (frame, taken), lever in zip(contacts, levers or [None] * len(contacts), strict=True):
        rows = range(taken) if isinstance(taken, int) else taken
        jacobian = pin.computeFrameJacobian(model, data, q, model.getFrameId(frame), pin.LOCAL_WORLD_ALIGNED)
        jacobian = jacobian.reshape(6, model.nv)  # a single joint gives a vector
        if lever is not None:
            jacobian[:3] = without_rolling(jacobian, lever)
        blocks.append(jacobian[list(rows)])
    return np.vstack(blocks)


def without_rolling(motion: np.ndarray, lever: ArrayLike) -> np.ndarray:
    """Linear rows (3, ...) of a ball's twist, acceleration or Jacobian (6, ...) without its rolling motion.

    ``v - omega x lever`` for its centre, with the lever (3,), m, from the point of contact to the centre.
    """
    return np.asarray(motion[:3] + pin.skew(np.asarray(lever)) @ motion[3:])


def generalized_force(
    model: pin.Model,
    data: pin.Data,
    motion: tuple[np.ndarray, np.ndarray, np.ndarray],
    frames: Sequence[int],
    wrenches: np.ndarray,
) -> np.ndarray:
    """``RNEA(q, v, a) - sum J^T f`` (nv,) of a motion (q, v, a).

    ``wrenches`` (n, 6) act on the robot at the origins of ``frames`` (ids) in world axes, N and N m.
    """
    force = pin.rnea(model, data, *motion)
    pin.computeJointJacobians(model, data, motion[0])
    pin.updateFramePlacements(model, data)
    for frame, wrench in zip(frames, wrenches, strict=True):
        force = force - pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED).T @ wrench
    return force
