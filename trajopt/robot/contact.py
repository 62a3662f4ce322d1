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
        name: name of the contact; default that of the frame.
        kind: "point" transmits a force (3 rows); "surface" is a rectangular sole in the x-y plane of its
            frame, centred at the frame's origin, and transmits force and moment (6 rows).
        half_length: half length of a sole along x, m.
        half_width: half width of a sole along y, m.
        radius: radius of a point contact, m: it touches with a ball around its frame's origin. The centre
            keeps this distance from the ground, and the force passes through it, unless the ball rolls.
        rolling: whether the ball is fixed to its link and rolls without slip on planes: the centre moves at
            the link's angular velocity times the radius, and the force acts at the point of contact.
        rows: entries of (force, moment) in world axes that it transmits, default all; a planar `Robot`
            keeps those within its plane.

    Raises:
        InputError: for an unknown kind, a sole without a size or a point with one, a negative radius or a
            sole with one, rolling without a radius, and unknown rows.
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
        """Number of rows: 3 for a point, 6 for a surface; in a plane 2 and 3."""
        return len(self.rows)

    @property
    def transmits_all(self) -> bool:
        """Whether it transmits all rows of its kind, so that its axes may be rotated."""
        return self.dimension == (3 if self.kind == "point" else 6)

    @property
    def corners(self) -> np.ndarray:
        """Points (n, 2) in its frame's x-y plane, m: the origin for a point, the four corners of a sole."""
        if self.kind == "point":
            return np.zeros((1, 2))
        return np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [self.half_length, self.half_width]

    def gap(self, ground: Ground, position: np.ndarray) -> float:
        """Signed distance in m of the contact from its ground; ``position`` (3,) is its frame's origin."""
        return float(ground.distance(position))

    def lever(self, ground: Ground | None) -> np.ndarray | None:
        """Vector (3,), m, from the point where a rolling ball touches a plane to its centre; else None."""
        return self.radius * ground.normal if self.rolling and isinstance(ground, Surface) else None

    def within_plane(self, normal: int) -> Contact:
        """The same contact on a robot confined to the plane normal to the world's axis ``normal``."""
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
    """Set the moments, about the centres, of wrenches (nc, 6) on rolling contacts from levers (3,) m."""
    for wrench, contact in zip(wrenches, contacts, strict=True):
        if contact.name in levers:
            wrench[3:] = np.cross(wrench[:3], levers[contact.name])


def centre_of_pressure(force: np.ndarray, moment: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Vector from the contact frame's origin to the centre of pressure, ``n x m / (n . f)``, (..., 3) in m.

    ``force`` and ``moment`` (..., 3) act at that origin; the unit ``normal`` (..., 3) of the surface is in
    the same axes. Infinite or NaN without a normal force.
    """
    pressure = np.sum(np.asarray(normal) * force, axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.cross(normal, moment) / pressure)
