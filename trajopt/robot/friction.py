"""The friction cone of a contact: rows, linear in its wrench, that are >= 0 inside.

The exact cone of a point is |f_t| <= mu f_n; pyramids approximate it from inside by a smaller coefficient or
more sides. The rows of a rectangular sole follow from pyramids at its corners (Caron, Pham and Nakamura,
"Stability of surface contacts for humanoid robots: closed-form formulae of the contact wrench cone for
rectangular support areas", ICRA 2015). Forces and moments (3) are numbers, arrays or symbols, the third along
the normal.
"""

import math
from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np

# Three components.
Vector = Sequence[Any] | np.ndarray
_SIGNS = tuple(product((1, -1), repeat=2))


def friction_rows(force: Vector, friction: Any) -> list[Any]:
    """Four rows of the pyramid |f_x|, |f_y| <= friction f_z."""
    return [friction * force[2] + sign * force[i] for i in (0, 1) for sign in (-1, 1)]


def inscribed_rows(force: Vector, friction: float, sides: int) -> list[Any]:
    """Rows of the pyramid with that many sides inscribed in Coulomb's cone; the first is normal to x."""
    angles = [2.0 * math.pi / sides * side for side in range(sides)]
    pressed = math.cos(math.pi / sides) * friction * force[2]
    return [pressed - math.cos(angle) * force[0] - math.sin(angle) * force[1] for angle in angles]


def pressure_rows(force: Vector, moment: Vector, size: tuple[float, float]) -> list[Any]:
    """Four rows of a sole that keep its centre of pressure inside.

    ``moment`` is about the sole's centre; ``size`` is its half length and half width (x, y), m.
    """
    length, width = size
    return [arm * force[2] + sign * moment[i] for i, arm in ((0, width), (1, length)) for sign in (-1, 1)]


def yaw_rows(force: Vector, moment: Vector, size: tuple[float, float], friction: Any) -> list[Any]:
    """Eight rows of a sole: friction can carry the yaw moment in addition to the rest.

    With half sizes X, Y and the pyramid's coefficient mu,

        mu (X + Y) f_z - |Y f_x - mu m_x| - |X f_y - mu m_y| + m_z >= 0
        mu (X + Y) f_z - |Y f_x + mu m_x| - |X f_y + mu m_y| - m_z >= 0

    (eqs. 13-15 of Caron et al.) With the friction and the pressure rows these describe all wrenches that
    forces inside the pyramid, anywhere on the sole, can produce.
    """
    length, width = size
    rows = []
    for turn in (1, -1):
        across = width * force[0] - turn * friction * moment[0]
        along = length * force[1] - turn * friction * moment[1]
        held = friction * (length + width) * force[2] + turn * moment[2]
        rows += [held - first * across - second * along for first, second in _SIGNS]
    return rows
