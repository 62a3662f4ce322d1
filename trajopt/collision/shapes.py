"""Collision shapes: convex bodies on links; boxes, capsules and spheres in the world."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np

from trajopt.arguments import Array3, Array33, ArrayShape, NonNegative, Positive, checked
from trajopt.errors import InputError, numbers_of, require_positive, shown
from trajopt.terrain.surface import FARTHEST, MOST_CORNERS

# Tolerance of a rotation matrix: rounding of decimal numbers.
ROTATION_ERROR = 1e-6
# Eight points are a box if its edges agree and are orthogonal within this, m: rounding of a file's numbers.
BOX_ERROR = 3e-6
ShapeKind = Literal["sphere", "capsule", "box", "hull"]
KINDS: tuple[ShapeKind, ...] = ("sphere", "capsule", "box", "hull")


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class LinkShape:
    """All points within ``radius`` m of the convex hull of ``points``, moving with a frame of the robot.

    ``points`` (n, 3) m, n >= 1, are in ``frame`` and read-only; ``radius`` m is >= 0. One point is a sphere,
    two are a capsule, and the corners of a box in the order of `box_corners`, without a radius, are a box.
    ``name`` appears in messages. Raises InputError.
    """

    name: str
    frame: str
    points: Annotated[np.ndarray, ArrayShape((None, 3))]
    radius: NonNegative = 0.0

    def __post_init__(self) -> None:
        label, count = f"shape '{self.name}'", len(self.points)
        if not 1 <= count <= MOST_CORNERS:
            raise InputError(f"points of {label} are {count}", f"allowed: 1 to {MOST_CORNERS}")
        if count <= 2:
            require_positive(f"radius of {label}", self.radius, "m")
        _require_near(label, self.points, self.radius)

    @property
    def extent(self) -> float:
        """Diagonal of the points' bounding box plus twice the radius, m."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)) + 2 * self.radius)

    @classmethod
    def sphere(cls, name: str, frame: str, centre: Any, radius: float) -> LinkShape:
        """Return a ball around ``centre`` (3,) m."""
        return cls(name=name, frame=frame, points=numbers_of([centre]), radius=radius)

    @classmethod
    def capsule(cls, name: str, frame: str, start: Any, end: Any, radius: float) -> LinkShape:
        """Return a capsule of ``radius`` m from ``start`` to ``end`` (3,) m; a sphere if they are equal."""
        points = [start] if np.array_equal(start, end) else [start, end]
        return cls(name=name, frame=frame, points=numbers_of(points), radius=radius)

    @classmethod
    def box(cls, name: str, frame: str, sides: Any, position: Any, rotation: Any = None) -> LinkShape:
        """Return a box with full ``sides`` (3,) m, centre ``position`` (3,) m and ``rotation`` (3, 3)."""
        placed = BoxObstacle(name=name, sides=sides, position=position, rotation=rotation)
        return cls(name=name, frame=frame, points=placed.points)

    @property
    def kind(self) -> ShapeKind:
        """Kind of shape: sphere (one point), capsule (two), box (its corners, no radius) or hull."""
        if len(self.points) <= 2:
            return "sphere" if len(self.points) == 1 else "capsule"
        return "hull" if self.box_axes is None else "box"

    @property
    def axis(self) -> tuple[np.ndarray, np.ndarray]:
        """Ends (3,) m of the segment of a capsule or sphere. Raises InputError for other kinds."""
        if len(self.points) > 2:
            raise InputError(f"shape '{self.name}' is a {self.kind}", "allowed: a capsule or a sphere")
        return self.points[0], self.points[-1]

    @cached_property
    def ball(self) -> tuple[np.ndarray, float]:
        """Centre (3,) and radius, m, of a bounding ball in the shape's frame."""
        centre, reach = ball_around(self.points)
        return centre, reach + self.radius

    @cached_property
    def box_axes(self) -> np.ndarray | None:
        """Edges (3, 3) of a box as rows, m; None for other kinds."""
        if len(self.points) != 8 or self.radius > 0:
            return None
        edges = self.points[[4, 2, 1]] - self.points[0]
        expected = self.points[0] + _BITS @ edges
        products = edges @ edges.T
        lengths = np.sqrt(np.diag(products))
        skew = np.abs(products - np.diag(np.diag(products))).max()
        if np.abs(expected - self.points).max() > BOX_ERROR or skew > BOX_ERROR * lengths.max():
            return None
        return edges if lengths.min() > 0 else None

    def describe(self) -> dict[str, Any]:
        """JSON-able description for a solution file."""
        return _described(self, ("name", "frame", "points", "radius"))

    @classmethod
    def from_description(cls, described: Any) -> LinkShape:
        """Return the shape from a result of ``describe``, or an older file's capsule. Raises InputError."""
        if isinstance(described, dict) and "start" in described:
            _require_keys(described, ("name", "frame", "start", "end", "radius"), "capsule")
            return cls.capsule(**described)
        _require_keys(described, ("name", "frame", "points", "radius"), "shape")
        return cls(**described)


_BITS = np.array(list(itertools.product((0.0, 1.0), repeat=3)))


def box_corners(low: Any, high: Any) -> np.ndarray:
    """Return the corners (8, 3) of a box from ``low`` to ``high`` (3,), the last axis varying fastest."""
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    return np.asarray(low + _BITS * (high - low))


def ball_around(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Return centre (3,) and radius, m, of a ball around points (n, 3) m, centred in their bounding box."""
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    return centre, float(np.linalg.norm(points - centre, axis=1).max())


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class SphereObstacle:
    """A ball around ``centre`` (3,) m, world, of ``radius`` m. Raises InputError."""

    name: str
    centre: Array3
    radius: Positive

    def __post_init__(self) -> None:
        _require_near(f"obstacle '{self.name}'", self.centre, self.radius)

    @property
    def axis(self) -> tuple[np.ndarray, np.ndarray]:
        """Ends (3,) m of the obstacle's segment: twice the centre."""
        return self.centre, self.centre

    @property
    def points(self) -> np.ndarray:
        """The centre (1, 3), world, m: the obstacle is all points within ``radius`` of it."""
        return self.centre[None]

    def describe(self) -> dict[str, Any]:
        """JSON-able description for a solution file."""
        return {"kind": "sphere", **_described(self)}


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class CapsuleObstacle:
    """All points within ``radius`` m of a segment, ``start`` to ``end`` (3,) m, world. Raises InputError."""

    name: str
    start: Array3
    end: Array3
    radius: Positive

    def __post_init__(self) -> None:
        _require_near(f"obstacle '{self.name}'", self.start, self.end, self.radius)

    @property
    def axis(self) -> tuple[np.ndarray, np.ndarray]:
        """Ends (3,) m of the obstacle's segment."""
        return self.start, self.end

    @property
    def points(self) -> np.ndarray:
        """Ends (2, 3), world, m: the obstacle is all points within ``radius`` of their hull."""
        return np.array(self.axis)

    def describe(self) -> dict[str, Any]:
        """JSON-able description for a solution file."""
        return {"kind": "capsule", **_described(self)}


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class BoxObstacle:
    """A box with full ``sides`` (3,) m and its centre at ``position`` (3,) m, world.

    ``rotation`` (3, 3) is from the box's axes to the world's; default: aligned. Raises InputError.
    """

    name: str
    sides: Array3
    position: Array3
    rotation: Array33 | None = None

    def __post_init__(self) -> None:
        label = f"obstacle '{self.name}'"
        if not (self.sides > 0).all():
            raise InputError(f"sides of {label} are {self.sides} m", "allowed: > 0")
        _require_near(label, self.sides, self.position)
        rotation = np.eye(3) if self.rotation is None else self.rotation
        orthogonal = np.abs(rotation.T @ rotation - np.eye(3)).max() < ROTATION_ERROR
        if not orthogonal or np.linalg.det(rotation) < 0:
            raise InputError(f"rotation of {label} is not a rotation", "allowed: (3, 3), orthogonal, det 1")
        rotation.setflags(write=False)
        object.__setattr__(self, "rotation", rotation)

    @property
    def turn(self) -> np.ndarray:
        """The rotation (3, 3), never None."""
        return np.asarray(self.rotation)

    @property
    def points(self) -> np.ndarray:
        """Corners (8, 3), world, m, in the order of `box_corners`: the obstacle is their hull."""
        return np.asarray(box_corners(-self.sides / 2, self.sides / 2) @ self.turn.T + self.position)

    @property
    def radius(self) -> float:
        """Distance around the hull of ``points``, m: zero."""
        return 0.0

    def describe(self) -> dict[str, Any]:
        """JSON-able description for a solution file."""
        return {"kind": "box", **_described(self)}


Obstacle = SphereObstacle | CapsuleObstacle | BoxObstacle
_KINDS: Mapping[str, type[Obstacle]] = {
    "sphere": SphereObstacle,
    "capsule": CapsuleObstacle,
    "box": BoxObstacle,
}


def obstacle_from_description(described: Any) -> Obstacle:
    """Return the obstacle from a result of ``describe``. Raises InputError."""
    kind = str(described.get("kind")) if isinstance(described, dict) else ""
    if kind not in _KINDS:
        raise InputError(f"an obstacle is described by {shown(described)}", f"kinds: {', '.join(_KINDS)}")
    fields = {name: value for name, value in described.items() if name != "kind"}
    _require_keys(fields, tuple(_KINDS[kind].__dataclass_fields__), "obstacle")
    made: Obstacle = _KINDS[kind](**fields)
    return made


def require_different_names(what: str, names: Sequence[str]) -> None:
    """Raise InputError if two names are the same."""
    double = sorted({name for name in names if names.count(name) > 1})
    if double:
        raise InputError(f"two {what} are named {', '.join(double)}", "allowed: different names")


def _require_near(label: str, *lengths: Any) -> None:
    """Raise InputError for lengths that are not finite, or so large that Coal fails on them."""
    if not all((np.abs(length) <= FARTHEST).all() for length in lengths):
        raise InputError(f"{label} reaches beyond {FARTHEST:g} m", "allowed: nearer, and finite")


def _described(shape: Any, names: Sequence[str] | None = None) -> dict[str, Any]:
    """Return the fields of a shape, JSON-able."""
    return {name: np.asarray(getattr(shape, name)).tolist() for name in names or vars(shape)}


def _require_keys(described: Any, keys: Sequence[str], what: str) -> None:
    if not isinstance(described, dict) or set(described) != set(keys):
        raise InputError(f"a {what} is described by {shown(described)}", f"keys: {', '.join(keys)}")
