"""Faces of the ground: planes bounded by convex polygons, on which contacts land; faces of obstacles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from trajopt.arguments import NonNegative, Positive, checked
from trajopt.errors import InputError, numbers_of, shown
from trajopt.terrain.surface import FARTHEST, MOST_CORNERS, SAME_PLANE, UP, Surface

# Sine of the turn at a corner below which three corners are collinear (or turn the wrong way): rounding of
# computed corners, far below any intended turn.
STRAIGHT = 1e-9
DESCRIBED = ("name", "surface", "vertices", "margin")
PlanePoint = tuple[float, float]


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Patch:
    """A plane inside a convex polygon.

    Args:
        surface: the plane.
        vertices: corners (n, 3), n >= 3, m, world, in the plane and in order around it, either way; they are
            kept counter-clockwise about the normal.
        margin: distance in m that a contact landing on it keeps from every edge.
        name: for reports and `PiecewiseTerrain.face`.

    Raises:
        InputError: for corners off the plane or not in convex order, and a margin that leaves no area.
    """

    surface: Surface
    vertices: np.ndarray
    margin: NonNegative = 0.0
    name: str = "patch"
    inward: np.ndarray = field(init=False, repr=False)
    """Unit normals (n, 3) of the edges, in the plane, pointing inward; edge i starts at corner i."""

    def __post_init__(self) -> None:
        vertices = _corners(self.vertices, self.name)
        off = float(np.abs(self.surface.distance(vertices)).max())
        if not off <= SAME_PLANE:
            raise InputError(
                f"a corner of patch '{self.name}' is {off:g} m off its plane",
                f"allowed: within {SAME_PLANE:g} m",
            )
        if not np.cross(vertices, np.roll(vertices, -1, axis=0)).sum(axis=0) @ self.surface.normal > 0:
            vertices = vertices[::-1].copy()  # they were clockwise
        edges = np.roll(vertices, -1, axis=0) - vertices
        inward = np.cross(self.surface.normal, edges)
        lengths = np.linalg.norm(inward, axis=1)
        if not lengths.min() > SAME_PLANE:
            raise InputError(
                f"patch '{self.name}' has an edge without length", "allowed: corners that differ"
            )
        inward = inward / lengths[:, None]
        _require_convex(edges / lengths[:, None], self.surface.normal, self.name)
        for label, array in (("vertices", vertices), ("inward", inward)):
            array.setflags(write=False)
            object.__setattr__(self, label, array)
        object.__setattr__(self, "margin", float(self.margin))
        if not len(self.allowed):
            raise InputError(
                f"margin of patch '{self.name}' is {self.margin:g} m, which leaves nothing of it",
                "allowed: less than half of its width",
            )

    @classmethod
    @checked
    def rectangle(
        cls,
        centre: tuple[float, float, float],
        size: tuple[Positive, Positive],
        *,
        yaw: float = 0.0,
        friction: float = 0.7,
        margin: NonNegative = 0.0,
        name: str = "patch",
    ) -> Patch:
        """A level rectangle.

        Args:
            centre: centre (3,), m, world.
            size: lengths along its own axes, m.
            yaw: angle of these axes, rad.
            friction: Coulomb's coefficient.
            margin: see `Patch`, m.
            name: see `Patch`.
        """
        turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array(size) / 2
        vertices = np.array(centre) + np.column_stack([corners @ turn.T, np.zeros(4)])
        surface = Surface(point=np.array(centre), normal=np.array(UP), friction=friction)
        return cls(surface=surface, vertices=vertices, margin=margin, name=name)

    @property
    def offsets(self) -> np.ndarray:
        """Offsets (n,) in m of the edges: a position p is inside where ``inward @ p >= offsets``."""
        return np.asarray(np.sum(self.inward * self.vertices, axis=1))

    @property
    def centre(self) -> np.ndarray:
        """Mean of the corners (3,), m."""
        return np.asarray(self.vertices.mean(axis=0))

    @property
    def allowed(self) -> np.ndarray:
        """Corners (k, 3) of the part at least ``margin`` m from every edge; none where nothing is left."""
        points = self.vertices
        for inward, offset in zip(self.inward, self.offsets + self.margin, strict=True):
            points = cut_polygon(points, inward, offset)
        return points

    def within(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Corners (k, 3) of the part over a rectangle from ``low`` to ``high`` (x, y) m; k < 3 if none."""
        points = self.vertices
        for axis, inward in enumerate(np.eye(3)[:2]):
            points = cut_polygon(points, inward, float(low[axis]))
            points = cut_polygon(points, -inward, -float(high[axis]))
        return points

    def inside(self, position: np.ndarray) -> np.ndarray:
        """Signed distance (...) in m of positions (..., 3), along the plane, from the nearest edge's line.

        Positive inside; outside, the largest distance beyond an edge's line, at most that to the polygon.
        """
        return np.asarray((np.asarray(position, dtype=float) @ self.inward.T - self.offsets).min(axis=-1))

    def nearest(self, position: Sequence[float] | np.ndarray) -> np.ndarray:
        """Point (3,) nearest to ``position`` (3,) in the part of the patch that keeps the margin."""
        point = np.asarray(position, dtype=float)
        onto = np.asarray(point - float(self.surface.distance(point)) * self.surface.normal)
        if float(self.inside(onto)) >= self.margin:
            return onto
        corners = self.allowed
        best = [_on_segment(onto, a, b) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
        return min(best, key=lambda candidate: float(np.linalg.norm(candidate - onto)))

    def offset(self, distance: float) -> Patch:
        """The parallel patch ``distance`` m along the normal, with the same edges and margin."""
        if not distance:
            return self
        vertices = self.vertices + distance * self.surface.normal
        return replace(self, surface=self.surface.offset(distance), vertices=vertices)

    def describe(self) -> dict[str, Any]:
        """JSON-able description for a solution file."""
        return {
            "name": self.name,
            "surface": self.surface.describe(),
            "vertices": self.vertices.tolist(),
            "margin": self.margin,
        }

    @classmethod
    def from_description(cls, described: Any) -> Patch:
        """The patch that ``describe`` wrote. Raises `InputError`."""
        if not isinstance(described, dict) or set(described) != set(DESCRIBED):
            raise InputError(
                f"a patch is described by {shown(described)}", f"allowed: {', '.join(DESCRIBED)}"
            )
        return cls(**(described | {"surface": Surface.from_description(described["surface"])}))


def _corners(value: Any, name: str) -> np.ndarray:
    vertices = numbers_of(value)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not 3 <= len(vertices) <= MOST_CORNERS:
        raise InputError(
            f"vertices of patch '{name}' have shape {vertices.shape}",
            f"allowed: (n, 3), n >= 3, at most {MOST_CORNERS}",
        )
    if not (np.abs(vertices) <= FARTHEST).all():
        raise InputError(
            f"a vertex of patch '{name}' is beyond {FARTHEST:g} m", "allowed: nearer, and finite"
        )
    return vertices


def _require_convex(directions: np.ndarray, normal: np.ndarray, name: str) -> None:
    """Raise `InputError` unless every corner turns left and all of them together turn once around."""
    following = np.roll(directions, -1, axis=0)
    sines = np.cross(directions, following) @ normal
    turns = np.arctan2(sines, np.sum(directions * following, axis=1))
    if sines.min() <= STRAIGHT or turns.sum() > 3 * math.pi:
        raise InputError(
            f"patch '{name}' is not a convex polygon with corners in order",
            "allowed: every corner turns the same way, no three on a line",
        )


def cut_polygon(points: np.ndarray, inward: np.ndarray, offset: float) -> np.ndarray:
    """The part (k, 3) of a convex polygon with inward @ p >= offset, by Sutherland-Hodgman clipping."""
    kept: list[np.ndarray] = []
    for a, b in zip(points, np.roll(points, -1, axis=0), strict=True):
        over = (float(inward @ a - offset), float(inward @ b - offset))
        if over[0] >= 0:
            kept.append(a)
        if over[0] * over[1] < 0:
            kept.append(a + over[0] / (over[0] - over[1]) * (b - a))
    return np.array(kept).reshape(-1, 3)


def _on_segment(point: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    along = b - a
    length = float(along @ along)
    s = min(max(float((point - a) @ along) / length, 0.0), 1.0) if length > 0 else 0.0
    return np.asarray(a + s * along)


@checked
@dataclass(frozen=True)
class ObstacleAxes:
    """Axes of an obstacle, origin (x, y) m and direction rad, with the friction and margin of its faces."""

    at: PlanePoint
    yaw: float
    friction: float
    margin: float

    def face(self, name: str, corners: Sequence[tuple[float, float, float]]) -> Patch:
        """A face with corners (x, y, z) in the obstacle's own axes."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        points = np.array(corners, dtype=float) @ turn.T + np.array([*self.at, 0.0])
        normal = np.cross(points[1] - points[0], points[3] - points[0])
        if np.ptp(points[:, 2]) == 0.0:
            normal = np.array(UP)
        surface = Surface(point=points[0], normal=normal, friction=self.friction)
        return Patch(surface=surface, vertices=points, margin=self.margin, name=name)

    def rectangle(
        self, name: str, x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]
    ) -> Patch:
        """A face over a rectangle in the obstacle's own axes, from height z[0] at x[0] to z[1] at x[1]."""
        corners = [(x[0], y[0], z[0]), (x[1], y[0], z[1]), (x[1], y[1], z[1]), (x[0], y[1], z[0])]
        return self.face(name, corners)
