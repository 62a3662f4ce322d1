"""States in the local coordinates of an interval and back, by numeric Pinocchio.

The coordinates are relative to the interval's start: the displacement in the world of a free-flyer,
exponential coordinates of rotations, ``R = R_0 exp(theta)`` with ``omega = Jr(theta) theta'``, and joints as
they are.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
from numpy.polynomial import Polynomial

_State = tuple[np.ndarray, np.ndarray, np.ndarray]


def _cosine_series(first: int) -> Polynomial:
    """Sum over n of (-t)^n / (2 n + first)!, to rounding up to t = pi^2."""
    return Polynomial([(-1) ** n / math.factorial(2 * n + first) for n in range(SERIES_TERMS)])


# Terms of the series in the squared angle of a rotation.
SERIES_TERMS = 16
_C2, _C3 = _cosine_series(2), _cosine_series(3)


def local_state(model: pin.Model, start: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> _State:
    """Return local coordinates relative to ``start`` (nq,) and their first two derivatives, each (nv,)."""
    xi, rate, second = pin.difference(model, start, q), v.copy(), a.copy()
    for joint in list(model.joints)[1:]:
        kind, iq, iv = joint.shortname(), joint.idx_q, joint.idx_v
        if kind == "JointModelFreeFlyer":
            move, turn = slice(iv, iv + 3), v[iv + 3 : iv + 6]
            rotation = _rotation(q[iq + 3 : iq + 7])
            xi[move] = q[iq : iq + 3] - start[iq : iq + 3]
            rate[move] = rotation @ v[move]
            second[move] = rotation @ (a[move] + np.cross(turn, v[move]))
            _to_exponential(slice(iv + 3, iv + 6), xi, rate, second)
        elif kind == "JointModelPlanar":
            rotation, move = _plane_rotation(q[iq + 2 : iq + 4]), slice(iv, iv + 2)
            xi[move] = q[iq : iq + 2] - start[iq : iq + 2]
            rate[move] = rotation @ v[move]
            second[move] = rotation @ (a[move] + v[iv + 2] * np.array([-v[iv + 1], v[iv]]))
        elif kind == "JointModelSpherical":
            _to_exponential(slice(iv, iv + 3), xi, rate, second)
    return xi, rate, second


def state_from_local(
    model: pin.Model, start: np.ndarray, xi: np.ndarray, rate: np.ndarray, second: np.ndarray
) -> _State:
    """Return q (nq,), v, a (nv,) of local coordinates relative to ``start``: the inverse of `local_state`.

    Quaternions have the sign that is nearer to the start's.
    """
    q, v, a = pin.integrate(model, start, xi), rate.copy(), second.copy()
    for joint in list(model.joints)[1:]:
        kind, iq, iv = joint.shortname(), joint.idx_q, joint.idx_v
        if kind == "JointModelFreeFlyer":
            move, turn = slice(iv, iv + 3), slice(iv + 3, iv + 6)
            _from_exponential(turn, xi, v, a)
            there = _rotation(start[iq + 3 : iq + 7]) @ pin.exp3(xi[turn])
            q[iq : iq + 3] = start[iq : iq + 3] + xi[move]
            quaternion = pin.Quaternion(there).normalized().coeffs()
            q[iq + 3 : iq + 7] = np.copysign(1.0, quaternion @ start[iq + 3 : iq + 7]) * quaternion
            v[move] = there.T @ rate[move]
            a[move] = there.T @ second[move] - np.cross(v[turn], v[move])
        elif kind == "JointModelPlanar":
            move = slice(iv, iv + 2)
            cosine, sine = np.cos(xi[iv + 2]), np.sin(xi[iv + 2])
            there = _plane_rotation(start[iq + 2 : iq + 4]) @ np.array([[cosine, -sine], [sine, cosine]])
            q[iq : iq + 4] = [*(start[iq : iq + 2] + xi[move]), *there[:, 0]]
            v[move] = there.T @ rate[move]
            a[move] = there.T @ second[move] - v[iv + 2] * np.array([-v[iv + 1], v[iv]])
        elif kind == "JointModelSpherical":
            _from_exponential(slice(iv, iv + 3), xi, v, a)
    return q, v, a


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    return np.asarray(pin.Quaternion(np.array(quaternion)).toRotationMatrix())


def _plane_rotation(direction: np.ndarray) -> np.ndarray:
    cosine, sine = direction
    return np.array([[cosine, -sine], [sine, cosine]])


def _to_exponential(rows: slice, xi: np.ndarray, rate: np.ndarray, second: np.ndarray) -> None:
    """Turn body rates into rates of exponential coordinates: omega = Jr(theta) theta'."""
    theta = xi[rows]
    to_theta = np.linalg.inv(pin.Jexp3(theta))
    rate[rows] = to_theta @ rate[rows]
    second[rows] = to_theta @ (second[rows] - _turning(theta, rate[rows]))


def _from_exponential(rows: slice, xi: np.ndarray, v: np.ndarray, a: np.ndarray) -> None:
    """Turn rates of exponential coordinates into body rates."""
    theta, to_body = xi[rows], pin.Jexp3(xi[rows])
    a[rows] = to_body @ a[rows] + _turning(theta, v[rows])
    v[rows] = to_body @ v[rows]


def _turning(theta: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """(d/dt Jr(theta)) theta' along theta' = ``rate``.

    Jr = 1 - c2(t) [theta] + c3(t) [theta]^2 with the cross-product matrix [theta] and t = |theta|^2.
    """
    squared, change = theta @ theta, 2 * theta @ rate
    once = np.cross(theta, rate)
    twice = np.cross(theta, once)
    moved = change * (_C3.deriv()(squared) * twice - _C2.deriv()(squared) * once)
    return np.asarray(moved + _C3(squared) * np.cross(rate, once))
