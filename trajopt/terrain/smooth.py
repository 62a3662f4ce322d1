"""Smooth ground z = h(x, y): a sum of analytic shapes, its normals, and its contact surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from trajopt.errors import InputError, require_not_negative
from trajopt.terrain.shapes import ParameterOf, Shape, shape_from_description
from trajopt.terrain.surface import Surface


@dataclass(frozen=True, kw_only=True)
class SmoothTerrain:
    """Ground at height h(x, y), the sum of ``shapes``, with one Coulomb ``friction``. Raises `InputError`."""

    shapes: tuple[Shape, ...]
    friction: float = 0.7

    def __post_init__(self) -> None:
        object.__setattr__(self, "shapes", tuple(self.shapes))
        if not self.shapes or not all(isinstance(shape, Shape) for shape in self.shapes):
            raise InputError(
                "a smooth terrain has no shapes, or some that are not shapes", "allowed: shapes, at least one"
            )
        require_not_negative("friction coefficient", self.friction)

    @property
    def surface(self) -> CurvedSurface:
        """The ground as a surface that contacts touch."""
        return CurvedSurface(self)

    def surface_at(self, point: np.ndarray) -> CurvedSurface:
        """The ground under a position (3,) m: the same everywhere."""
        return self.surface

    def height(self, x: Any, y: Any) -> np.ndarray:
        """Height (...) in m at x, y (...) m."""
        across, along = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        return np.asarray(sum(shape.height(across, along) for shape in self.shapes))

    def normal(self, x: Any, y: Any) -> np.ndarray:
        """Unit normal (..., 3) at x, y (...) m: (-dh/dx, -dh/dy, 1) over its length."""
        across, along = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        slopes = [shape.gradient(across, along) for shape in self.shapes]
        dx, dy = (np.asarray(sum(parts)) for parts in zip(*slopes, strict=True))
        raw = np.stack([-dx, -dy, np.ones_like(dx)], axis=-1)
        return np.asarray(raw / np.linalg.norm(raw, axis=-1, keepdims=True))

    def symbolic_height(self, x: ca.SX, y: ca.SX, parameter: ParameterOf) -> ca.SX:
        """Symbolic height; the shapes' numbers enter through ``parameter``."""
        return sum((shape.symbolic(x, y, parameter) for shape in self.shapes), ca.SX(0))

    def describe(self) -> dict[str, Any]:
        """JSON-able description for a solution file."""
        shapes = [shape.describe() for shape in self.shapes]
        return {"kind": "smooth", "friction": self.friction, "shapes": shapes}

    @classmethod
    def from_description(cls, described: Any) -> SmoothTerrain:
        """The terrain that ``describe`` wrote. Raises `InputError`."""
        shapes = described.get("shapes") if isinstance(described, dict) else None
        friction = described.get("friction") if isinstance(described, dict) else None
        if not isinstance(shapes, list) or not isinstance(friction, int | float):
            raise InputError("a smooth terrain is described without shapes or friction", "allowed: both")
        return cls(shapes=tuple(shape_from_description(shape) for shape in shapes), friction=friction)


@dataclass(frozen=True)
class CurvedSurface:
    """Smooth ground as the surface of a point contact: its normal depends on where the contact is."""

    ground: SmoothTerrain
    bilateral: ClassVar[bool] = False
    is_level: ClassVar[bool] = False

    @property
    def friction(self) -> float:
        """Coulomb's coefficient."""
        return self.ground.friction

    def distance(self, position: np.ndarray) -> np.ndarray:
        """Distance (...) in m of positions (..., 3) from the tangent plane under them, positive above."""
        point = np.asarray(position, dtype=float)
        over = point[..., 2] - self.ground.height(point[..., 0], point[..., 1])
        return np.asarray(over * self.ground.normal(point[..., 0], point[..., 1])[..., 2])

    def plane_at(self, position: np.ndarray) -> Surface:
        """The tangent plane under a position (3,) m."""
        x, y = (float(entry) for entry in position[:2])
        point = np.array([x, y, float(self.ground.height(x, y))])
        return Surface(point=point, normal=self.ground.normal(x, y), friction=self.friction)

    def same_plane(self, other: object) -> bool:
        """Whether the other is the same ground."""
        return isinstance(other, CurvedSurface) and other.ground == self.ground

    def symbolic_gap(self, position: ca.SX, parameter: ParameterOf) -> ca.SX:
        """Height z - h(x, y) of a position (3,) over the ground."""
        return position[2] - self.ground.symbolic_height(position[0], position[1], parameter)

    def symbolic_frame(self, position: ca.SX, parameter: ParameterOf) -> ca.SX:
        """Columns tangent, tangent, normal (3, 3) at a position (3,): symbolic `frame_of_normal`."""
        x, y = ca.SX.sym("x"), ca.SX.sym("y")
        height = self.ground.symbolic_height(x, y, parameter)
        slopes = ca.gradient(height, ca.vertcat(x, y))
        slopes = ca.substitute(slopes, ca.vertcat(x, y), position[:2])
        length = ca.sqrt(1 + ca.sumsqr(slopes))
        nx, ny, nz = -slopes[0] / length, -slopes[1] / length, 1 / length
        part = 1 / (1 + nz)
        first = ca.vertcat(1 - part * nx * nx, -part * nx * ny, -nx)
        second = ca.vertcat(-part * nx * ny, 1 - part * ny * ny, -ny)
        return ca.horzcat(first, second, ca.vertcat(nx, ny, nz))
