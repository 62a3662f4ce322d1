"""Whether q, v and a of an interval belong to one motion: quadrature in the interval's own coordinates.

In the local coordinates of an interval (world position of a free-flyer, exponential coordinates
relative to the start for rotations, joints as they are) collocation makes the acceleration a
polynomial through its points, so that quadratures of matching order are exact up to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.solution import Solution

# Step of the central difference of Jr(theta) theta' along theta': its error is near 1e-10 relative.
DIRECTION_STEP = 1e-5
# Samples closer than this part of the interval are one point of the quadrature.
SAME_POINT = 1e-9


@dataclass(frozen=True)
class Gaps:
    """Worst mismatch of position (m, rad) and of velocity (m/s, rad/s) over one interval."""

    position: float
    velocity: float


def interval_gaps(solution: Solution) -> Gaps:
    """Return the worst difference between ends of an interval and what integration gives.

    position: end minus start minus the integral of the velocity polynomial through all samples.
    velocity: end minus start minus the integral of the acceleration polynomial through the
    collocation points. Both vanish up to rounding for collocation of the acceleration; schemes
    that are inconsistent within an interval (semi-implicit Euler) show their step error.
    """
    found = [_interval(solution, rows) for rows in solution.intervals]
    return Gaps(max(gap.position for gap in found), max(gap.velocity for gap in found))


def _interval(solution: Solution, rows: range) -> Gaps:
    start, end = solution.interval_t[solution.interval[rows.start]]
    fractions = (solution.t[rows.start : rows.stop] - start) / (end - start)
    points = np.flatnonzero(solution.collocation[rows.start : rows.stop])
    local = [_local(solution.model, solution.q[rows.start], *_state(solution, row)) for row in rows]
    xi, rate, second = (np.array(part) for part in zip(*local, strict=True))
    distinct = np.concatenate([[0], 1 + np.flatnonzero(np.diff(fractions) > SAME_POINT)])
    step = end - start
    position = xi[-1] - xi[0] - step * quadrature_weights(fractions[distinct]) @ rate[distinct]
    velocity = rate[-1] - rate[0] - step * quadrature_weights(fractions[points]) @ second[points]
    return Gaps(float(np.abs(position).max()), float(np.abs(velocity).max()))


def _state(solution: Solution, row: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return solution.q[row], solution.v[row], solution.a[row]


def quadrature_weights(fractions: np.ndarray) -> np.ndarray:
    """Return weights (n,) on [0, 1] that are exact for polynomials through ``fractions`` (n,)."""
    moments = 1.0 / np.arange(1, len(fractions) + 1)
    weights: np.ndarray = np.linalg.solve(np.vander(fractions, increasing=True).T, moments)
    return weights


def _local(
    model: pin.Model, start: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Local coordinates relative to ``start`` and their first two derivatives, each (nv,)."""
    xi, rate, second = pin.difference(model, start, q), v.copy(), a.copy()
    for joint in list(model.joints)[1:]:
        kind, iq, iv = joint.shortname(), joint.idx_q, joint.idx_v
        if kind == "JointModelFreeFlyer":
            rotation, move, turn = (
                pin.Quaternion(q[iq + 3 : iq + 7]).toRotationMatrix(),
                slice(iv, iv + 3),
                v[iv + 3 : iv + 6],
            )
            xi[move] = q[iq : iq + 3] - start[iq : iq + 3]
            rate[move] = rotation @ v[move]
            second[move] = rotation @ (a[move] + np.cross(turn, v[move]))
            _rotation_rates(slice(iv + 3, iv + 6), xi, rate, second)
        elif kind == "JointModelPlanar":
            cosine, sine = q[iq + 2 : iq + 4]
            rotation, move = np.array([[cosine, -sine], [sine, cosine]]), slice(iv, iv + 2)
            xi[move] = q[iq : iq + 2] - start[iq : iq + 2]
            rate[move] = rotation @ v[move]
            second[move] = rotation @ (a[move] + v[iv + 2] * np.array([-v[iv + 1], v[iv]]))
        elif kind == "JointModelSpherical":
            _rotation_rates(slice(iv, iv + 3), xi, rate, second)
    return xi, rate, second


def _rotation_rates(rows: slice, xi: np.ndarray, rate: np.ndarray, second: np.ndarray) -> None:
    """Turn body rates into rates of exponential coordinates: omega = Jr(theta) theta'."""
    theta = xi[rows]
    to_theta = np.linalg.inv(pin.Jexp3(theta))
    rate[rows] = to_theta @ rate[rows]
    ahead, behind = (pin.Jexp3(theta + sign * DIRECTION_STEP * rate[rows]) for sign in (1, -1))
    turning = (ahead - behind) @ rate[rows] / (2 * DIRECTION_STEP)
    second[rows] = to_theta @ (second[rows] - turning)
