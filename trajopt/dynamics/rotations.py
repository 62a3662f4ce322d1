"""Rotations in exponential coordinates and quaternions (x, y, z, w), symbolic and smooth at zero.

With ``R = R_k exp(theta)`` and ``Jr`` the right Jacobian of SO(3) the body rates are

    omega = Jr(theta) theta',     omega' = Jr(theta) theta'' + (d/dt Jr(theta)) theta'

(Sola, Deray, Atchuthan, "A micro Lie theory", 2018, eqs. 143-147).
"""

import math
from functools import lru_cache

import casadi as ca

# Terms of the series in |theta|^2: relative error below 1e-15 up to |theta| = pi and below
# 1e-11 up to 2 pi, without a branch and so without 0/0 in any derivative.
_SERIES_TERMS = 16


def _series(t: ca.SX, first_factorial: int) -> ca.SX:
    """Sum over n of (-t)^n / (2 n + first_factorial)!, by Horner's rule."""
    factors = [(-1) ** n / math.factorial(2 * n + first_factorial) for n in reversed(range(_SERIES_TERMS))]
    return ca.polyval(ca.SX(ca.DM(factors)), t)


def exp_quaternion(theta: ca.SX) -> ca.SX:
    """Unit quaternion (x, y, z, w) of the rotation vector ``theta`` (3,) in rad, up to about a turn."""
    quarter = ca.sumsqr(theta) / 4
    return ca.vertcat(_series(quarter, 1) * theta / 2, _series(quarter, 0))


def right_jacobian(theta: ca.SX) -> ca.SX:
    """Right Jacobian (3, 3) of SO(3) at the rotation vector ``theta`` (3,) in rad."""
    t = ca.sumsqr(theta)
    cross = ca.skew(theta)
    return ca.SX.eye(3) - _series(t, 2) * cross + _series(t, 3) * ca.mtimes(cross, cross)


def quaternion_product(left: ca.SX, right: ca.SX) -> ca.SX:
    """Hamilton product of quaternions stored as (x, y, z, w)."""
    lv, lw, rv, rw = left[:3], left[3], right[:3], right[3]
    return ca.vertcat(lw * rv + rw * lv + ca.cross(lv, rv), lw * rw - ca.dot(lv, rv))


def rotation_matrix(quaternion: ca.SX) -> ca.SX:
    """Rotation matrix (3, 3) of a unit quaternion (x, y, z, w)."""
    cross = ca.skew(quaternion[:3])
    return ca.SX.eye(3) + 2 * quaternion[3] * cross + 2 * ca.mtimes(cross, cross)


def rotation_error(target: ca.SX, rotation: ca.SX) -> ca.SX:
    """Twice the Rodrigues vector of target^T rotation, 2 tan(angle / 2) times its axis, (3,).

    ``2 vee(R - R^T) / (1 + tr R)`` is smooth, and zero only where both rotations (3, 3) are equal. It is
    infinite at an angle of pi, so there is no false zero.
    """
    error = ca.mtimes(target.T, rotation)
    vee = ca.vertcat(error[2, 1] - error[1, 2], error[0, 2] - error[2, 0], error[1, 0] - error[0, 1])
    return 2 * vee / (1 + ca.trace(error))


@lru_cache(maxsize=1)
def body_rate_function() -> ca.Function:
    """theta, theta', theta'' (3,) each -> angular velocity and acceleration in the body frame."""
    theta, dtheta, ddtheta = (ca.SX.sym(name, 3) for name in ("theta", "dtheta", "ddtheta"))
    jacobian = right_jacobian(theta)
    omega = ca.mtimes(jacobian, dtheta)
    domega = ca.mtimes(jacobian, ddtheta) + ca.jtimes(omega, theta, dtheta)
    return ca.Function("body_rates", [theta, dtheta, ddtheta], [omega, domega])


def body_rates(theta: ca.SX, dtheta: ca.SX, ddtheta: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Angular velocity and acceleration in the body frame from exponential coordinates."""
    omega, domega = body_rate_function()(theta, dtheta, ddtheta)
    return omega, domega
