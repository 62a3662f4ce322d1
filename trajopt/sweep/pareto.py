"""Which points are dominated: smaller is better in every objective."""

from __future__ import annotations

import math
from collections.abc import Sequence

Point = Sequence[float]


def dominates(first: Point, second: Point) -> bool:
    """Whether ``first`` is nowhere worse than ``second`` and better in one objective at least."""
    pairs = list(zip(first, second, strict=True))
    return all(a <= b for a, b in pairs) and any(a < b for a, b in pairs)


def is_measured(point: Point) -> bool:
    """Whether every objective is a finite number: anything else is never on a front."""
    return all(math.isfinite(value) for value in point)


def front(points: Sequence[Point]) -> list[int]:
    """Indices of the points that no other dominates, in order of the first objective, then of the others.

    Equal points do not dominate each other: all of them are on the front, or none. Points with an objective
    that is not finite are passed over.
    """
    known = [i for i, point in enumerate(points) if is_measured(point)]
    left = [i for i in known if not any(dominates(points[j], points[i]) for j in known)]
    return sorted(left, key=lambda i: (tuple(points[i]), i))


def dominators(points: Sequence[Point]) -> list[int | None]:
    """For each point the one on the front that is ahead of it by most, None for points on the front.

    Ahead by most is the largest product of ratios, for objectives that are positive. For a point that is not
    measured there is None, too: it is on no front, and nothing can be said against it but that.
    """
    best = front(points)
    found: list[int | None] = []
    for point in points:
        over = [i for i in best if dominates(points[i], point)] if is_measured(point) else []
        found.append(max(over, key=lambda i: _lead(points[i], point)) if over else None)
    return found


def _lead(first: Point, second: Point) -> float:
    """Logarithm of the product of ratios; an objective of zero is ahead of any other by infinity."""
    return sum(_log(b) - _log(a) if a != b else 0.0 for a, b in zip(first, second, strict=True))


def _log(value: float) -> float:
    return math.log(value) if value > 0 else -math.inf
