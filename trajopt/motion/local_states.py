"""Conversion of states to and from an interval's local coordinates, many at a time, without CasADi.

The coordinates are relative to the interval's start: world displacement of a free-flyer, exponential
coordinates of rotations, ``R = R_0 exp(theta)`` with ``omega = Jr(theta) theta'``, and unchanged joint
positions. Arrays may have more leading axes, the same for all arrays of a call, or none for ``start``.
"""

import math

import numpy as np
import pinocchio as pin
from numpy.polynomial import Polynomial

_State = tuple[np.ndarray, np.ndarray, np.ndarray]


def _cosine_series(first: int) -> Polynomial:
    """Return the series of (-t)^n / (2 n + first)! over n, accurate to rounding up to t = pi^2."""
    return Polynomial([(-1) ** n / math.factorial(2 * n + first) for n in range(SERIES_TERMS)])


# Number of terms of the series in the squared rotation angle.
SERIES_TERMS = 16
_C2, _C3 = _cosine_series(2), _cosine_series(3)
_C2_RATE, _C3_RATE = _C2.deriv(), _C3.deriv()
_CYCLES = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
# Below this value, the sine of half an angle equals the half angle up to rounding.
SMALL_ANGLE = 1e-8


def local_state(model: pin.Model, start: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> _State:
    """Return local coordinates relative to ``start`` (..., nq) and their first two derivatives (..., nv)."""
    xi, rate, second = np.zeros(v.shape), v.copy(), a.copy()
    for joint in list(model.joints)[1:]:
        kind, iq, iv = joint.shortname(), joint.idx_q, joint.idx_v
        if kind == "JointModelFreeFlyer":
            move, turn = slice(iv, iv + 3), slice(iv + 3, iv + 6)
            rotation = rotation_matrices(q[..., iq + 3 : iq + 7])
            xi[..., move] = q[..., iq : iq + 3] - start[..., iq : iq + 3]
            rate[..., move] = _times(rotation, v[..., move])
            second[..., move] = _times(rotation, a[..., move] + _cross(v[..., turn], v[..., move]))
            xi[..., turn] = _exponential(start[..., iq + 3 : iq + 7], q[..., iq + 3 : iq + 7])
            _to_exponential(turn, xi, rate, second)
        elif kind == "JointModelPlanar":
            rotation, move = _plane_rotation(q[..., iq + 2 : iq + 4]), slice(iv, iv + 2)
            xi[..., move] = q[..., iq : iq + 2] - start[..., iq : iq + 2]
            xi[..., iv + 2] = _angle(start[..., iq + 2 : iq + 4], q[..., iq + 2 : iq + 4])
            rate[..., move] = _times(rotation, v[..., move])
            second[..., move] = _times(rotation, a[..., move] + _turned(v, iv))
        elif kind == "JointModelSpherical":
            turn = slice(iv, iv + 3)
            xi[..., turn] = _exponential(start[..., iq : iq + 4], q[..., iq : iq + 4])
            _to_exponential(turn, xi, rate, second)
        elif (joint.nq, joint.nv) == (2, 1):
            xi[..., iv] = _angle(start[..., iq : iq + 2], q[..., iq : iq + 2])
        else:
            xi[..., iv : iv + joint.nv] = q[..., iq : iq + joint.nq] - start[..., iq : iq + joint.nq]
    return xi, rate, second


def state_from_local(
    model: pin.Model, start: np.ndarray, xi: np.ndarray, rate: np.ndarray, second: np.ndarray
) -> _State:
    """Return q (..., nq), v, a (..., nv) for local coordinates relative to ``start``: inverts `local_state`.

    Quaternions get the sign that is closer to the start's.
    """
    q, v, a = np.zeros((*xi.shape[:-1], model.nq)), rate.copy(), second.copy()
    for joint in list(model.joints)[1:]:
        kind, iq, iv = joint.shortname(), joint.idx_q, joint.idx_v
        if kind == "JointModelFreeFlyer":
            move, turn = slice(iv, iv + 3), slice(iv + 3, iv + 6)
            _from_exponential(turn, xi, v, a)
            q[..., iq : iq + 3] = start[..., iq : iq + 3] + xi[..., move]
            quaternion = _turned_by(start[..., iq + 3 : iq + 7], xi[..., turn])
            q[..., iq + 3 : iq + 7] = quaternion
            back = np.swapaxes(rotation_matrices(quaternion), -1, -2)
            v[..., move] = _times(back, rate[..., move])
            a[..., move] = _times(back, second[..., move]) - _cross(v[..., turn], v[..., move])
        elif kind == "JointModelPlanar":
            move = slice(iv, iv + 2)
            q[..., iq : iq + 2] = start[..., iq : iq + 2] + xi[..., move]
            q[..., iq + 2 : iq + 4] = _direction(start[..., iq + 2 : iq + 4], xi[..., iv + 2])
            back = np.swapaxes(_plane_rotation(q[..., iq + 2 : iq + 4]), -1, -2)
            v[..., move] = _times(back, rate[..., move])
            a[..., move] = _times(back, second[..., move]) - _turned(v, iv)
        elif kind == "JointModelSpherical":
            _from_exponential(slice(iv, iv + 3), xi, v, a)
            q[..., iq : iq + 4] = _turned_by(start[..., iq : iq + 4], xi[..., iv : iv + 3])
        elif (joint.nq, joint.nv) == (2, 1):
            q[..., iq : iq + 2] = _direction(start[..., iq : iq + 2], xi[..., iv])
        else:
            q[..., iq : iq + joint.nq] = start[..., iq : iq + joint.nq] + xi[..., iv : iv + joint.nv]
    return q, v, a


def _times(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return np.asarray((matrix @ vector[..., None])[..., 0])


def rotation_matrices(quaternion: np.ndarray) -> np.ndarray:
    """Return matrices (..., 3, 3) of unit quaternions (x, y, z, w)."""
    axis, w = quaternion[..., :3], quaternion[..., 3, None, None]
    cross = _cross_matrix(axis)
    return np.asarray(np.eye(3) + 2 * (w * cross + cross @ cross))


def _cross_matrix(vector: np.ndarray) -> np.ndarray:
    matrix = np.zeros((*vector.shape, 3))
    for i, j, k in _CYCLES:
        matrix[..., k, j], matrix[..., j, k] = vector[..., i], -vector[..., i]
    return matrix


def _cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return cross products of vectors (..., 3); for few vectors much faster than NumPy's."""
    product = np.empty(np.broadcast_shapes(first.shape, second.shape))
    for i, j, k in _CYCLES:
        product[..., i] = first[..., j] * second[..., k] - first[..., k] * second[..., j]
    return product


def _product(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return products of quaternions (x, y, z, w)."""
    u, w, v, s = first[..., :3], first[..., 3:], second[..., :3], second[..., 3:]
    axis = w * v + s * u + _cross(u, v)
    return np.concatenate([axis, w * s - np.sum(u * v, axis=-1, keepdims=True)], axis=-1)


def _exponential(start: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    """Return exponential coordinates (..., 3) of rotations relative to ``start``, up to half a turn."""
    apart = _product(start * np.array([-1.0, -1.0, -1.0, 1.0]), quaternion)
    apart = np.where(apart[..., 3:] < 0, -apart, apart)
    sine = np.linalg.norm(apart[..., :3], axis=-1, keepdims=True)
    half = np.arctan2(sine, apart[..., 3:])
    return np.asarray(
        2 * apart[..., :3] * np.where(sine > SMALL_ANGLE, half / np.maximum(sine, SMALL_ANGLE), 1.0)
    )


def _turned_by(start: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Return ``start`` rotated by exponential coordinates, with the quaternion sign closer to the start's."""
    half = np.linalg.norm(theta, axis=-1, keepdims=True) / 2
    turn = np.concatenate([theta / 2 * np.sinc(half / np.pi), np.cos(half)], axis=-1)
    turned = _product(np.broadcast_to(start, (*theta.shape[:-1], 4)), turn)
    return np.asarray(np.copysign(1.0, turn[..., 3:]) * turned)


def _angle(start: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return the angle from one (cosine, sine) to another, up to half a turn."""
    cross = start[..., 0] * direction[..., 1] - start[..., 1] * direction[..., 0]
    return np.asarray(np.arctan2(cross, np.sum(start * direction, axis=-1)))


def _direction(start: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return the (cosine, sine) of ``start`` rotated by an angle."""
    return _times(_plane_rotation(np.stack([np.cos(angle), np.sin(angle)], axis=-1)), start)


def _plane_rotation(direction: np.ndarray) -> np.ndarray:
    rotation = np.empty((*direction.shape, 2))
    rotation[..., 0, 0] = rotation[..., 1, 1] = direction[..., 0]
    rotation[..., 0, 1], rotation[..., 1, 0] = -direction[..., 1], direction[..., 1]
    return rotation


def _turned(v: np.ndarray, iv: int) -> np.ndarray:
    """Return the yaw rate times the velocity rotated by 90 degrees, for a planar joint."""
    return np.asarray(v[..., iv + 2, None] * np.stack([-v[..., iv + 1], v[..., iv]], axis=-1))


def _right_jacobian(theta: np.ndarray) -> np.ndarray:
    """Return Jr = 1 - c2(t) [theta] + c3(t) [theta]^2, [theta] the cross-product matrix and t = |theta|^2."""
    squared, cross = np.sum(theta * theta, axis=-1)[..., None, None], _cross_matrix(theta)
    return np.asarray(np.eye(3) - _C2(squared) * cross + _C3(squared) * (cross @ cross))


def _to_exponential(rows: slice, xi: np.ndarray, rate: np.ndarray, second: np.ndarray) -> None:
    """Convert body rates to rates of exponential coordinates in place: omega = Jr(theta) theta'."""
    theta = xi[..., rows]
    to_theta = np.linalg.inv(_right_jacobian(theta))
    rate[..., rows] = _times(to_theta, rate[..., rows])
    second[..., rows] = _times(to_theta, second[..., rows] - _turning(theta, rate[..., rows]))


def _from_exponential(rows: slice, xi: np.ndarray, v: np.ndarray, a: np.ndarray) -> None:
    """Convert rates of exponential coordinates to body rates in place."""
    theta, to_body = xi[..., rows], _right_jacobian(xi[..., rows])
    a[..., rows] = _times(to_body, a[..., rows]) + _turning(theta, v[..., rows])
    v[..., rows] = _times(to_body, v[..., rows])


def _turning(theta: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Return (d/dt Jr(theta)) theta' along theta' = ``rate``."""
    squared = np.sum(theta * theta, axis=-1, keepdims=True)
    change = 2 * np.sum(theta * rate, axis=-1, keepdims=True)
    once = _cross(theta, rate)
    twice = _cross(theta, once)
    moved = change * (_C3_RATE(squared) * twice - _C2_RATE(squared) * once)
    return np.asarray(moved + _C3(squared) * _cross(rate, once))
