"""A contact of a robot: a frame that may touch its surroundings, as a point or with a sole."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pinocchio as pin

from trajopt.arguments import NonNegative, checked
from trajopt.errors import InputError
from trajopt.terrain.surface import Surface
from trajopt.terrain.terrain import Ground

ContactKind = Literal["point", "surface"]


@checked
@dataclass(frozen=True, kw_only=True)
class Contact:
    """A place where the robot may touch its surroundings: a point, or a sole.

    Args:
        frame: name of a frame of the model.
        name: default the frame's name.
        kind: "point" transmits a force (3 rows); "surface" is a rectangular sole in the x-y plane of its
            frame, centred at the frame's origin, and transmits force and moment (6 rows).
        half_length: of a sole along x, m.
        half_width: of a sole along y, m.
        radius: of a point contact, m: it touches with a ball around its frame's origin. Its centre keeps this
            distance from the ground, and the force passes through it, unless it rolls.
        rolling: whether the ball is fixed to its link and rolls without slip on planes: the centre moves at
            the link's angular velocity times the radius, and the force acts where the ball touches.
        rows: entries of (force, moment) in world axes that it transmits, default all; a `Robot` in a plane
            keeps those within it.

    Raises:
        InputError: for an unknown kind, a sole without size or a point with one, a radius that is negative
            or of a sole, rolling without a radius, and unknown rows.
    """

    frame: str
    name: str = ""
    kind: ContactKind = "point"
    half_length: float = 0.0
    half_width: float = 0.0
    radius: NonNegative = 0.0
    rolling: bool = False
    rows: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if not self.name:
            object.__setattr__(self, "name", self.frame)
        size = np.array([self.half_length, self.half_width], dtype=float)
        if self.kind == "surface" and not (np.isfinite(size).all() and (size > 0).all()):
            raise InputError(
                f"surface contact '{self.name}' has half_length={size[0]}, half_width={size[1]}",
                "positive lengths in m",
            )
        if self.kind == "point" and size.any():
            raise InputError(f"point contact '{self.name}' has a size", "kind='surface' for a sole")
        if self.kind == "surface" and self.radius:
            raise InputError(f"surface contact '{self.name}' has a radius", "kind='point' for a ball")
        if self.rolling and not self.radius:
            raise InputError(f"contact '{self.name}' rolls and has no radius", "radius=... in m, of a ball")
        every = tuple(range(3 if self.kind == "point" else 6))
        object.__setattr__(self, "rows", tuple(self.rows) or every)
        if not set(self.rows) <= set(every):
            raise InputError(f"contact '{self.name}' has rows {self.rows}", f"some of {every}")

    @property
    def dimension(self) -> int:
        """Rows of the contact: 3 for a point, 6 for a surface; in a plane 2 and 3."""
        return len(self.rows)

    @property
    def transmits_all(self) -> bool:
        """Whether no row of its kind is left out, so that its axes may be turned."""
        return self.dimension == (3 if self.kind == "point" else 6)

    @property
    def corners(self) -> np.ndarray:
        """Points (n, 2) along its frame's x and y, m: the origin of a point, the four corners of a sole."""
        if self.kind == "point":
            return np.zeros((1, 2))
        return np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [self.half_length, self.half_width]

    def gap(self, ground: Ground, position: np.ndarray) -> float:
        """Signed distance in m of the contact, its frame's origin at a position (3,), from its ground."""
        return float(ground.distance(position))

    def lever(self, ground: Ground | None) -> np.ndarray | None:
        """From where a ball that rolls touches a plane to its centre (3,), m; None of other contacts."""
        return self.radius * ground.normal if self.rolling and isinstance(ground, Surface) else None

    def within_plane(self, normal: int) -> Contact:
        """The same contact of a robot that cannot leave the plane across the world's axis ``normal``."""
        in_plane = [axis for axis in range(3) if axis != normal]
        return replace(self, rows=(*in_plane, *([3 + normal] if self.kind == "surface" else [])))


def require_frame(model: pin.Model, frame: str, where: str) -> None:
    """Raise `InputError` naming the closest frames if ``model`` has no ``frame``."""
    names = [entry.name for entry in model.frames]
    if frame not in names:
        close = difflib.get_close_matches(frame, names, n=5, cutoff=0.4) or names[-8:]
        raise InputError(
            f"{where} names frame '{frame}', which the model does not have",
            "close matches: " + ", ".join(close),
        )


def set_rolling_moments(
    wrenches: np.ndarray, contacts: Sequence[Contact], levers: Mapping[str, np.ndarray]
) -> None:
    """Set moments of wrenches (nc, 6) on ``contacts`` that roll, about their centres, by levers (3,) m."""
    for wrench, contact in zip(wrenches, contacts, strict=True):
        if contact.name in levers:
            wrench[3:] = np.cross(wrench[:3], levers[contact.name])
