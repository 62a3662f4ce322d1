"""Parts that several drawings share: coloured triangles, what shines through, two-tone marks, lines."""

from __future__ import annotations

import itertools
from typing import Any

import meshcat.geometry as shapes
import numpy as np

from trajopt.view.replay.collada import ColouredMesh
from trajopt.view.replay.commands import without_shadow

# What the robot hides shines through it this much.
HIDDEN_OPACITY = 0.55
THROUGH = {"opacity": HIDDEN_OPACITY, "transparent": True, "depthTest": False, "depthWrite": False, "side": 0}
# Pieces of a full circle.
ROUND = 32
DARK, BRIGHT = np.array([0.10, 0.12, 0.15]), np.array([1.0, 1.0, 1.0])


class Triangles(shapes.Geometry):
    """A coloured mesh with its own normals, which Meshcat's mesh geometry does not carry."""

    def __init__(self, mesh: ColouredMesh) -> None:
        super().__init__()
        self._mesh = mesh

    def lower(self, object_data: Any) -> dict[str, Any]:
        """Return the geometry in the JSON of three.js."""
        mesh = self._mesh
        colours = shapes.pack_numpy_array(np.round(255 * mesh.colours).astype(np.uint8).T)
        attributes = {
            "position": shapes.pack_numpy_array(mesh.vertices.T),
            "normal": shapes.pack_numpy_array(mesh.normals.T),
            "color": {**colours, "normalized": True},
        }
        index = shapes.pack_numpy_array(mesh.triangles.T)
        return {
            "uuid": self.uuid,
            "type": "BufferGeometry",
            "data": {"attributes": attributes, "index": index},
        }


def colour_array(colour: int) -> np.ndarray:
    """Red, green, blue (3,) from 0 to 1 of a colour written as 0xRRGGBB."""
    return np.array([colour >> 16 & 255, colour >> 8 & 255, colour & 255]) / 255


def quiet(node: Any, shape: Any, material: Any, kind: Any = None) -> None:
    """Set the object of ``node`` so that it casts no shadow."""
    node.set_object((kind or shapes.Mesh)(shape, material))
    without_shadow(node)


def shining(
    node: Any, shape: Any, lit: bool = True, through: float = HIDDEN_OPACITY, **material: Any
) -> None:
    """Draw a part solid, and with the opacity ``through`` where something hides it; ``lit``: shaded."""
    kind = shapes.MeshLambertMaterial if lit else shapes.MeshBasicMaterial
    quiet(node["solid"], shape, kind(**material))
    quiet(node["hidden"], shape, kind(**{**material, **THROUGH, "opacity": through}))


def line(node: Any, points: np.ndarray, colour: int, closed: bool = False) -> None:
    """A thin line through ``points`` (k, 3)."""
    points = np.vstack([points, points[:1]]) if closed else points
    geometry = shapes.PointsGeometry(position=points.T.astype(np.float32))
    quiet(node, geometry, shapes.LineBasicMaterial(color=colour), shapes.Line)


def two_tone_ball(radius: float, dark: np.ndarray = DARK) -> Triangles:
    """A ball whose eight octants are dark and bright in turn, the usual mark of a centre of mass."""
    pieces = ROUND // 4
    grid = np.linspace(0, np.pi / 2, pieces + 1)
    points: list[np.ndarray] = []
    colours, triangles = [], []
    for up, quarter in itertools.product((1, -1), range(4)):
        elevation, turn = (part.ravel() for part in np.meshgrid(grid, grid + quarter * np.pi / 2))
        level = np.cos(elevation)
        start = sum(len(part) for part in points)
        points.append(np.column_stack([level * np.cos(turn), level * np.sin(turn), up * np.sin(elevation)]))
        colours.append(np.tile(dark if (up > 0) == (quarter % 2 == 0) else BRIGHT, (len(turn), 1)))
        triangles.append(_cells(pieces, start)[:, ::up])
    unit = np.concatenate(points)
    return _triangles(radius * unit, unit, np.concatenate(colours), np.concatenate(triangles))


def two_tone_disc(radius: float, dark: np.ndarray = DARK) -> Triangles:
    """A disc across z whose quarters are dark and bright in turn: where that centre is projected to."""
    points: list[np.ndarray] = []
    colours, triangles = [], []
    for quarter in range(4):
        turn = np.linspace(0, np.pi / 2, ROUND // 4 + 1) + quarter * np.pi / 2
        start = sum(len(part) for part in points)
        rim = np.column_stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)])
        points.append(np.vstack([np.zeros(3), rim]))
        colours.append(np.tile(BRIGHT if quarter % 2 else dark, (len(rim) + 1, 1)))
        triangles.append(start + np.array([(0, i, i + 1) for i in range(1, len(rim))]))
    flat = np.concatenate(points)
    up = np.tile([0.0, 0.0, 1.0], (len(flat), 1))
    return _triangles(radius * flat, up, np.concatenate(colours), np.concatenate(triangles))


def _cells(pieces: int, start: int) -> np.ndarray:
    """Triangles (m, 3) of a grid of (pieces + 1) squared points from index ``start``."""
    index = start + np.arange((pieces + 1) ** 2).reshape(pieces + 1, pieces + 1)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    return np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


def _triangles(points: np.ndarray, normals: np.ndarray, colours: np.ndarray, index: np.ndarray) -> Triangles:
    return Triangles(
        ColouredMesh(
            vertices=points.astype(np.float32),
            normals=normals.astype(np.float32),
            colours=colours.astype(np.float32),
            triangles=index.astype(np.uint32),
        )
    )


def bullseye(radius: float, colour: int) -> Triangles:
    """A disc across z of a coloured point, a bright ring and a coloured ring: the zero-moment point."""
    turn = np.linspace(0, 2 * np.pi, ROUND + 1)
    rim = np.column_stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)])
    points: list[np.ndarray] = []
    ink, colours, triangles = colour_array(colour), [], []
    for inner, outer, tone in ((0.0, 0.4, ink), (0.4, 0.72, BRIGHT), (0.72, 1.0, ink)):
        start = sum(len(part) for part in points)
        points.append(np.vstack([inner * rim, outer * rim]))
        colours.append(np.tile(tone, (2 * len(rim), 1)))
        a = start + np.arange(ROUND)
        b = a + len(rim)
        triangles.append(np.concatenate([np.column_stack([a, b, b + 1]), np.column_stack([a, b + 1, a + 1])]))
    flat = np.concatenate(points)
    up = np.tile([0.0, 0.0, 1.0], (len(flat), 1))
    return _triangles(radius * flat, up, np.concatenate(colours), np.concatenate(triangles))
