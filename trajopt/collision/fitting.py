"""The tightest capsule found around points: least volume over the direction of its axis.

For a given direction the capsule of least volume is exact: its radius and place follow from the least
circle around the points seen along the axis, its ends from how far each point reaches beyond the cap.
The direction is searched by Nelder and Mead's method from the three principal axes. No step is random.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trajopt.terrain.surface import frame_of_normal

# Points count as inside within this part of the radius: rounding of a circle through three points.
INSIDE = 1e-12
# The least circle settles in a few exchanges of its support; a cycle through rounding ends here.
MOST_EXCHANGES = 100
# Tolerance of the search for a direction, rad: at a minimum it changes the volume by parts in 1e4.
DIRECTION_ERROR = 1e-2
MOST_DIRECTIONS = 80
# First step of the search from a principal axis, rad.
FIRST_STEP = 0.15
# A circle's polygon, tangent to it from outside, is 0.5 % larger with this many corners.
ROUND_CORNERS = 32
# Points this close to a plane or a line, as a fraction of their extent, have no hull with a volume.
FLAT = 1e-9


@dataclass(frozen=True)
class Segment:
    """Axis of a capsule: ``start``, ``end`` (3,) and ``radius``, m."""

    start: np.ndarray
    end: np.ndarray
    radius: float

    @property
    def volume(self) -> float:
        """Volume of the capsule, m^3."""
        length = float(np.linalg.norm(self.end - self.start))
        return math.pi * self.radius**2 * (length + 4 / 3 * self.radius)

    def depth(self, points: np.ndarray) -> np.ndarray:
        """Distance (n,) in m of points (n, 3) from the capsule's surface, positive inside."""
        along = self.end - self.start
        square = float(along @ along)
        share = np.clip((points - self.start) @ along / square, 0, 1) if square > 0 else np.zeros(len(points))
        nearest = self.start + share[:, None] * along
        return np.asarray(self.radius - np.linalg.norm(points - nearest, axis=1))


def enclosing_capsule(points: np.ndarray) -> Segment:
    """Capsule of small volume that holds all points (n, 3), m; deterministic."""
    points = np.asarray(points, dtype=float)
    corners = _corners(points)
    _, axes = np.linalg.eigh(np.cov((corners - corners.mean(axis=0)).T) if len(corners) > 1 else np.eye(3))
    found = [_best_near(corners, axes[:, i]) for i in range(3)]
    best = min(found, key=lambda segment: segment.volume)
    outside = max(0.0, -float(best.depth(points).min()))
    return Segment(best.start, best.end, best.radius + outside)


def _corners(points: np.ndarray) -> np.ndarray:
    """Corners of the convex hull; all points where the hull has no volume."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) if len(points) > 4 else np.zeros(1)
    if len(spread) < 3 or spread[2] <= FLAT * spread[0]:
        return points
    from scipy.spatial import ConvexHull  # takes a while to load

    return np.asarray(points[ConvexHull(points).vertices])


def _best_near(points: np.ndarray, axis: np.ndarray) -> Segment:
    """Least volume over directions near ``axis``, by Nelder and Mead's method over two tilts."""
    from scipy.optimize import minimize

    turn = frame_of_normal(axis)

    def capsule(tilts: np.ndarray) -> Segment:
        direction = turn @ np.array([tilts[0], tilts[1], 1.0])
        return along(points, direction / np.linalg.norm(direction))

    first = np.array([[0.0, 0.0], [FIRST_STEP, 0.0], [0.0, FIRST_STEP]])
    options = {
        "initial_simplex": first,
        "xatol": DIRECTION_ERROR,
        "fatol": np.inf,
        "maxfev": MOST_DIRECTIONS,
    }
    result = minimize(lambda tilts: capsule(tilts).volume, np.zeros(2), method="Nelder-Mead", options=options)
    return capsule(result.x)


def along(points: np.ndarray, direction: np.ndarray) -> Segment:
    """Capsule along the unit ``direction`` (3,) around points (n, 3): least radius, then least length."""
    turn = frame_of_normal(direction)
    local = points @ turn
    centre, radius = least_circle(local[:, :2])
    away = np.sum((local[:, :2] - centre) ** 2, axis=1)
    cap = np.sqrt(np.maximum(radius**2 - away, 0.0))
    low, high = float((local[:, 2] + cap).min()), float((local[:, 2] - cap).max())
    if low > high:
        low = high = (low + high) / 2
    start, end = (turn @ np.array([*centre, height]) for height in (low, high))
    return Segment(start, end, radius)


def least_circle(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (2,) and radius of the least circle around points (n, 2).

    Support points are exchanged: the farthest point joins, and the least circle through two or three of
    them that holds all of them is kept. The radius grows at each exchange, so the search terminates.
    """
    support = points[[int(np.argmax(np.sum((points - points.mean(axis=0)) ** 2, axis=1)))]]
    centre, radius = support[0], 0.0
    for _ in range(MOST_EXCHANGES):
        distance = np.linalg.norm(points - centre, axis=1)
        farthest = int(np.argmax(distance))
        if distance[farthest] <= radius * (1 + INSIDE):
            break
        support, centre, radius = _exchanged(np.vstack([support, points[farthest]]))
    return centre, float(np.linalg.norm(points - centre, axis=1).max())


def _exchanged(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """The least circle around at most four points, and those on it; the last point is always one."""
    last, others = points[-1], points[:-1]
    best: tuple[np.ndarray, np.ndarray, float] | None = None
    candidates = [np.array([other, last]) for other in others]
    candidates += [np.array([others[i], others[j], last]) for i in range(len(others)) for j in range(i)]
    for support in candidates:
        circle = _through(support)
        if circle is None or (best is not None and circle[1] >= best[2]):
            continue
        if np.linalg.norm(points - circle[0], axis=1).max() <= circle[1] * (1 + 10 * INSIDE) + 1e-300:
            best = (support, *circle)
    if best is None:  # three points in line up to rounding: the widest two
        widest = max(candidates[: len(others)], key=lambda pair: float(np.linalg.norm(pair[1] - pair[0])))
        return widest, widest.mean(axis=0), float(np.linalg.norm(widest[1] - widest[0])) / 2
    return best


def _through(points: np.ndarray) -> tuple[np.ndarray, float] | None:
    """Circle on two points as a diameter, or through three; None where they lie in line."""
    if len(points) == 2:
        return points.mean(axis=0), float(np.linalg.norm(points[1] - points[0])) / 2
    edges = points[1:] - points[0]
    determinant = edges[0, 0] * edges[1, 1] - edges[0, 1] * edges[1, 0]
    if abs(determinant) <= FLAT * np.abs(edges).max() ** 2:
        return None
    offset = np.linalg.solve(2 * edges, np.sum(edges**2, axis=1))
    return points[0] + offset, float(np.linalg.norm(offset))


def round_corners(radius: float, height: float) -> np.ndarray:
    """Corners (k, 3) of a prism around a cylinder about z, m."""
    angle = 2 * np.pi * np.arange(ROUND_CORNERS) / ROUND_CORNERS
    ring = radius / math.cos(math.pi / ROUND_CORNERS) * np.column_stack([np.cos(angle), np.sin(angle)])
    half = np.full(ROUND_CORNERS, height / 2)
    return np.concatenate([np.column_stack([ring, -half]), np.column_stack([ring, half])])
