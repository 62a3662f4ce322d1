"""Integrate and difference of Pinocchio's joints on SX, without 0/0 in value or derivatives.

Pinocchio's own versions on SX give NaN derivatives at zero rotation. Near zero, a function of the squared
angle that is 0/0 there is replaced by its series, and its closed form is evaluated away from zero, so that
neither branch gives NaN. Formulas: Sola, Deray, Atchuthan, "A micro Lie theory", 2018, appendices A, B and D.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache

import casadi as ca

from trajopt.dynamics.manifold import CONTINUOUS_JOINTS
from trajopt.dynamics.rotations import quaternion_product, rotation_matrix

# Below this square of the argument the series are used: seven terms are exact to rounding there, and
# above it the closed forms lose at most four digits of sixteen to cancellation.
_SMALL = 1e-2

_SINC = (1, -1 / 6, 1 / 120, -1 / 5040, 1 / 362880, -1 / 39916800)
_ONE_MINUS_SINC = (1 / 6, -1 / 120, 1 / 5040, -1 / 362880, 1 / 39916800)
_ATAN = (1, -1 / 3, 1 / 5, -1 / 7, 1 / 9, -1 / 11, 1 / 13, -1 / 15)
_INVERSE_JACOBIAN = (1 / 12, 1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160, 691 / 1307674368000)


def _smooth(square: ca.SX, series: Sequence[float], closed: Callable[[ca.SX], ca.SX]) -> ca.SX:
    """``closed(square)``, or its series in ``square`` where that is small."""
    is_small = square < _SMALL
    return ca.if_else(is_small, _polynomial(series, square), closed(ca.if_else(is_small, 1, square)))


def _polynomial(coefficients: Sequence[float], x: ca.SX) -> ca.SX:
    value = ca.SX(0)
    for coefficient in reversed(coefficients):
        value = coefficient + x * value
    return value


def sinc(square: ca.SX) -> ca.SX:
    """``sin(x) / x`` of ``x^2``."""
    return _smooth(square, _SINC, lambda s: ca.sin(ca.sqrt(s)) / ca.sqrt(s))


def quaternion_of_rotation_vector(theta: ca.SX) -> ca.SX:
    """Unit quaternion (x, y, z, w) of a rotation vector (3,) of any length, in rad.

    ``rotations.exp_quaternion`` is a branchless series instead, smaller, and exact only to a turn or so.
    """
    quarter = ca.sumsqr(theta) / 4
    half_sinc = sinc(quarter)
    cosine = 1 - quarter * sinc(quarter / 4) ** 2 / 2  # of half the angle
    return ca.vertcat(half_sinc * theta / 2, cosine)


def log_quaternion(quaternion: ca.SX) -> ca.SX:
    """Rotation vector (3,), at most pi rad, of a unit quaternion (x, y, z, w)."""
    sign = ca.if_else(quaternion[3] < 0, -1, 1)
    vector, w = sign * quaternion[:3], sign * quaternion[3]
    s = ca.sumsqr(vector)
    is_small = s < _SMALL
    near_w = ca.if_else(is_small, w, 1)
    near = _polynomial(_ATAN, s / near_w**2) / near_w
    far_s = ca.if_else(is_small, 1, s)
    far = ca.atan2(ca.sqrt(far_s), w) / ca.sqrt(far_s)
    return 2 * vector * ca.if_else(is_small, near, far)


def left_jacobian(theta: ca.SX) -> ca.SX:
    """Left Jacobian (3, 3) of SO(3)."""
    square = ca.sumsqr(theta)
    cross = ca.skew(theta)
    quadratic = _smooth(square, _ONE_MINUS_SINC, lambda s: (1 - ca.sin(ca.sqrt(s)) / ca.sqrt(s)) / s)
    return ca.SX.eye(3) + sinc(square / 4) ** 2 / 2 * cross + quadratic * ca.mtimes(cross, cross)


def inverse_left_jacobian(theta: ca.SX) -> ca.SX:
    """Inverse of the left Jacobian (3, 3) of SO(3), for angles below 2 pi."""
    cross = ca.skew(theta)
    quadratic = _half_cotangent(ca.sumsqr(theta))
    return ca.SX.eye(3) - cross / 2 + quadratic * ca.mtimes(cross, cross)


def _half_cotangent(square: ca.SX) -> ca.SX:
    """``(1 - x/2 cot(x/2)) / x^2`` of ``x^2``."""

    def closed(s: ca.SX) -> ca.SX:
        half = ca.sqrt(s) / 2
        return (1 - half * ca.cos(half) / ca.sin(half)) / s

    return _smooth(square, _INVERSE_JACOBIAN, closed)


def _rotate(direction: ca.SX, other: ca.SX) -> ca.SX:
    """Product of two plane rotations stored as (cos, sin)."""
    return ca.vertcat(
        direction[0] * other[0] - direction[1] * other[1], direction[1] * other[0] + direction[0] * other[1]
    )


def _plane_jacobian(angle: ca.SX) -> ca.SX:
    """Left Jacobian (2, 2) of SE(2)."""
    along, across = sinc(angle**2), angle * sinc(angle**2 / 4) ** 2 / 2
    return ca.vertcat(ca.horzcat(along, -across), ca.horzcat(across, along))


def _inverse_plane_jacobian(angle: ca.SX) -> ca.SX:
    along = 1 - angle**2 * _half_cotangent(angle**2)
    return ca.vertcat(ca.horzcat(along, angle / 2), ca.horzcat(-angle / 2, along))


def _plane_matrix(direction: ca.SX) -> ca.SX:
    return ca.vertcat(ca.horzcat(direction[0], -direction[1]), ca.horzcat(direction[1], direction[0]))


def _conjugate(quaternion: ca.SX) -> ca.SX:
    return ca.vertcat(-quaternion[:3], quaternion[3])


def _integrate_joint(kind: str, q: ca.SX, v: ca.SX) -> ca.SX:
    if kind == "FreeFlyer":
        step = ca.mtimes(rotation_matrix(q[3:]), ca.mtimes(left_jacobian(v[3:]), v[:3]))
        return ca.vertcat(q[:3] + step, quaternion_product(q[3:], quaternion_of_rotation_vector(v[3:])))
    if kind == "Spherical":
        return quaternion_product(q, quaternion_of_rotation_vector(v))
    if kind == "Planar":
        step = ca.mtimes(_plane_matrix(q[2:]), ca.mtimes(_plane_jacobian(v[2]), v[:2]))
        return ca.vertcat(q[:2] + step, _rotate(q[2:], ca.vertcat(ca.cos(v[2]), ca.sin(v[2]))))
    if kind in CONTINUOUS_JOINTS:
        return _rotate(q, ca.vertcat(ca.cos(v), ca.sin(v)))
    return q + v


def _difference_joint(kind: str, q0: ca.SX, q1: ca.SX) -> ca.SX:
    if kind == "FreeFlyer":
        theta = log_quaternion(quaternion_product(_conjugate(q0[3:]), q1[3:]))
        step = ca.mtimes(rotation_matrix(q0[3:]).T, q1[:3] - q0[:3])
        return ca.vertcat(ca.mtimes(inverse_left_jacobian(theta), step), theta)
    if kind == "Spherical":
        return log_quaternion(quaternion_product(_conjugate(q0), q1))
    if kind == "Planar":
        angle = _plane_angle(q0[2:], q1[2:])
        step = ca.mtimes(_plane_matrix(q0[2:]).T, q1[:2] - q0[:2])
        return ca.vertcat(ca.mtimes(_inverse_plane_jacobian(angle), step), angle)
    if kind in CONTINUOUS_JOINTS:
        return _plane_angle(q0, q1)
    return q1 - q0


def _plane_angle(start: ca.SX, end: ca.SX) -> ca.SX:
    relative = _rotate(ca.vertcat(start[0], -start[1]), end)
    return ca.atan2(relative[1], relative[0])


def _sizes(kind: str) -> tuple[int, int]:
    special = {"FreeFlyer": (7, 6), "Spherical": (4, 3), "Planar": (4, 3)}
    if kind in special:
        return special[kind]
    if kind in CONTINUOUS_JOINTS:
        return 2, 1
    return (3, 3) if kind in ("SphericalZYX", "Translation") else (1, 1)


def _symbols(kinds: tuple[str, ...], index: int, name: str) -> tuple[ca.SX, list[ca.SX]]:
    """One symbol for all joints, and its slices by joint; ``index`` picks nq (0) or nv (1)."""
    sizes = [_sizes(kind)[index] for kind in kinds]
    symbol = ca.SX.sym(name, sum(sizes))
    offsets = [sum(sizes[:joint]) for joint in range(len(sizes) + 1)]
    return symbol, ca.vertsplit(symbol, offsets)


@lru_cache(maxsize=256)
def integrate_function(kinds: tuple[str, ...]) -> ca.Function:
    """``(q, v) -> q_next`` of joints of these kinds, in the order of their coordinates."""
    q, q_joints = _symbols(kinds, 0, "q")
    v, v_joints = _symbols(kinds, 1, "v")
    result = [_integrate_joint(*joint) for joint in zip(kinds, q_joints, v_joints, strict=True)]
    return ca.Function("integrate", [q, v], [ca.vertcat(*result)], ["q", "v"], ["q_next"])


@lru_cache(maxsize=256)
def difference_function(kinds: tuple[str, ...]) -> ca.Function:
    """``(q0, q1) -> v`` of joints of these kinds, in the order of their coordinates."""
    q0, starts = _symbols(kinds, 0, "q0")
    q1, ends = _symbols(kinds, 0, "q1")
    result = [_difference_joint(*joint) for joint in zip(kinds, starts, ends, strict=True)]
    return ca.Function("difference", [q0, q1], [ca.vertcat(*result)], ["q0", "q1"], ["v"])
