"""Height of contacts above any terrain as one smooth function, independent of phases."""

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from trajopt.terrain.flat import FlatGround
from trajopt.terrain.patch import Patch
from trajopt.terrain.smooth import SmoothTerrain
from trajopt.terrain.surface import Surface
from trajopt.terrain.terrain import Terrain

# In robot lengths: half the width of the flank that replaces an edge, and depth of a hole.
FLANK, HOLE = 0.03, 0.5


def gap(terrain: Terrain, point: np.ndarray, radius: float) -> float:
    """Height, m, of a contact's origin (3,) m above the one at which it touches; infinite over a hole."""
    if isinstance(terrain, FlatGround):
        return float(point[2]) - _plane(terrain.surface, point[0], point[1], radius)
    return float(point[2] - terrain.offset(radius).height(point[0], point[1]))


def smooth_gap(
    terrain: Terrain, point: ca.SX, radius: float, length: float, parameter: Callable[[Any], ca.SX]
) -> ca.SX:
    """`gap` of a symbolic point (3,), with flanks in place of edges; ``length``: the robot's length, m."""
    if isinstance(terrain, SmoothTerrain):
        return terrain.offset(radius).symbolic(point, parameter)[0]
    if isinstance(terrain, FlatGround):
        return point[2] - _plane(terrain.surface, point[0], point[1], radius)
    faces = sorted(terrain.faces, key=lambda face: float(face.vertices[:, 2].max()))
    height = ca.SX(float(faces[0].vertices[:, 2].min()) - HOLE * length)
    for face in faces:
        inside = _inside(face, point, FLANK * length)
        height += (_plane(face.surface, point[0], point[1], radius) - height) * inside
    return point[2] - height


def _plane(surface: Surface, x: Any, y: Any, radius: float) -> Any:
    """Height at x, y of a surface's plane, offset by ``radius`` along its normal."""
    n = surface.normal
    return (surface.height + radius - n[0] * x - n[1] * y) / n[2]


def _inside(face: Patch, point: ca.SX, width: float) -> ca.SX:
    """Smooth indicator of a face seen from above: 1 inside, 0 outside."""
    product = ca.SX(1)
    for inward, offset in zip(face.inward, face.offsets, strict=True):
        across = float(np.linalg.norm(inward[:2]))
        along = inward[0] * point[0] + inward[1] * point[1] + inward[2] * face.vertices[0, 2]
        away = (along - offset) / across
        product *= 1 / (1 + ca.exp(-away / width * 2))
    return product
