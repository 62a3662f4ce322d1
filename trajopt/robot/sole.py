"""A rectangular sole with friction: its wrench cone in closed form, and its centre of pressure."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np

_SIGNS = tuple(product((1, -1), repeat=2))


def friction_rows(force: Sequence[Any], friction: Any) -> list[Any]:
    """Four expressions that are >= 0 inside the friction pyramid |f_x|, |f_y| <= friction f_z.

    ``force`` (3) in the sole's axes; numbers, arrays or symbols.
    """
    return [friction * force[2] + sign * force[i] for i in (0, 1) for sign in (-1, 1)]


def pressure_rows(force: Sequence[Any], moment: Sequence[Any], size: tuple[float, float]) -> list[Any]:
    """Four expressions that are >= 0 where the centre of pressure is inside the sole.

    ``force``, ``moment`` (3) in the sole's axes at its centre; ``size`` half length and half width (x, y), m.
    """
    length, width = size
    return [arm * force[2] + sign * moment[i] for i, arm in ((0, width), (1, length)) for sign in (-1, 1)]


def yaw_rows(
    force: Sequence[Any], moment: Sequence[Any], size: tuple[float, float], friction: Any
) -> list[Any]:
    """Eight expressions that are >= 0 where friction can carry the yaw moment in addition to the rest.

    With half sizes X, Y and the pyramid's coefficient mu,

        mu (X + Y) f_z - |Y f_x - mu m_x| - |X f_y - mu m_y| + m_z >= 0
        mu (X + Y) f_z - |Y f_x + mu m_x| - |X f_y + mu m_y| - m_z >= 0

    Caron, Pham, Nakamura, "Stability of surface contacts for humanoid robots: closed-form formulae of
    the contact wrench cone for rectangular support areas", ICRA 2015, eqs. 13-15. With the friction and the
    pressure rows these describe all wrenches that forces inside the pyramid, anywhere on the sole, can
    produce.
    """
    length, width = size
    rows = []
    for turn in (1, -1):
        across = width * force[0] - turn * friction * moment[0]
        along = length * force[1] - turn * friction * moment[1]
        held = friction * (length + width) * force[2] + turn * moment[2]
        rows += [held - first * across - second * along for first, second in _SIGNS]
    return rows


def centre_of_pressure(force: np.ndarray, moment: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """From the contact frame's origin to the centre of pressure, ``n x m / (n . f)``, (..., 3) in m.

    ``force``, ``moment`` (..., 3) at that origin and the unit ``normal`` (..., 3) of the surface in the same
    axes. Infinite or NaN without a normal force.
    """
    pressure = np.sum(np.asarray(normal) * force, axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.cross(normal, moment) / pressure)
