"""Uneven ground of a replay: faces as solid blocks with holes between, or a smooth surface."""

from __future__ import annotations

from typing import Any

import meshcat.geometry as shapes
import numpy as np

from trajopt.terrain.patch import Patch, cut_polygon
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.smooth import SmoothTerrain
from trajopt.terrain.surface import Surface
from trajopt.view.replay.parts import (
    UPWARD,
    ColouredMesh,
    ColouredMeshGeometry,
    MeshPart,
    colour_array,
    fan,
    grid_triangles,
    line_points,
)

GRID_STRONG = 0x808C9B
# Colours of consecutive planes differ slightly. Faces of one plane may overlap, as the ground around a box:
# with two colours they would flicker in bands.
GROUND_TINTS = (0xCDD4DD, 0xB9C3CF)
# Ground on each side of the motion, in robot extents; blocks reach this far below the lowest face drawn.
MARGIN, DEPTH = 3.0, 0.3
# Cells of a smooth ground along its longer side.
CELLS = 80
# Darker than a plane, so that slopes facing the sun stay below white.
SMOOTH_COLOUR = 0xC2CAD4
# Walls of blocks are this much darker than their tops.
WALL_SHADE = 0.75
# Lines lie over the ground by this fraction of the robot's extent, so that both are visible.
LINE_LIFT = 0.002


def draw_terrain(
    vis: Any,
    terrain: PiecewiseTerrain | SmoothTerrain,
    box: np.ndarray,
    margin: np.ndarray,
    drop: float,
    size: float,
) -> None:
    """Draw the ground ``margin`` (2,) m around ``box`` (2, 3), lowered by ``drop`` m to the drawn feet."""
    area = np.array([box[0, :2] - margin, box[1, :2] + margin])
    if isinstance(terrain, PiecewiseTerrain):
        _draw_faces(vis["ground"], terrain, area, drop, size)
    else:
        _draw_smooth(vis["ground"], terrain, area, drop, size)


def _draw_faces(node: Any, terrain: PiecewiseTerrain, area: np.ndarray, drop: float, size: float) -> None:
    seen = [(face, corners) for face in terrain.faces if len(corners := _within(face, area)) >= 3]
    bottom = min([corners[:, 2].min() for _, corners in seen], default=0.0) - drop - DEPTH * size
    material = shapes.MeshLambertMaterial(vertexColors=True)
    planes: list[Surface] = []
    for number, (face, corners) in enumerate(seen):
        top = corners - drop * UPWARD
        colour = GROUND_TINTS[_place_of(face.surface, planes) % len(GROUND_TINTS)]
        node[f"face{number}"].set_object(_block(top, bottom, colour), material)
        outline = np.vstack([top, top[:1]]) + LINE_LIFT * size * UPWARD
        node[f"edge{number}"].set_object(
            shapes.Line(line_points(outline), shapes.LineBasicMaterial(color=GRID_STRONG))
        )


def _place_of(plane: Surface, planes: list[Surface]) -> int:
    """The place of a plane among the different ``planes`` so far, to which it is added."""
    for place, other in enumerate(planes):
        if plane.same_plane(other):
            return place
    planes.append(plane)
    return len(planes) - 1


def _within(face: Patch, area: np.ndarray) -> np.ndarray:
    """Corners (k, 3) of the part of a face over the drawn area."""
    corners = face.vertices
    for axis in (0, 1):
        inward = np.eye(3)[axis]
        corners = cut_polygon(corners, inward, float(area[0][axis]))
        corners = cut_polygon(corners, -inward, -float(area[1][axis]))
    return corners


def _block(top: np.ndarray, bottom: float, colour: int) -> ColouredMeshGeometry:
    """A prism under a convex polygon (k, 3): its top of that colour, darker walls down to ``bottom`` m."""
    under = np.column_stack([top[:, :2], np.full(len(top), bottom)])
    tone = colour_array(colour)
    parts: list[MeshPart] = [(top, _normal(top), tone, fan(len(top)))]
    for i in range(len(top)):  # walls do not share corners, so that each is shaded flat
        j = (i + 1) % len(top)
        wall = np.array([under[i], under[j], top[j], top[i]])
        parts.append((wall, _normal(wall), WALL_SHADE * tone, fan(4)))
    return ColouredMeshGeometry(ColouredMesh.joined(parts))


def _normal(polygon: np.ndarray) -> np.ndarray:
    """The unit normal (3,) of a polygon's plane by Newell's sum; 0 of one without area."""
    normal = np.cross(polygon, np.roll(polygon, -1, axis=0)).sum(axis=0)
    length = float(np.linalg.norm(normal))
    return np.asarray(normal / length if length > 0 else normal)


def _draw_smooth(node: Any, terrain: SmoothTerrain, area: np.ndarray, drop: float, size: float) -> None:
    spans = np.ptp(area, axis=0)
    cell = float(spans.max()) / CELLS
    counts = np.ceil(spans / cell).astype(int) + 1
    x, y = (low + cell * np.arange(count) for low, count in zip(area[0], counts, strict=True))
    across, along = np.meshgrid(x, y, indexing="ij")
    grid = np.stack([across, along, terrain.height(across, along) - drop], axis=-1)
    mesh = shapes.TriangularMeshGeometry(grid.reshape(-1, 3), grid_triangles(len(x) - 1, len(y) - 1))
    node["smooth"].set_object(mesh, shapes.MeshLambertMaterial(color=SMOOTH_COLOUR))
    lifted = grid + LINE_LIFT * size * UPWARD
    lines = [np.repeat(row, 2, axis=0)[1:-1] for row in (*lifted[::4], *lifted.transpose(1, 0, 2)[::4])]
    points = line_points(np.concatenate(lines))
    node["grid"].set_object(shapes.LineSegments(points, shapes.LineBasicMaterial(color=GRID_STRONG)))
