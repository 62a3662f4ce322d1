"""The level convex hull of what a robot stands on: how far a point is outside, and what of it is nearest."""

import math
from collections.abc import Sequence

import numpy as np

# Corners that turn by less than this (m^2, twice the area of the triangle) are on one line.
STRAIGHT = 1e-9


class SupportPolygon:
    """Convex hull of points (n, 2 or more) in the level plane; also of one or two, or of points on a line.

    corners: (m, 2) of the hull, counter-clockwise.
    """

    def __init__(self, points: np.ndarray) -> None:
        places = sorted({(float(point[0]), float(point[1])) for point in points})
        lower, upper = _chain(places), _chain(places[::-1])
        self.corners = np.array(places if len(places) < 3 else lower[:-1] + upper[:-1])

    def nearest(self, point: np.ndarray) -> np.ndarray:
        """The point (2,) of the hull that is nearest to a point (2,)."""
        if self.outside(point) <= 0:
            return np.array(point[:2])
        feet = [_nearest_on(first, second, point) for first, second in self._edges()]
        return min(feet, key=lambda foot: math.hypot(*(foot - point[:2])))

    def outside(self, point: np.ndarray) -> float:
        """Distance of a point (2,) from the hull, m; inside that from its nearest edge, negative."""
        edges = self._edges()
        if len(self.corners) > 2:
            inside = min(_left_of(first, second, point) for first, second in edges)
            if inside >= 0:
                return -inside
        return min(math.hypot(*(_nearest_on(first, second, point) - point[:2])) for first, second in edges)

    def _edges(self) -> list[tuple[np.ndarray, np.ndarray]]:
        return list(zip(self.corners, np.roll(self.corners, -1, axis=0), strict=True))


def _chain(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """One side of the hull of points in lexicographic order (Andrew, Inf. Proc. Letters 9, 1979)."""
    chain: list[tuple[float, float]] = []
    for point in points:
        while len(chain) > 1 and _turn(chain[-2], chain[-1], point) <= STRAIGHT:
            chain.pop()
        chain.append(point)
    return chain


def _turn(a: Sequence[float], b: Sequence[float], c: Sequence[float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _left_of(first: np.ndarray, second: np.ndarray, point: np.ndarray) -> float:
    """Distance of a point to the left of an edge, m."""
    return _turn(tuple(first), tuple(second), tuple(point)) / max(math.hypot(*(second - first)), 1e-12)


def _nearest_on(first: np.ndarray, second: np.ndarray, point: np.ndarray) -> np.ndarray:
    along = second - first
    length = float(along @ along)
    share = 0.0 if length == 0 else float((point[:2] - first) @ along) / length
    return np.asarray(first + min(1.0, max(0.0, share)) * along)
