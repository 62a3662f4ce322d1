"""Shared parts of drawings: coloured triangles, marks that shine through, two-tone marks, lines."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import meshcat.geometry as shapes
import numpy as np
import pinocchio as pin

from trajopt.collision.coal_shapes import segment_placement
from trajopt.view.replay.commands import without_shadow

# Opacity with which marks shine through the robot.
HIDDEN_OPACITY = 0.55
THROUGH = {"opacity": HIDDEN_OPACITY, "transparent": True, "depthTest": False, "depthWrite": False, "side": 0}
# Pieces of a full circle.
ROUND = 32
# Points (n, 3); normals and colours, (n, 3) or one (3,); triangles (m, 3) or their corners (3m,).
MeshPart = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
# Draws a shape into a node at a placement.
Solid = Callable[[Any, Any, pin.SE3], None]
UPWARD = np.array([0.0, 0.0, 1.0])
# Turns Meshcat's cylinders, which lie along y, along z.
UPRIGHT = pin.utils.rotate("x", np.pi / 2)
DARK, WHITE = np.array([0.10, 0.12, 0.15]), np.ones(3)


@dataclass(frozen=True, kw_only=True)
class ColouredMesh:
    """A mesh with vertices, normals and colours (n, 3), colours from 0 to 1, and triangles (m, 3)."""

    vertices: np.ndarray
    normals: np.ndarray
    colours: np.ndarray
    triangles: np.ndarray

    @classmethod
    def joined(cls, parts: Sequence[MeshPart]) -> ColouredMesh:
        """Return one mesh of several parts, each with triangles of its own points."""
        starts = np.cumsum([0, *(len(points) for points, *_ in parts)])
        corners = [index.ravel() + start for (*_, index), start in zip(parts, starts, strict=False)]

        def column(i: int) -> np.ndarray:
            return np.concatenate([np.broadcast_to(part[i], part[0].shape) for part in parts])

        return cls(
            vertices=column(0).astype(np.float32),
            normals=column(1).astype(np.float32),
            colours=column(2).astype(np.float32),
            triangles=np.concatenate(corners).reshape(-1, 3).astype(np.uint32),
        )


class ColouredMeshGeometry(shapes.Geometry):
    """A coloured mesh with its own normals, which Meshcat's mesh geometry does not carry."""

    def __init__(self, mesh: ColouredMesh) -> None:
        super().__init__()
        self._mesh = mesh

    @classmethod
    def joined(cls, parts: Sequence[MeshPart]) -> ColouredMeshGeometry:
        """Return the geometry of several parts."""
        return cls(ColouredMesh.joined(parts))

    def lower(self, object_data: Any) -> dict[str, Any]:
        """Return the geometry in the JSON of three.js."""
        mesh = self._mesh
        colours = shapes.pack_numpy_array(np.round(255 * mesh.colours).astype(np.uint8).T)
        attributes = {
            "position": shapes.pack_numpy_array(mesh.vertices.T),
            "normal": shapes.pack_numpy_array(mesh.normals.T),
            "color": {**colours, "normalized": True},
        }
        data = {"attributes": attributes, "index": shapes.pack_numpy_array(mesh.triangles.T)}
        return {"uuid": self.uuid, "type": "BufferGeometry", "data": data}


def colour_array(colour: int) -> np.ndarray:
    """Red, green, blue (3,) from 0 to 1 of a colour written as 0xRRGGBB."""
    return np.array([colour >> 16 & 255, colour >> 8 & 255, colour & 255]) / 255


def placed(position: Sequence[float] | np.ndarray, rotation: np.ndarray | None = None) -> np.ndarray:
    """Return the placement (4, 4) at ``position`` (3,) m, turned by ``rotation`` (3, 3) if there is one."""
    return np.asarray(pin.SE3(np.eye(3) if rotation is None else rotation, np.asarray(position)).homogeneous)


def draw_unshadowed(node: Any, shape: Any, material: Any, kind: Any = None) -> None:
    """Set the object of ``node`` so that it casts no shadow."""
    node.set_object((kind or shapes.Mesh)(shape, material))
    without_shadow(node)


def draw_showing_through(
    node: Any, shape: Any, lit: bool = True, through: float = HIDDEN_OPACITY, **material: Any
) -> None:
    """Draw a part that is solid, ``lit`` or not, and shines with opacity ``through`` where it is covered."""
    kind = shapes.MeshLambertMaterial if lit else shapes.MeshBasicMaterial
    draw_unshadowed(node["solid"], shape, kind(**material))
    draw_unshadowed(node["hidden"], shape, kind(**{**material, **THROUGH, "opacity": through}))


def draw_capsule(node: Any, axis: Sequence[np.ndarray], radius: float, solid: Solid) -> None:
    """Draw a capsule of ``radius`` m around a segment ``axis``, which may be a point, by ``solid``."""
    start, end = axis
    length = float(np.linalg.norm(end - start))
    solid(node["start"], shapes.Sphere(radius), pin.SE3(np.eye(3), start))
    if length > 0:
        solid(node["end"], shapes.Sphere(radius), pin.SE3(np.eye(3), end))
        upright = segment_placement(start, end) * pin.SE3(UPRIGHT, np.zeros(3))
        solid(node["side"], shapes.Cylinder(length, radius), upright)


def line_points(points: np.ndarray) -> Any:
    """Return points (k, 3) as the geometry of lines."""
    return shapes.PointsGeometry(position=points.T.astype(np.float32))


def draw_line(node: Any, points: np.ndarray, colour: int, closed: bool = False) -> None:
    """Draw a thin line through ``points`` (k, 3)."""
    points = np.vstack([points, points[:1]]) if closed else points
    draw_unshadowed(node, line_points(points), shapes.LineBasicMaterial(color=colour), shapes.Line)


def two_tone_ball(radius: float, dark: np.ndarray = DARK) -> ColouredMeshGeometry:
    """Return a ball whose eight octants are dark and bright in turn, the usual mark of a centre of mass."""
    pieces = ROUND // 4
    grid = np.linspace(0, np.pi / 2, pieces + 1)
    parts: list[MeshPart] = []
    for up, quarter in itertools.product((1, -1), range(4)):
        elevation, turn = (part.ravel() for part in np.meshgrid(grid, grid + quarter * np.pi / 2))
        level = np.cos(elevation)
        unit = np.column_stack([level * np.cos(turn), level * np.sin(turn), up * np.sin(elevation)])
        tone = dark if (up > 0) == (quarter % 2 == 0) else WHITE
        parts.append((radius * unit, unit, tone, grid_triangles(pieces, pieces)[:, ::up]))
    return ColouredMeshGeometry.joined(parts)


def two_tone_disc(radius: float, dark: np.ndarray = DARK) -> ColouredMeshGeometry:
    """Return a disc across z whose quarters are dark and bright in turn, the mark of its projection."""
    parts: list[MeshPart] = []
    for quarter in range(4):
        rim = circle(np.linspace(0, np.pi / 2, ROUND // 4 + 1) + quarter * np.pi / 2)
        points = radius * np.vstack([np.zeros(3), rim])
        parts.append((points, UPWARD, WHITE if quarter % 2 else dark, fan(len(points))))
    return ColouredMeshGeometry.joined(parts)


def bullseye(radius: float, colour: int) -> ColouredMeshGeometry:
    """Return a disc across z with a coloured centre, a bright and a coloured ring."""
    rim, ink = radius * circle(np.linspace(0, 2 * np.pi, ROUND + 1)), colour_array(colour)
    parts: list[MeshPart] = []
    for inner, outer, tone in ((0.0, 0.4, ink), (0.4, 0.72, WHITE), (0.72, 1.0, ink)):
        parts.append((np.vstack([inner * rim, outer * rim]), UPWARD, tone, grid_triangles(1, ROUND)))
    return ColouredMeshGeometry.joined(parts)


def fan(corners: int) -> np.ndarray:
    """Return the triangles (k - 2, 3) of a convex polygon of ``corners`` k."""
    return np.array([(0, i, i + 1) for i in range(1, corners - 1)])


def grid_triangles(rows: int, columns: int) -> np.ndarray:
    """Return the triangles (m, 3) of a grid of (rows + 1) x (columns + 1) points."""
    index = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    return np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


def circle(angles: np.ndarray) -> np.ndarray:
    """Return points (k, 3) of the unit circle about z."""
    return np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)])
