"""Whether q, v and a of an interval belong to one motion: quadrature in the interval's own coordinates.

In the local coordinates of an interval (world position of a free-flyer, exponential coordinates
relative to the start for rotations, joints as they are) collocation makes the acceleration a
polynomial through its points, so that quadratures of matching order are exact up to rounding.
"""

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
    counts = np.array([len(rows) for rows in solution.intervals])
    same = (np.flatnonzero(counts == size) for size in set(counts.tolist()))
    gaps = [_intervals(solution, numbers) for numbers in same]
    return IntegrationGaps(max(gap.position for gap in gaps), max(gap.velocity for gap in gaps))


def _intervals(solution: Solution, numbers: np.ndarray) -> IntegrationGaps:
    """Gaps of intervals with the same number of samples."""
    rows = np.array([solution.intervals[number] for number in numbers])
    start, step = solution.interval_t[numbers, :1], np.diff(solution.interval_t[numbers], axis=1)
    fractions, points = (solution.t[rows] - start) / step, solution.collocation[rows]
    origin = solution.q[rows[:, :1]]
    xi, rate, second = local_state(
        solution.model, origin, solution.q[rows], solution.v[rows], solution.a[rows]
    )
    worst = np.zeros(2)
    for i, h in enumerate(step[:, 0]):
        distinct = np.concatenate([[0], 1 + np.flatnonzero(np.diff(fractions[i]) > SAME_POINT)])
        inner = points[i]
        position = xi[i, -1] - xi[i, 0] - h * quadrature_weights(fractions[i, distinct]) @ rate[i, distinct]
        velocity = rate[i, -1] - rate[i, 0] - h * quadrature_weights(fractions[i, inner]) @ second[i, inner]
        worst = np.maximum(worst, [np.abs(position).max(), np.abs(velocity).max()])
    return IntegrationGaps(*worst.tolist())


def quadrature_weights(fractions: np.ndarray) -> np.ndarray:
    """Return weights (n,) on [0, 1] that are exact for polynomials through ``fractions`` (n,)."""
    moments = 1.0 / np.arange(1, len(fractions) + 1)
    weights: np.ndarray = np.linalg.solve(np.vander(fractions, increasing=True).T, moments)
    return weights
