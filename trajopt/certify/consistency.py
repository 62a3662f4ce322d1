"""Whether q, v and a of an interval belong to one motion: quadrature in the interval's own coordinates.

In the local coordinates of an interval (world position of a free-flyer, exponential coordinates
relative to the start for rotations, joints as they are) collocation makes the acceleration a
polynomial through its points, so that quadratures of matching order are exact up to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajopt.solution.local_states import local_state
from trajopt.solution.solution import Solution

# Samples closer than this fraction of the interval count as one point of the quadrature.
SAME_POINT = 1e-9


@dataclass(frozen=True)
class IntegrationGaps:
    """Worst mismatch of position (m, rad) and of velocity (m/s, rad/s) over one interval."""

    position: float
    velocity: float


def interval_gaps(solution: Solution) -> IntegrationGaps:
    """Return the worst difference between ends of an interval and what integration gives.

    position: end minus start minus the integral of the velocity polynomial through all samples.
    velocity: end minus start minus the integral of the acceleration polynomial through the
    collocation points. Both vanish up to rounding for collocation of the acceleration; schemes
    that are inconsistent within an interval (semi-implicit Euler) show their step error.
    """
    found = [_interval(solution, rows) for rows in solution.intervals]
    return IntegrationGaps(max(gap.position for gap in found), max(gap.velocity for gap in found))


def _interval(solution: Solution, rows: range) -> IntegrationGaps:
    start, end = solution.interval_t[solution.interval[rows.start]]
    fractions = (solution.t[rows.start : rows.stop] - start) / (end - start)
    points = np.flatnonzero(solution.collocation[rows.start : rows.stop])
    local = [local_state(solution.model, solution.q[rows.start], *_state(solution, row)) for row in rows]
    xi, rate, second = (np.array(part) for part in zip(*local, strict=True))
    distinct = np.concatenate([[0], 1 + np.flatnonzero(np.diff(fractions) > SAME_POINT)])
    step = end - start
    position = xi[-1] - xi[0] - step * quadrature_weights(fractions[distinct]) @ rate[distinct]
    velocity = rate[-1] - rate[0] - step * quadrature_weights(fractions[points]) @ second[points]
    return IntegrationGaps(float(np.abs(position).max()), float(np.abs(velocity).max()))


def _state(solution: Solution, row: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return solution.q[row], solution.v[row], solution.a[row]


def quadrature_weights(fractions: np.ndarray) -> np.ndarray:
    """Return weights (n,) on [0, 1] that are exact for polynomials through ``fractions`` (n,)."""
    moments = 1.0 / np.arange(1, len(fractions) + 1)
    weights: np.ndarray = np.linalg.solve(np.vander(fractions, increasing=True).T, moments)
    return weights
