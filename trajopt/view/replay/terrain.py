"""Ground of a replay that is no plane: faces as solid blocks with holes between, or a smooth surface."""

from __future__ import annotations

from typing import Any

import meshcat.geometry as shapes
import numpy as np

from trajopt.terrain.patch import Patch, cut_polygon
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.smooth import SmoothTerrain
from trajopt.terrain.surface import UP
from trajopt.view.replay.collada import ColouredMesh
from trajopt.view.replay.ground import GRID_STRONG, GROUND_TINTS
from trajopt.view.replay.parts import Triangles, colour_array

# Ground on each side of the motion, in robot extents; blocks reach this far below the lowest face drawn.
MARGIN, DEPTH = 3.0, 0.3
# Cells of a smooth ground along its longer side.
CELLS = 80
# Darker than a plane, so that slopes to the sun stay below white.
SMOOTH_COLOUR = 0xC2CAD4
# Walls of blocks are this much darker than their tops.
WALL_SHADE = 0.75
# Lines lie over the ground by this part of the robot's extent, so that both show.
LINE_LIFT = 0.002
UPWARD = np.array(UP)


def draw_terrain(
    vis: Any,
    terrain: PiecewiseTerrain | SmoothTerrain,
    box: np.ndarray,
    margin: np.ndarray,
    drop: float,
    size: float,
) -> None:
    """Draw the ground ``margin`` (2,) m around ``box`` (2, 3), lowered by ``drop`` m to the drawn feet."""
    low, high = box[0, :2] - margin, box[1, :2] + margin
    if isinstance(terrain, PiecewiseTerrain):
        _draw_faces(vis["ground"], terrain, (low, high), drop, size)
    else:
        _draw_smooth(vis["ground"], terrain, (low, high), drop, size)


def _draw_faces(
    node: Any, terrain: PiecewiseTerrain, area: tuple[np.ndarray, np.ndarray], drop: float, size: float
) -> None:
    drawn = [(face, _within(face, area)) for face in terrain.faces]
    seen = [(face, corners) for face, corners in drawn if len(corners) >= 3]
    bottom = min([corners[:, 2].min() for _, corners in seen], default=0.0) - drop - DEPTH * size
    material = shapes.MeshLambertMaterial(vertexColors=True)
    for number, (_, corners) in enumerate(seen):
        top = corners - drop * UPWARD
        colour = GROUND_TINTS[number % len(GROUND_TINTS)]
        node[f"face{number}"].set_object(_block(top, bottom, colour), material)
        outline = np.vstack([top, top[:1]]) + LINE_LIFT * size * UPWARD
        points = shapes.PointsGeometry(position=outline.T.astype(np.float32))
        node[f"edge{number}"].set_object(shapes.Line(points, shapes.LineBasicMaterial(color=GRID_STRONG)))


def _within(face: Patch, area: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Corners (k, 3) of the part of a face over the drawn area."""
    corners = face.vertices
    for axis in (0, 1):
        inward = np.eye(3)[axis]
        corners = cut_polygon(corners, inward, float(area[0][axis]))
        corners = cut_polygon(corners, -inward, -float(area[1][axis]))
    return corners


def _block(top: np.ndarray, bottom: float, colour: int) -> Triangles:
    """A prism under a convex polygon (k, 3): its top of that colour, darker walls down to ``bottom`` m."""
    under = np.column_stack([top[:, :2], np.full(len(top), bottom)])
    tone = colour_array(colour)
    points, normals, triangles = [top], [_normals(top)], [_fan(len(top))]
    for i in range(len(top)):  # walls have corners of their own, so that each is shaded flat
        j = (i + 1) % len(top)
        wall = np.array([under[i], under[j], top[j], top[i]])
        triangles.append(sum(map(len, points)) + _fan(4))
        points.append(wall)
        normals.append(_normals(wall))
    vertices = np.concatenate(points)
    colours = np.tile(WALL_SHADE * tone, (len(vertices), 1))
    colours[: len(top)] = tone
    return Triangles(
        ColouredMesh(
            vertices=vertices.astype(np.float32),
            normals=np.concatenate(normals).astype(np.float32),
            colours=colours.astype(np.float32),
            triangles=np.concatenate(triangles).astype(np.uint32),
        )
    )


def _fan(corners: int) -> np.ndarray:
    """Triangles (k - 2, 3) of a convex polygon of k corners."""
    return np.array([(0, i, i + 1) for i in range(1, corners - 1)])


def _normals(polygon: np.ndarray) -> np.ndarray:
    """The unit normal of a polygon's plane by Newell's sum, at every corner (k, 3); 0 of one without area."""
    normal = np.cross(polygon, np.roll(polygon, -1, axis=0)).sum(axis=0)
    length = float(np.linalg.norm(normal))
    return np.tile(normal / length if length > 0 else normal, (len(polygon), 1))


def _draw_smooth(
    node: Any, terrain: SmoothTerrain, area: tuple[np.ndarray, np.ndarray], drop: float, size: float
) -> None:
    low, high = area
    cell = float(np.max(high - low)) / CELLS
    x, y = (
        np.arange(int(np.ceil(span / cell)) + 1) * cell + start
        for span, start in zip(high - low, low, strict=True)
    )
    across, along = np.meshgrid(x, y, indexing="ij")
    grid = np.stack([across, along, terrain.height(across, along) - drop], axis=-1)
    index = np.arange(grid[..., 0].size).reshape(len(x), len(y))
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    triangles = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    mesh = shapes.TriangularMeshGeometry(grid.reshape(-1, 3), triangles)
    node["smooth"].set_object(mesh, shapes.MeshLambertMaterial(color=SMOOTH_COLOUR))
    lifted = grid + LINE_LIFT * size * UPWARD
    lines = [np.repeat(row, 2, axis=0)[1:-1] for row in (*lifted[::4], *lifted.transpose(1, 0, 2)[::4])]
    points = shapes.PointsGeometry(position=np.concatenate(lines).T.astype(np.float32))
    node["grid"].set_object(shapes.LineSegments(points, shapes.LineBasicMaterial(color=GRID_STRONG)))
