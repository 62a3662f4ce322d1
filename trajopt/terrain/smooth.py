"""Smooth ground z = h(x, y): a sum of analytic shapes, its normals, and its contact surface."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from trajopt.arguments import NonNegative, checked
from trajopt.errors import InputError
from trajopt.terrain.shapes import ParameterOf, Shape, shape_from_description
from trajopt.terrain.surface import MOST_SHAPES, Surface

# Fixed-point steps to the point under a position on a parallel surface. Each multiplies the error by the
# distance times the curvature, about 0.1 for feet on the library's waves; the height's error is its square.
STEPS = 3


@checked
@dataclass(frozen=True, kw_only=True)
class SmoothTerrain:
    """Ground at height h(x, y), the sum of ``shapes``, with one Coulomb ``friction``. Raises `InputError`."""

    shapes: tuple[Shape, ...]
    friction: NonNegative = 0.7
    raised: float = field(default=0.0, init=False, repr=False)
    """Distance in m of this surface from the ground with these shapes, to which it is parallel."""

    def __post_init__(self) -> None:
        if not 1 <= len(self.shapes) <= MOST_SHAPES:
            raise InputError(
                f"a smooth terrain has {len(self.shapes)} shapes",
                f"allowed: shapes, at least one, at most {MOST_SHAPES}",
            )

    @property
    def surface(self) -> CurvedSurface:
        """The ground as a surface that contacts touch."""
        return CurvedSurface(self)

    def surface_at(self, point: np.ndarray) -> CurvedSurface:
        """The ground under a position (3,) m: the same everywhere."""
        return self.surface

    def offset(self, distance: float) -> SmoothTerrain:
        """The parallel surface ``distance`` m along the normals, for less than the radius of curvature.

        A point p of the ground with slopes s = (dh/dx, dh/dy) and unit normal n is under the point
        c = p + distance * n of this surface. For a given (x, y) of c, p is found by `STEPS` fixed-point
        steps, and the height by the tangent plane at p, so that its error is of second order in p's.
        """
        if not distance:
            return self
        shifted = replace(self)
        object.__setattr__(shifted, "raised", self.raised + distance)
        return shifted

    def height(self, x: Any, y: Any) -> np.ndarray:
        """Height (...) in m at x, y (...) m."""
        return self.height_and_slopes(x, y)[0]

    def height_and_slopes(self, x: Any, y: Any) -> tuple[np.ndarray, np.ndarray]:
        """Height (...) in m at x, y (...) m, and the slopes (2, ...) of the ground under it."""
        across, along = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        px, py, slopes = self._under(across, along)
        height = np.asarray(sum(shape.height(px, py) for shape in self.shapes))
        if self.raised:
            dx, dy = slopes
            height = height + dx * (across - px) + dy * (along - py)
            height = height + self.raised * np.sqrt(1 + dx * dx + dy * dy)
        return np.asarray(height), slopes

    def normal(self, x: Any, y: Any) -> np.ndarray:
        """Unit normal (..., 3) at x, y (...) m: (-dh/dx, -dh/dy, 1) over its length."""
        across, along = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        _, _, (dx, dy) = self._under(across, along)
        raw = np.stack([-dx, -dy, np.ones_like(dx)], axis=-1)
        return np.asarray(raw / np.linalg.norm(raw, axis=-1, keepdims=True))

    def _under(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Point (x, y) (...) of the ground under positions on this surface, and its slopes (2, ...)."""
        px, py, slopes = x, y, self._slopes(x, y)
        for _ in range(STEPS if self.raised else 0):
            shift = self.raised * slopes / np.sqrt(1 + (slopes**2).sum(axis=0))
            px, py = x + shift[0], y + shift[1]
            slopes = self._slopes(px, py)
        return px, py, slopes

    def _slopes(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        slopes = [shape.gradient(x, y) for shape in self.shapes]
        return np.array([np.asarray(sum(parts)) for parts in zip(*slopes, strict=True)])

    def symbolic(self, position: ca.SX, parameter: ParameterOf) -> tuple[ca.SX, ca.SX]:
        """Vertical height of a position (3,) over this surface, and slopes (2,) of the ground under it.

        The numbers of the shapes and the distance enter through ``parameter``.
        """
        at, place = ca.SX.sym("at", 2), position[:2]
        ground = sum((shape.symbolic(at[0], at[1], parameter) for shape in self.shapes), ca.SX(0))
        gradient = ca.gradient(ground, at)
        if not self.raised:
            return position[2] - ca.substitute(ground, at, place), ca.substitute(gradient, at, place)
        distance, point = parameter(np.array([self.raised])), place
        for _ in range(STEPS):
            slopes = ca.substitute(gradient, at, point)
            point = place + distance * slopes / ca.sqrt(1 + ca.sumsqr(slopes))
        slopes = ca.substitute(gradient, at, point)
        height = ca.substitute(ground, at, point) + ca.dot(slopes, place - point)
        return position[2] - height - distance * ca.sqrt(1 + ca.sumsqr(slopes)), slopes

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
    """Smooth ground as the surface of a point contact; its normal depends on the contact's position."""

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
        height, slopes = self.ground.height_and_slopes(point[..., 0], point[..., 1])
        return np.asarray((point[..., 2] - height) / np.sqrt(1 + (slopes**2).sum(axis=0)))

    def plane_at(self, position: np.ndarray) -> Surface:
        """The tangent plane under a position (3,) m."""
        x, y = (float(entry) for entry in position[:2])
        point = np.array([x, y, float(self.ground.height(x, y))])
        return Surface(point=point, normal=self.ground.normal(x, y), friction=self.friction)

    def same_plane(self, other: object) -> bool:
        """Whether the other is the same ground."""
        return isinstance(other, CurvedSurface) and other.ground == self.ground

    def offset(self, distance: float) -> CurvedSurface:
        """The parallel surface ``distance`` m along the normals, see `SmoothTerrain.offset`."""
        return CurvedSurface(self.ground.offset(distance)) if distance else self

    def symbolic_gap(self, position: ca.SX, parameter: ParameterOf) -> ca.SX:
        """Height z - h(x, y) of a position (3,) over the ground."""
        return self.ground.symbolic(position, parameter)[0]

    def symbolic_frame(self, position: ca.SX, parameter: ParameterOf) -> ca.SX:
        """Columns tangent, tangent, normal (3, 3) at a position (3,): symbolic `frame_of_normal`."""
        slopes = self.ground.symbolic(position, parameter)[1]
        length = ca.sqrt(1 + ca.sumsqr(slopes))
        nx, ny, nz = -slopes[0] / length, -slopes[1] / length, 1 / length
        part = 1 / (1 + nz)
        first = ca.vertcat(1 - part * nx * nx, -part * nx * ny, -nx)
        second = ca.vertcat(-part * nx * ny, 1 - part * ny * ny, -ny)
        return ca.horzcat(first, second, ca.vertcat(nx, ny, nz))
