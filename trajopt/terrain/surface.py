"""A plane that a contact touches: its position, normal and friction."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np

from trajopt.arguments import Array3, NonNegative, Positive, checked
from trajopt.errors import InputError, shown

_Touch = TypeVar("_Touch")

UP = (0.0, 0.0, 1.0)
# Two surfaces are one plane within this distance, m, and this error of the normal: rounding of forward
# kinematics, far below the positioning accuracy of a leg.
SAME_PLANE = 1e-6
# Largest length of shapes and of the ground, m: geometry libraries abort the process at 1e30.
FARTHEST = 1e4
# Most corners of one shape or face, and most shapes of one robot or faces and shapes of one terrain.
MOST_CORNERS, MOST_SHAPES = 10_000, 1000
# Number of parallel surfaces that are cached.
MOST_OFFSETS = 256


def frame_of_normal(normal: Sequence[float] | np.ndarray) -> np.ndarray:
    """Rotation (3, 3) whose columns are two tangents and the unit ``normal`` (3,), right-handed.

    It is the smallest rotation that takes the world's z axis to the normal: the identity for level ground,
    smooth in the normal except straight down, where it is a half turn about x. Rodrigues' formula with the
    axis z x n, written without cancellation for n_z < 0.
    """
    x, y, z = (float(entry) for entry in normal)
    across = x * x + y * y
    if across == 0.0:
        return np.diag([1.0, math.copysign(1.0, z), math.copysign(1.0, z)])
    part = 1.0 / (1.0 + z) if z >= 0 else (1.0 - z) / across
    first = [1.0 - part * x * x, -part * x * y, -x]
    second = [-part * x * y, 1.0 - part * y * y, -y]
    return np.column_stack([first, second, [x, y, z]])


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """A plane in the world that a contact touches.

    Args:
        point: any point on it (3,), m, world.
        normal: normal towards the robot (3,), world; it is normalised.
        friction: Coulomb's coefficient.
        bilateral: whether it holds the contact (a grasp, a handrail, a bolt). Then it transmits any wrench of
            the contact's kind, and neither friction nor unilateral rows apply; the normal only determines how
            a contact lands on it.
        slip_speed: speed at which a point contact slides along the surface, against its friction, m/s (see
            `trajopt.terms.dynamics`); None for a contact that does not slide.

    Raises:
        InputError: for a wrong shape, a normal without length, a number out of range.
    """

    point: Array3
    normal: Array3
    friction: NonNegative = 0.7
    bilateral: bool = False
    slip_speed: Positive | None = None

    def __post_init__(self) -> None:
        length = float(np.linalg.norm(self.normal))
        if not length > 0:
            raise InputError("normal of a surface has no length", "allowed: any direction")
        if self.slip_speed is not None and self.bilateral:
            raise InputError(
                f"slip_speed of a bilateral surface is {shown(self.slip_speed)}",
                "allowed: on a surface that is not bilateral",
            )
        normal = self.normal / length
        normal.setflags(write=False)
        object.__setattr__(self, "normal", normal)

    @property
    def frame(self) -> np.ndarray:
        """Columns tangent, tangent, normal (3, 3); see `frame_of_normal`."""
        return frame_of_normal(self.normal)

    @property
    def tangents(self) -> np.ndarray:
        """Two orthonormal tangents as rows (2, 3)."""
        return self.frame[:, :2].T

    @property
    def is_level(self) -> bool:
        """Whether the normal is the world's z axis exactly."""
        return bool(np.array_equal(self.normal, UP))

    @property
    def height(self) -> float:
        """Signed distance of the plane from the world's origin along the normal, m."""
        return float(self.normal @ self.point)

    def distance(self, position: np.ndarray) -> np.ndarray:
        """Signed distance (...) in m of world positions (..., 3), positive on the normal's side."""
        return np.asarray((np.asarray(position, dtype=float) - self.point) @ self.normal)

    def plane_at(self, position: np.ndarray) -> Surface:
        """The plane under a position (3,) m: itself everywhere."""
        return self

    @lru_cache(maxsize=MOST_OFFSETS)  # noqa: B019 (a few surfaces, of which terms ask for the same at each node)
    def offset(self, distance: float) -> Surface:
        """The parallel surface ``distance`` m along the normal, for the centre of a ball of that radius."""
        return replace(self, point=self.point + distance * self.normal) if distance else self

    def same_plane(self, other: object) -> bool:
        """Whether the other surface is the same plane, seen from the same side."""
        if not isinstance(other, Surface):
            return False
        turned = float(np.abs(self.normal - other.normal).max())
        return turned < SAME_PLANE and abs(float(self.distance(other.point))) < SAME_PLANE

    def describe(self) -> dict[str, Any]:
        """JSON-able description for a solution file."""
        given = {name: value for name, value in vars(self).items() if value is not None}
        return given | {"point": self.point.tolist(), "normal": self.normal.tolist()}

    @classmethod
    def from_description(cls, described: Any) -> Surface:
        """The surface that ``describe`` wrote. Raises `InputError`."""
        keys = ("point", "normal", "friction", "bilateral")
        if not isinstance(described, dict) or set(described) - {"slip_speed"} != set(keys):
            raise InputError(f"a surface is described by {shown(described)}", f"allowed: {', '.join(keys)}")
        return cls(**described)


def by_plane(touches: Iterable[_Touch], surface_of: Callable[[_Touch], Surface]) -> list[list[_Touch]]:
    """Return the touches of each plane, planes in the order of their first touch."""
    groups: list[list[_Touch]] = []
    for touch in touches:
        plane = surface_of(touch)
        same = next((group for group in groups if surface_of(group[0]).same_plane(plane)), None)
        if same is None:
            groups.append([touch])
        else:
            same.append(touch)
    return groups
