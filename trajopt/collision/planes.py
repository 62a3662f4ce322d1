"""Planes that keep two convex bodies apart: the supporting planes at their nearest points.

Two convex bodies are apart if a plane separates them. Let n be the unit normal from the second body to the
first at their nearest points (or, if they overlap, along the shortest way out). The supporting plane of one
body moves with that body, and the nearest corners of the other must stay on its far side:

    n . x_i >= max_j n . y_j + r + s + margin        corners x_i of one, y_j of the other, radii r and s

At the configuration where a plane is laid, the least of these rows is the signed distance minus the margin.
If one corner is nearest, its row has the distance's gradient; if an edge or a face is, the rows of its
corners are equal, and a convex combination of them has it. Elsewhere the least row is a lower bound of the
distance, unless a corner that was left out is nearer. So rows that hold keep the bodies apart. They are
smooth, also in contact and for parallel faces.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from trajopt.terrain.surface import UP

# Corners at most this much farther than the nearest one, m, get a row: a turn of 0.1 rad brings a corner that
# is 0.1 m away from the nearest one nearer by as much.
DEPTH = 0.01
# Largest number of corners with a row, and their least distance from each other, m.
MOST_CORNERS, CORNER_SPACING = 3, 5e-3
# Corners within this distance of the supporting plane, m, belong to the face that lies in it.
FACE = 1e-3
# Tolerance on the length of a unit direction: rounding of a search.
UNIT = 1e-6
# A foot may be this far on the wrong side of a plane, m: the error that solvers leave in its contact.
FOOT_SLACK = 1e-5
# Bisections in the search for a direction between two: to 1e-6 of their angle.
HALVINGS = 20
# Number of directions sampled on a circle, and of searches, each around the best direction so far.
DIRECTIONS, TURNS = 64, 4


@dataclass(frozen=True, kw_only=True, eq=False)
class PlacedBody:
    """A convex body at one configuration: all points within ``radius`` m of the hull of ``points`` (n, 3) m.

    ``points`` are in ``frame`` (None: the world), which is at ``rotation`` (3, 3) and ``position`` (3,) m in
    the world. With a ``normal`` (3,), world, the body is the half-space below the plane at ``height`` m along
    it instead. ``sides`` (m, 3) are the known outward normals of the hull's faces, world.
    """

    frame: str | None = None
    points: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    radius: float = 0.0
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    position: np.ndarray = field(default_factory=lambda: np.zeros(3))
    normal: np.ndarray | None = None
    height: float = 0.0
    sides: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))

    @cached_property
    def placed(self) -> np.ndarray:
        """The points (n, 3), world, m."""
        return np.asarray(self.points @ self.rotation.T + self.position)


@dataclass(frozen=True, kw_only=True, eq=False)
class Approach:
    """Two bodies near each other: ``normal`` (3,) from the second to the first, signed ``distance`` m."""

    first: PlacedBody
    second: PlacedBody
    normal: np.ndarray
    distance: float


@dataclass(frozen=True, kw_only=True, eq=False)
class SeparatingPlane:
    """A plane that one body carries, and the corners of another that stay on its positive side.

    Unit ``normal`` (3,) and ``offset`` m are in the frame ``body``, ``corners`` (n, 3) m in ``frame`` (None:
    the world).
    """

    frame: str | None
    body: str | None
    normal: np.ndarray
    offset: float
    corners: np.ndarray

    def with_corners(self, others: np.ndarray) -> SeparatingPlane:
        """Return the plane with further corners (n, 3) m of the same body."""
        if np.array_equal(self.corners, others):
            return self
        every = np.unique(np.concatenate([self.corners, others]), axis=0)
        return replace(self, corners=every)

    @property
    def parameters(self) -> np.ndarray:
        """Corner, normal and offset (n, 7) of each row, as in `trajopt.terms.moments.PlaneSide`."""
        plane = np.concatenate([self.normal, [self.offset]])
        return np.column_stack([self.corners, np.tile(plane, (len(self.corners), 1))])


def nearest(first: PlacedBody, second: PlacedBody, normal: np.ndarray) -> Approach:
    """Return the approach of two bodies, given the ``normal`` found by a search for their nearest points.

    Iterative searches sometimes fail for bodies of very different sizes. Any direction gives a lower bound of
    the signed distance, so the best is chosen among the given normal, its opposite, the direction from centre
    to centre, and the known face normals of the second body. The given normal may be invalid: zero or NaN.
    """
    if second.normal is not None:
        return Approach(
            first=first, second=second, normal=second.normal, distance=_gap(first, second, second.normal)
        )
    way = first.placed.mean(axis=0) - second.placed.mean(axis=0)
    length = float(np.linalg.norm(way))
    searched = [normal, -normal] if abs(np.linalg.norm(normal) - 1) < UNIT else []
    directions = [*searched, way / length if length > 0 else np.array(UP), *second.sides]
    distances = [_gap(first, second, direction) for direction in directions]
    best = int(np.argmax(distances))
    return Approach(first=first, second=second, normal=directions[best], distance=distances[best])


def nearest_along(first: PlacedBody, second: PlacedBody, ways: np.ndarray) -> Approach:
    """Return the approach of two bodies whose relative motion is along orthonormal ``ways`` (3, r), r <= 2.

    If they overlap, the shortest way out may be one that no motion can take. The normal is therefore the best
    direction within ``ways``, found by a search on the circle.
    """

    def apart(normal: np.ndarray) -> float:
        return _gap(first, second, normal)

    normal = max([*ways.T, *-ways.T], key=apart)
    if ways.shape[1] == 2:
        angle, width = 0.0, np.pi
        for _ in range(TURNS):
            around = angle + width * np.linspace(-1.0, 1.0, DIRECTIONS)
            angle = max(around, key=lambda each: apart(ways @ [np.cos(each), np.sin(each)]))
            width *= 4 / DIRECTIONS
        normal = ways @ [np.cos(angle), np.sin(angle)]
    return Approach(first=first, second=second, normal=normal, distance=apart(normal))


def beyond_foot(approach: Approach, foot: PlacedBody, margin: float) -> Approach:
    """Return the approach turned as little as needed to have a foot beyond its plane by ``margin`` m.

    A shank may be deep in an edge in front of which its foot stands, or will stand: no motion could satisfy a
    plane that the foot is not beyond. If the foot itself is nearer than that, the approach is unchanged.
    """

    def beyond(normal: np.ndarray) -> bool:
        return _gap(foot, approach.second, normal) >= margin - FOOT_SLACK

    if approach.second.normal is not None or beyond(approach.normal):
        return approach
    free = nearest(foot, approach.second, approach.normal).normal
    if not beyond(free):
        return approach
    near, far = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = (near + far) / 2
        near, far = (near, middle) if beyond(_between(approach.normal, free, middle)) else (middle, far)
    normal = _between(approach.normal, free, far)
    return replace(approach, normal=normal, distance=_gap(approach.first, approach.second, normal))


def _between(one: np.ndarray, other: np.ndarray, part: float) -> np.ndarray:
    """Return the direction (3,) at a fraction between two directions; the second one if they cancel."""
    sum_ = (1 - part) * one + part * other
    length = float(np.linalg.norm(sum_))
    return sum_ / length if length > UNIT else other


def _gap(first: PlacedBody, second: PlacedBody, normal: np.ndarray) -> float:
    """Return the least height of the first body along a normal minus the greatest of the second, m."""
    solid = second.normal is None
    top = float((second.placed @ normal).max()) + second.radius if solid else second.height
    return float((first.placed @ normal).min()) - first.radius - top


def separating_plane(approach: Approach, margin: float) -> SeparatingPlane:
    """Return the plane that keeps two bodies ``margin`` m apart: it supports one, the other is beyond it.

    The body with the larger face there carries it.
    """
    first, second, normal = approach.first, approach.second, approach.normal
    reach = first.radius + second.radius + margin
    if second.normal is not None:
        return _plane(first, second, second.normal, second.height + reach)
    along, against = first.placed @ normal, second.placed @ normal
    ahead = _extent(first.placed[along <= along.min() + FACE])
    if _extent(second.placed[against >= against.max() - FACE]) >= ahead:
        return _plane(first, second, normal, _support(second, normal) + reach)
    return _plane(second, first, -normal, _support(first, -normal) + reach)


def _support(body: PlacedBody, normal: np.ndarray) -> float:
    """Return the largest n . x over a body's points in its own frame, m; ``normal`` is in the world."""
    return float((body.points @ (body.rotation.T @ normal)).max())


def _plane(corners: PlacedBody, carrier: PlacedBody, normal: np.ndarray, offset: float) -> SeparatingPlane:
    chosen = _nearest(corners.placed, corners.placed @ normal)
    return SeparatingPlane(
        frame=corners.frame,
        body=carrier.frame,
        normal=carrier.rotation.T @ normal,
        offset=offset,
        corners=corners.points[chosen],
    )


def _nearest(points: np.ndarray, heights: np.ndarray) -> list[int]:
    """Choose the lowest point, then among those slightly higher the farthest from the ones chosen."""
    order = np.argsort(heights, kind="stable")
    near = order[heights[order] <= heights[order[0]] + DEPTH]
    chosen = [int(near[0])]
    away = np.linalg.norm(points[near] - points[chosen[0]], axis=1)
    while len(chosen) < MOST_CORNERS and away.max() > CORNER_SPACING:
        chosen.append(int(near[int(np.argmax(away))]))
        away = np.minimum(away, np.linalg.norm(points[near] - points[chosen[-1]], axis=1))
    return chosen


def _extent(points: np.ndarray) -> float:
    """Return the extent of a face: the largest distance of its corners from the first, m."""
    return float(np.linalg.norm(points - points[0], axis=1).max())
