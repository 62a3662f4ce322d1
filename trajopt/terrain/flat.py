"""One plane to stand on: level ground or a slope."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cached_property

import numpy as np

from trajopt.arguments import NonNegative, checked
from trajopt.errors import InputError
from trajopt.terrain.surface import UP, Surface


@checked
@dataclass(frozen=True, kw_only=True)
class FlatGround:
    """A plane to stand on with Coulomb friction: level, or a slope.

    Args:
        height: height at the world's origin, m.
        friction: Coulomb's coefficient.
        normal: upward normal (3,), which is normalised; (0, 0, 1) for level ground.

    Raises:
        InputError: for a normal that does not point up.
    """

    height: float = 0.0
    friction: NonNegative = 0.7
    normal: tuple[float, float, float] = UP

    def __post_init__(self) -> None:
        normal = self.surface.normal
        if not normal[2] > 0:
            raise InputError(f"normal of the ground is {self.normal}", "allowed: upwards, z > 0")
        object.__setattr__(self, "normal", tuple(normal.tolist()))

    @cached_property
    def surface(self) -> Surface:
        """The ground as a surface that contacts touch."""
        point = np.array([0.0, 0.0, self.height])
        return Surface(point=point, normal=np.array(self.normal), friction=self.friction)

    def surface_at(self, point: np.ndarray) -> Surface:
        """The surface under a position (3,) m: the same everywhere."""
        return self.surface

    def offset(self, distance: float) -> FlatGround:
        """The parallel ground ``distance`` m along the normal."""
        return replace(self, height=self.height + distance / self.normal[2]) if distance else self

    def describe(self) -> dict[str, object]:
        """JSON-able description for a solution file."""
        return {"kind": "flat", **asdict(self), "normal": list(self.normal)}
