"""A floating base as six virtual joints: three prismatic, then three revolute in a chosen order.

The pose of the base is that of a free-flyer: ``R = R_i(a) R_j(b) R_k(c)`` for the order "ijk", default "ZYX"
(yaw, pitch, roll), and the position p is the free-flyer's. Its twist in world axes is the base Jacobian times
the rates,

    [p'; omega] = diag(I, J_w) [p'; phi'],     J_w = [e_i, R_i e_j, R_i R_j e_k]

The outer axes of J_w become parallel as the middle angle b approaches a right angle: the singular values of
J_w are 1 and sqrt(1 +- |sin b|). The least of them is the **gimbal margin**: rates of the angles are up to
its inverse times the angular velocity, and at zero, gimbal lock, the joint-space inertia is singular.
"""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import AXES, ORDERS, virtual_joint_names, virtual_order
from trajopt.dynamics.rerooting import Body, copy_bodies
from trajopt.errors import InputError

DEFAULT_ORDER = "ZYX"

# Below this margin the angles' rates may exceed twenty times the angular velocity and their accelerations
# four hundred times: a scheme with a few points per interval no longer resolves them.
LEAST_MARGIN = 0.05

Triple = tuple[np.ndarray, np.ndarray, np.ndarray]


def require_order(order: str) -> None:
    """Raise `InputError` for an order of axes that is not one of ``ORDERS``."""
    if order not in ORDERS:
        raise InputError(f"order {order!r} of a virtual base is unknown", "one of " + ", ".join(ORDERS))


def virtual_model(model: pin.Model, order: str = DEFAULT_ORDER) -> pin.Model:
    """Return a free-flyer model with its root joint replaced by six virtual joints.

    Joints, inertias, armature, limits and frames behind the root are kept; their joint numbers grow by
    five. The root joint's frame stays on the base as an operational frame. Raises `InputError`.
    """
    require_order(order)
    if model.njoints < 2 or model.joints[1].shortname() != "JointModelFreeFlyer":
        raise InputError(f"model '{model.name}' has no free-flyer to replace", "base='freeflyer'")
    new, parent = pin.Model(), 0
    new.name, new.gravity = model.name, model.gravity
    kinds = [getattr(pin, f"JointModelP{axis}") for axis in AXES]
    kinds += [getattr(pin, f"JointModelR{axis}") for axis in order]
    for name, kind in zip(virtual_joint_names(order), kinds, strict=True):
        placement = model.jointPlacements[1] if parent == 0 else pin.SE3.Identity()
        parent = new.addJoint(parent, kind(), placement, name)
    bodies = {1: Body(parent, pin.SE3.Identity())}
    for joint in range(2, model.njoints):
        holder = int(model.parents[joint])
        on = bodies[holder].joint if holder else 0
        added = new.addJoint(on, model.joints[joint], model.jointPlacements[joint], model.names[joint])
        bodies[joint] = Body(added, pin.SE3.Identity())
    copy_bodies(model, new, bodies)
    return new


def gimbal_margin(model: pin.Model, q: np.ndarray) -> float | None:
    """Return the least gimbal margin over configurations q (nq,) or (n, nq); None for another base."""
    if virtual_order(model) is None:
        return None
    return float(margin_of(np.atleast_2d(q)[:, 4]).min())


def margin_of(middle: np.ndarray) -> np.ndarray:
    """Least singular value of J_w at the middle angle (rad): sqrt(1 - |sin b|), without cancellation."""
    nearest = np.pi / 2 + np.pi * np.round((middle - np.pi / 2) / np.pi)
    return np.asarray(np.sqrt(2.0) * np.abs(np.sin((middle - nearest) / 2)))


def gimbal_margin_along(model: pin.Model, t: np.ndarray, q: np.ndarray, v: np.ndarray) -> float | None:
    """Return the least gimbal margin of a motion, also between its samples; None for another base.

    t (n,) s, q (n, nq), v (n, nv). Between samples the middle angle is the cubic through its values and
    rates; where it passes a right angle the margin is 0.
    """
    if virtual_order(model) is None or len(t) < 2:
        return gimbal_margin(model, q)
    low, high = _reached(t, q[:, 4], v[:, 4])
    locks = np.floor(high / np.pi - 0.5) - np.floor(low / np.pi - 0.5)
    margins = np.minimum(margin_of(low), margin_of(high))
    return float(np.where(locks > 0, 0.0, margins).min())


def _reached(t: np.ndarray, b: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest value (n - 1,) of the cubic through b and its rate between consecutive times."""
    h = np.diff(t)
    start, step, first, last = b[:-1], np.diff(b), rate[:-1] * h, rate[1:] * h
    cubic, square = first + last - 2 * step, 3 * step - 2 * first - last
    # Extremes where 3 cubic s^2 + 2 square s + first = 0; roots in the form without cancellation.
    root = np.sqrt(np.maximum(square**2 - 3 * cubic * first, 0.0))
    stable = -(square + np.copysign(root, square))
    with np.errstate(divide="ignore", invalid="ignore"):
        places = np.array([stable / (3 * cubic), first / stable])
    places = np.clip(np.nan_to_num(places, nan=0.0, posinf=0.0, neginf=0.0), 0.0, 1.0)
    values = start + places * (first + places * (square + places * cubic))
    every = np.vstack([b[:-1], b[1:], values])
    return every.min(axis=0), every.max(axis=0)


def rotation_of(order: str, angles: Sequence[float] | np.ndarray) -> np.ndarray:
    """Rotation matrix ``R_i(a) R_j(b) R_k(c)`` of the angles (3,) in rad."""
    rotation = np.eye(3)
    for axis, angle in zip(order, angles, strict=True):
        rotation = rotation @ pin.utils.rotate(axis.lower(), float(angle))
    return rotation


def rotation_jacobian(order: str, angles: np.ndarray) -> np.ndarray:
    """J_w (3, 3): world-axes angular velocity from the angles' rates."""
    i, j, k = (np.eye(3)[AXES.index(axis)] for axis in order)
    outer = pin.utils.rotate(order[0].lower(), float(angles[0]))
    middle = outer @ pin.utils.rotate(order[1].lower(), float(angles[1]))
    return np.column_stack([i, outer @ j, middle @ k])


def rotation_jacobian_rate(order: str, angles: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Time derivative (3, 3) of J_w: each axis is carried by the rotations before it."""
    axes = rotation_jacobian(order, angles)
    carried = axes[:, 0] * rates[0]
    second = np.cross(carried, axes[:, 1])
    third = np.cross(carried + axes[:, 1] * rates[1], axes[:, 2])
    return np.column_stack([np.zeros(3), second, third])


def base_jacobian(order: str, angles: np.ndarray) -> np.ndarray:
    """Base Jacobian (6, 6) ``diag(I, J_w)``: world-axes twist (linear, angular) from the base's rates."""
    jacobian = np.eye(6)
    jacobian[3:, 3:] = rotation_jacobian(order, angles)
    return jacobian


def angles_of(order: str, rotation: np.ndarray, near: np.ndarray | None = None) -> np.ndarray:
    """Angles (3,) rad of a rotation matrix; with the middle one in [-pi/2, pi/2], or nearest to ``near``.

    In gimbal lock only the sum or the difference of the outer angles is determined: the last angle is then
    0, or that of ``near``.
    """
    i, j, k = (AXES.index(axis) for axis in order)
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    cosine = np.hypot(rotation[i, i], rotation[i, j])
    b = np.arctan2(sign * rotation[i, k], cosine)
    if cosine < np.finfo(float).eps ** 0.5:
        c = 0.0 if near is None else float(near[2])
        outer = rotation @ rotation_of(order[1:], [b, c]).T
        a = np.arctan2(sign * outer[(i + 2) % 3, (i + 1) % 3], outer[(i + 1) % 3, (i + 1) % 3]) * sign
    else:
        a = np.arctan2(-sign * rotation[j, k], rotation[k, k])
        c = np.arctan2(-sign * rotation[i, j], rotation[i, i])
    if near is None:
        return np.array([a, b, c])
    turn = 2 * np.pi
    both = [np.array([a, b, c]), np.array([a + np.pi, np.pi - b, c + np.pi])]
    moved = [angles + turn * np.round((near - angles) / turn) for angles in both]
    return min(moved, key=lambda angles: float(np.linalg.norm(angles - near)))


def to_free_flyer(model: pin.Model, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> Triple:
    """Free-flyer coordinates (nq + 1, nv, nv) from coordinates of the virtual-base ``model``."""
    order = virtual_order(model)
    if order is None:
        raise InputError(f"model '{model.name}' has no virtual base", "base='virtual'")
    rotation = rotation_of(order, q[3:6])
    jacobian = rotation.T @ rotation_jacobian(order, q[3:6])
    change = rotation.T @ rotation_jacobian_rate(order, q[3:6], v[3:6])
    linear, omega = rotation.T @ v[:3], jacobian @ v[3:6]
    acceleration = rotation.T @ a[:3] - np.cross(omega, linear)
    # (d/dt R^T J_w) phi' = R^T J_w' phi': the cross product of omega with itself is zero.
    turned = jacobian @ a[3:6] + change @ v[3:6]
    quaternion = pin.Quaternion(rotation).coeffs()
    return (
        np.concatenate([q[:3], quaternion, q[6:]]),
        np.concatenate([linear, omega, v[6:]]),
        np.concatenate([acceleration, turned, a[6:]]),
    )


def from_free_flyer(
    order: str, q: np.ndarray, v: np.ndarray, a: np.ndarray, near: np.ndarray | None = None
) -> Triple:
    """Coordinates of a virtual base with that ``order`` from those of a free-flyer.

    With ``near`` (3,), rad, the angles are those nearest to it, as in `angles_of`. Raises `InputError` in
    gimbal lock if the angular velocity or acceleration is not zero: no angle rates produce it.
    """
    require_order(order)
    rotation = pin.Quaternion(*q[[6, 3, 4, 5]]).toRotationMatrix()
    angles = angles_of(order, rotation, near)
    linear, omega = v[:3], v[3:6]
    acceleration = rotation @ (a[:3] + np.cross(omega, linear))
    rates, second = np.zeros(3), np.zeros(3)
    if np.any(omega) or np.any(a[3:6]):
        if margin_of(angles[1]) < np.finfo(float).eps ** 0.5:
            raise InputError("the base turns in gimbal lock", "another order of axes, or base='freeflyer'")
        jacobian = rotation_jacobian(order, angles)
        rates = np.linalg.solve(jacobian, rotation @ omega)
        drift = rotation_jacobian_rate(order, angles, rates) @ rates
        second = np.linalg.solve(jacobian, rotation @ a[3:6] - drift)
    return (
        np.concatenate([q[:3], angles, q[7:]]),
        np.concatenate([rotation @ linear, rates, v[6:]]),
        np.concatenate([acceleration, second, a[6:]]),
    )
