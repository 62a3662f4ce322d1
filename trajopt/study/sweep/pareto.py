"""Pareto fronts: the points than which nothing faster is as accurate. A point is a time and an error."""

import math
from collections.abc import Sequence

Point = tuple[float, float]

# A slower setting is on the front only if its error is less by this fraction: errors of one discretisation
# with different solvers or tolerances differ in the third digit.
GAIN = 0.05


def is_measured(point: Point) -> bool:
    """Whether time and error are finite: otherwise a point is never on a front."""
    return all(math.isfinite(value) for value in point)


def front(points: Sequence[Point], gain: float = 0.0) -> list[int]:
    """Indices of the points on the front, fastest first.

    Those whose error is less than that of every faster one by a fraction ``gain``; 0 gives the Pareto front.
    Equal points are on it together. Points that are not measured are ignored.
    """
    kept: list[int] = []
    for i in sorted(
        (i for i, point in enumerate(points) if is_measured(point)), key=lambda i: (points[i], i)
    ):
        least = points[kept[-1]][1] if kept else math.inf
        if points[i][1] < (1 - gain) * least or (kept and points[i] == points[kept[-1]]):
            kept.append(i)
    return kept


def dominators(points: Sequence[Point], gain: float = 0.0) -> list[int | None]:
    """For each point, the one on the front that dominates it most; None for points on the front.

    That is the largest product of ratios among those that are not slower, and not less accurate up to
    ``gain``. A point that is not measured also has None.
    """
    best = front(points, gain)
    dominating: list[int | None] = []
    for i, (time, error) in enumerate(points):
        over = [j for j in best if points[j][0] <= time and (1 - gain) * points[j][1] <= error]
        on_it = i in best or not is_measured(points[i])
        dominating.append(None if on_it else max(over, key=lambda j: _lead(points[j], (time, error))))
    return dominating


def _lead(first: Point, second: Point) -> float:
    """Logarithm of the product of ratios; infinite if the front's point is zero."""
    pairs = [(a, b) for a, b in zip(first, second, strict=True) if a != b]
    return sum(math.inf if a <= 0 else math.log(b / a) for a, b in pairs)
