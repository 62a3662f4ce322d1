"""Margins of forces within Coulomb's law, implemented for the check independently of the planner's rows."""

import numpy as np
from numpy.typing import ArrayLike

from trajopt.arguments import checked
from trajopt.errors import InputError, shown

# Allowed error in the length of a given unit normal.
UNIT_SLACK = 1e-6


@checked
def cone_margins(wrenches: ArrayLike, normals: ArrayLike, friction: ArrayLike) -> np.ndarray:
    """Return ``mu f_n - |f_t|`` (n,) of forces or impulses: negative outside Coulomb's cone.

    ``wrenches`` (n, 3) or (n, 6) act on the robot, in world axes; moments are ignored. ``normals`` (3,) or
    (n, 3) are unit vectors out of the surface, ``friction`` is a number or (n,). The margin of a force that
    pulls is at most f_n. Raises `InputError` for wrong shapes, normals that are not unit vectors, or negative
    friction.
    """
    force = np.asarray(wrenches, dtype=float)
    if force.ndim != 2 or force.shape[1] not in (3, 6):
        raise InputError(f"wrenches have shape {force.shape}", "(n, 3) or (n, 6)")
    force = force[:, :3]
    try:
        normal = np.broadcast_to(np.asarray(normals, dtype=float), force.shape)
        mu = np.broadcast_to(np.asarray(friction, dtype=float), force.shape[:1])
    except ValueError:
        shapes = f"{np.shape(normals)} and {np.shape(friction)}"
        allowed = f"(3,) or ({len(force)}, 3); a number or ({len(force)},)"
        raise InputError(f"normals and friction have shapes {shapes}", allowed) from None
    if not (np.abs(np.linalg.norm(normal, axis=1) - 1) < UNIT_SLACK).all():
        raise InputError("a normal is not of length one", "unit vectors out of the surface")
    if not (mu >= 0).all():
        raise InputError(f"friction is {shown(friction)}", "numbers >= 0")
    along = np.einsum("ij,ij->i", force, normal)
    margin = mu * along - np.linalg.norm(force - along[:, None] * normal, axis=1)
    return np.where(along < 0, np.minimum(margin, along), margin)


def sole_margins(
    force: np.ndarray, moment: np.ndarray, size: tuple[float, float], friction: np.ndarray
) -> np.ndarray:
    """Return the least distance (n,), in N m, of soles' wrenches from the limits of pressure and yaw moment.

    ``force`` and ``moment`` (3, n) are along a sole's two axes and its normal, at its centre. ``size`` is the
    half length and half width, m. ``friction`` (n,) is of pyramids along the axes. The yaw moment is bounded
    as by Caron, Pham and Nakamura, ICRA 2015, eqs. 13-15.
    """
    (length, width), (f_x, f_y, f_n), (m_x, m_y, m_z) = size, force, moment
    pressure = np.minimum(width * f_n - np.abs(m_x), length * f_n - np.abs(m_y))
    most = friction * (length + width) * f_n
    up = most - m_z - np.abs(width * f_x + friction * m_x) - np.abs(length * f_y + friction * m_y)
    down = most + m_z - np.abs(width * f_x - friction * m_x) - np.abs(length * f_y - friction * m_y)
    return np.asarray(np.minimum(pressure, np.minimum(up, down)))
