"""Shapes of collision avoidance: capsules on links; boxes, capsules and spheres in the world."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from trajopt.errors import InputError, finite_array, numbers_of, require_positive
from trajopt.terrain.surface import frame_of_normal

# Tolerance of a rotation matrix: rounding of numbers written as decimals.
ROTATION_ERROR = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkCapsule:
    """All points within ``radius`` of a segment that moves with a frame of the robot.

    ``start``, ``end`` (3,) in m are in the axes of the frame ``frame``; equal, they make a sphere.
    ``radius`` in m is > 0. ``name`` appears in messages. Raises InputError.
    """

    name: str
    frame: str
    start: np.ndarray
    end: np.ndarray
    radius: float

    def __post_init__(self) -> None:
        label = f"capsule '{self.name}'"
        _set_vectors(self, label, ("start", "end"))
        _set_radius(self, label)

    @property
    def length(self) -> float:
        """Length of the axis, m."""
        return float(np.linalg.norm(self.end - self.start))

    def describe(self) -> dict[str, Any]:
        """JSON-able description for a solution file."""
        return _described(self)

    @classmethod
    def from_description(cls, described: Any) -> LinkCapsule:
        """The capsule that ``describe`` wrote. Raises InputError."""
        _require_keys(described, ("name", "frame", "start", "end", "radius"), "capsule")
        return cls(**described)


@dataclass(frozen=True, kw_only=True, eq=False)
class SphereObstacle:
    """A ball around ``centre`` (3,) m, world, of ``radius`` m. Raises InputError."""

    name: str
    centre: np.ndarray
    radius: float

    def __post_init__(self) -> None:
        _set_vectors(self, f"obstacle '{self.name}'", ("centre",))
        _set_radius(self, f"obstacle '{self.name}'")

    @property
    def axis(self) -> tuple[np.ndarray, np.ndarray]:
        """Ends (3,) m of the segment within ``radius`` of which the obstacle lies: one point."""
        return self.centre, self.centre

    def describe(self) -> dict[str, Any]:
        """JSON-able description for a solution file."""
        return {"kind": "sphere", **_described(self)}


@dataclass(frozen=True, kw_only=True, eq=False)
class CapsuleObstacle:
    """All points within ``radius`` m of a segment, ``start`` to ``end`` (3,) m, world. Raises InputError."""

    name: str
    start: np.ndarray
    end: np.ndarray
    radius: float

    def __post_init__(self) -> None:
        _set_vectors(self, f"obstacle '{self.name}'", ("start", "end"))
        _set_radius(self, f"obstacle '{self.name}'")

    @property
    def axis(self) -> tuple[np.ndarray, np.ndarray]:
        """Ends (3,) m of the segment within ``radius`` of which the obstacle lies."""
        return self.start, self.end

    def describe(self) -> dict[str, Any]:
        """JSON-able description for a solution file."""
        return {"kind": "capsule", **_described(self)}


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxObstacle:
    """A box with full ``sides`` (3,) m, its centre at ``position`` (3,) m, world.

    ``rotation`` (3, 3) turns the box's axes into the world's; default: aligned. Raises InputError.
    """

    name: str
    sides: np.ndarray
    position: np.ndarray
    rotation: np.ndarray | None = None

    def __post_init__(self) -> None:
        label = f"obstacle '{self.name}'"
        _set_vectors(self, label, ("sides", "position"))
        if not (self.sides > 0).all():
            raise InputError(f"sides of {label} are {self.sides} m", "allowed: > 0")
        rotation = numbers_of(np.eye(3) if self.rotation is None else self.rotation)
        orthogonal = rotation.shape == (3, 3) and np.isfinite(rotation).all()
        if orthogonal:
            orthogonal = bool(np.abs(rotation.T @ rotation - np.eye(3)).max() < ROTATION_ERROR)
        if not orthogonal or np.linalg.det(rotation) < 0:
            raise InputError(f"rotation of {label} is not a rotation", "allowed: (3, 3), orthogonal, det 1")
        rotation.setflags(write=False)
        object.__setattr__(self, "rotation", rotation)

    @property
    def turn(self) -> np.ndarray:
        """The rotation (3, 3), never None."""
        return np.asarray(self.rotation)

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
    """The obstacle that ``describe`` wrote. Raises InputError."""
    kind = str(described.get("kind")) if isinstance(described, dict) else ""
    if kind not in _KINDS:
        raise InputError(f"an obstacle is described by {described!r}", f"kinds: {', '.join(_KINDS)}")
    fields = {name: value for name, value in described.items() if name != "kind"}
    _require_keys(fields, tuple(_KINDS[kind].__dataclass_fields__), "obstacle")
    made: Obstacle = _KINDS[kind](**fields)
    return made


def segment_placement(start: np.ndarray, end: np.ndarray) -> pin.SE3:
    """Placement of a Coal capsule (along z, about its middle) on a segment."""
    along = end - start
    length = float(np.linalg.norm(along))
    turn = frame_of_normal(along / length) if length > 0 else np.eye(3)
    return pin.SE3(turn, (start + end) / 2)


def coal_capsule(start: np.ndarray, end: np.ndarray, radius: float) -> tuple[Any, pin.SE3]:
    """Coal's capsule and its placement; a sphere where the segment has no length."""
    length = float(np.linalg.norm(end - start))
    shape = coal.Capsule(radius, length) if length > 0 else coal.Sphere(radius)
    return shape, segment_placement(start, end)


def coal_obstacle(obstacle: Obstacle) -> tuple[Any, pin.SE3]:
    """Coal's shape of an obstacle and its placement in the world."""
    if isinstance(obstacle, BoxObstacle):
        return coal.Box(*obstacle.sides.tolist()), pin.SE3(obstacle.turn, obstacle.position)
    return coal_capsule(*obstacle.axis, obstacle.radius)


def require_different_names(what: str, names: Sequence[str]) -> None:
    """Raises InputError where two of them are the same."""
    double = sorted({name for name in names if names.count(name) > 1})
    if double:
        raise InputError(f"two {what} are named {', '.join(double)}", "allowed: different names")


def _set_vectors(shape: Any, label: str, names: Sequence[str]) -> None:
    for name in names:
        vector = finite_array(f"{name} of {label}", getattr(shape, name), unit="m")
        object.__setattr__(shape, name, vector)


def _set_radius(shape: Any, label: str) -> None:
    require_positive(f"radius of {label}", shape.radius, "m")
    object.__setattr__(shape, "radius", float(shape.radius))


def _described(shape: Any) -> dict[str, Any]:
    """Fields of a shape as JSON has them."""
    return {name: np.asarray(value).tolist() for name, value in vars(shape).items()}


def _require_keys(described: Any, keys: Sequence[str], what: str) -> None:
    if not isinstance(described, dict) or set(described) != set(keys):
        raise InputError(f"a {what} is described by {described!r}", f"keys: {', '.join(keys)}")
