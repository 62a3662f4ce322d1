"""Mass and inertia of hollow rectangular beams, from their sizes and their material.

A uniform box of mass m and sizes (a, b, c) has, about its centre and along its edges,

    I = m / 12 diag(b^2 + c^2, a^2 + c^2, a^2 + b^2),

and inertias of bodies in one frame add and subtract, so a hollow beam is the outer box minus the hole
(Spong, Hutchinson, Vidyasagar, Robot Modeling and Control, 2006, sec. 7.2).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from trajopt.arguments import Positive, checked
from trajopt.errors import InputError

# kg/m^3, at room temperature: carbon steel, wrought aluminium alloys, grey cast iron.
DENSITY = {"steel": 7850.0, "aluminium": 2700.0, "iron": 7200.0}


@checked
@dataclass(frozen=True, kw_only=True)
class Beam:
    """A uniform straight beam along its own x axis, closed at neither end.

    The origin of its frame is at the centre.

    Args:
        length: along x, m.
        width: outer size along y, m.
        height: outer size along z, m.
        wall: thickness of the four walls, m; half of the smaller outer size, or None, makes it solid.
        density: kg/m^3, or the name of a material of ``DENSITY``.

    Raises:
        InputError: for sizes or densities not above zero, a wall too thick, an unknown material.
    """

    length: Positive
    width: Positive
    height: Positive
    wall: Positive | None = None
    density: Positive | str = "steel"

    def __post_init__(self) -> None:
        if isinstance(self.density, str) and self.density not in DENSITY:
            raise InputError(f"material '{self.density}' is unknown", "one of " + ", ".join(DENSITY))
        if self.wall is not None and self.wall > min(self.width, self.height) / 2:
            raise InputError(
                f"wall of a beam is {self.wall:g} m", f"at most {min(self.width, self.height) / 2:g} m"
            )

    @property
    def kilograms_per_cubic_metre(self) -> float:
        """Density as a number."""
        return DENSITY[self.density] if isinstance(self.density, str) else self.density

    @property
    def hole(self) -> tuple[float, float]:
        """Inner sizes along y and z, m; zero for a solid beam."""
        if self.wall is None:
            return 0.0, 0.0
        return self.width - 2 * self.wall, self.height - 2 * self.wall

    @property
    def mass(self) -> float:
        """Mass in kg."""
        inner_width, inner_height = self.hole
        section = self.width * self.height - inner_width * inner_height
        return self.kilograms_per_cubic_metre * self.length * section

    @property
    def inertia(self) -> np.ndarray:
        """Inertia tensor (3, 3) about the centre in the beam's axes, kg m^2."""
        outer = _box_inertia(self.kilograms_per_cubic_metre, (self.length, self.width, self.height))
        return outer - _box_inertia(self.kilograms_per_cubic_metre, (self.length, *self.hole))

    def spatial_inertia(self, placement: pin.SE3 | None = None) -> pin.Inertia:
        """Spatial inertia in the frame in which ``placement`` is the pose of the beam; default its own."""
        inertia = pin.Inertia(self.mass, np.zeros(3), self.inertia)
        return inertia if placement is None else placement.act(inertia)

    def between(self, start: ArrayLike, end: ArrayLike) -> pin.Inertia:
        """Spatial inertia of the beam laid along the line from ``start`` to ``end`` (3,), m, at its middle.

        The beam keeps its own length. Its z axis lies in the plane of the line and the frame's z axis (or
        x axis, if the line is vertical). Raises `InputError` for equal points.
        """
        first, last = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
        return self.spatial_inertia(pin.SE3(_axes_along(last - first), (first + last) / 2))


def assembled(parts: Sequence[pin.Inertia]) -> pin.Inertia:
    """Sum of inertias that are expressed in one frame."""
    total = pin.Inertia.Zero()
    for part in parts:
        total = total + part
    return total


def _box_inertia(density: float, sizes: tuple[float, float, float]) -> np.ndarray:
    square = np.square(sizes)
    return density * math.prod(sizes) / 12 * np.diag(square.sum() - square)


def _axes_along(direction: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) whose x axis is along ``direction``."""
    length = float(np.linalg.norm(direction))
    if not (length > 0 and math.isfinite(length)):
        raise InputError("a beam between two points that coincide or are not finite", "two different points")
    x = direction / length
    upright = np.hypot(x[0], x[1]) < 1e-9  # parallel to z up to rounding
    y = np.cross([1.0, 0.0, 0.0] if upright else [0.0, 0.0, 1.0], x)
    y /= np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])
