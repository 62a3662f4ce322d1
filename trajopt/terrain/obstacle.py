"""Where an obstacle stands, and its faces in its own axes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trajopt.errors import InputError, require_positive
from trajopt.terrain.patch import Patch
from trajopt.terrain.surface import UP, Surface

PlanePoint = Sequence[float] | np.ndarray


@dataclass(frozen=True)
class ObstacleAxes:
    """Where an obstacle stands: its origin (x, y) m and direction rad, and what its faces share."""

    at: PlanePoint
    yaw: float
    friction: float
    margin: float

    def face(self, name: str, corners: Sequence[tuple[float, float, float]]) -> Patch:
        """A face with corners (x, y, z) in the obstacle's own axes."""
        origin = np.array(self.at, dtype=float)
        if origin.shape != (2,) or not np.isfinite([*origin, self.yaw]).all():
            raise InputError(
                f"an obstacle stands at {self.at!r} m, yaw {self.yaw!r}",
                "allowed: two finite numbers and a yaw",
            )
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        points = np.array(corners, dtype=float) @ turn.T + np.array([*origin, 0.0])
        normal = np.cross(points[1] - points[0], points[3] - points[0])
        if np.ptp(points[:, 2]) == 0.0:
            normal = np.array(UP)
        surface = Surface(point=points[0], normal=normal, friction=self.friction)
        return Patch(surface=surface, vertices=points, margin=self.margin, name=name)

    def rectangle(
        self, name: str, x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]
    ) -> Patch:
        """A face over a rectangle in the obstacle's own axes, whose height goes from z[0] at x[0] to z[1]."""
        corners = [(x[0], y[0], z[0]), (x[1], y[0], z[1]), (x[1], y[1], z[1]), (x[0], y[1], z[0])]
        return self.face(name, corners)


def require_lengths(**lengths: float) -> None:
    """Raise `InputError` for a length of an obstacle that is not finite and positive."""
    for name, length in lengths.items():
        require_positive(f"{name} of an obstacle", length, "m")
