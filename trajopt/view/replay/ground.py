"""Ground, grid, light and sky of a replay."""

from __future__ import annotations

import itertools
import uuid
from typing import Any

import meshcat.geometry as shapes
import numpy as np
import pinocchio as pin
from pinocchio.visualize.meshcat_visualizer import Plane

from trajopt.terrain.surface import Surface
from trajopt.view.replay.commands import ViewerCommand
from trajopt.view.replay.parts import line_points

SKY_TOP, SKY_BOTTOM = [0.70, 0.79, 0.90], [0.96, 0.97, 0.98]
GROUND_COLOUR, GRID_COLOUR, GRID_STRONG = 0xDCE1E8, 0xAEB7C3, 0x808C9B
# Faces that follow each other differ a little.
GROUND_TINTS = (0xCDD4DD, 0xB9C3CF)
# Grid cells over the robot's extent, rounded down to 1, 2 or 5 times a power of ten; bold every fifth.
CELL_PART, BOLD_EVERY = 0.3, 5
# A motion is at most about so many cells long: those of one that flies off are larger.
MOST_CELLS = 250
# Ground on each side of the motion, in robot extents.
MARGIN = 8.0
# Light from the sun and around it; together a level white surface is just white.
SUN, FILL_LIGHTS = (
    0.6,
    {"AmbientLight": 0.45, "FillLight": 0.15, "PointLightNegativeX": 0.1, "PointLightPositiveX": 0.1},
)
SUN_DIRECTION = np.array([0.35, -0.5, 1.0])
# Half the side of the square with shadows, in robot extents.
SHADOW_REACH = 3.0
# The plane lies below the grid's lines by this part of the robot's extent, so that both show.
GRID_LIFT = 0.002


def draw_plane(vis: Any, box: np.ndarray, ground: Surface, size: float) -> None:
    """Draw plane and grid of the ``ground`` around ``box`` (2, 3).

    The grid's lines run along the plane's tangents, every line at a round distance from the world's origin.
    """
    span = float(np.ptp(box, axis=0).max())
    cell = _round_cell(max(CELL_PART * size, span / MOST_CELLS))
    step = BOLD_EVERY * cell
    corners = np.array(list(itertools.product(*box.T))) @ ground.tangents.T
    low = np.floor((corners.min(axis=0) - MARGIN * size) / step) * step
    high = np.ceil((corners.max(axis=0) + MARGIN * size) / step) * step
    centre = ground.frame @ np.array([*(low + high) / 2, ground.height - GRID_LIFT * size])
    plane = pin.SE3(ground.frame, centre).homogeneous
    width, depth = (float(length) for length in high - low)
    vis["ground"]["plane"].set_object(Plane(width, depth), shapes.MeshLambertMaterial(color=GROUND_COLOUR))
    vis["ground"]["plane"].set_transform(plane)
    vis["ground"]["grid"].set_object(_grid(low, high, cell, ground, bold=False))
    vis["ground"]["bold"].set_object(_grid(low, high, cell, ground, bold=True))


def sky_and_light(vis: Any, size: float) -> None:
    """A pale sky and a light with shadows, without Meshcat's own grid and axes."""
    vis["/Background"].set_property("top_color", SKY_TOP)
    vis["/Background"].set_property("bottom_color", SKY_BOTTOM)
    vis["/Grid"].set_property("visible", False)
    vis["/Axes"].set_property("visible", False)
    _lights(vis, size)


def _round_cell(length: float) -> float:
    power = 10.0 ** np.floor(np.log10(length))
    return float(power * max(step for step in (1, 2, 5) if step * power <= length * (1 + 1e-9)))


def _grid(low: np.ndarray, high: np.ndarray, cell: float, ground: Surface, bold: bool) -> Any:
    """Lines of the grid, in pieces: some drivers drop a line that ends behind the camera."""
    pieces = []
    for axis in (0, 1):
        stops = np.arange(round(low[1 - axis] / cell), round(high[1 - axis] / cell) + 1, BOLD_EVERY) * cell
        for number in range(round(low[axis] / cell), round(high[axis] / cell) + 1):
            if (number % BOLD_EVERY == 0) == bold:
                ends = np.full((2 * (len(stops) - 1), 3), ground.height)
                ends[:, axis] = number * cell
                ends[:, 1 - axis] = np.column_stack([stops[:-1], stops[1:]]).ravel()
                pieces.append(ends)
    points = line_points(np.concatenate(pieces) @ ground.frame.T)
    return shapes.LineSegments(points, shapes.LineBasicMaterial(color=GRID_STRONG if bold else GRID_COLOUR))


def _lights(vis: Any, size: float) -> None:
    """One sun that casts shadows around the origin of the viewer; Meshcat's own lights only fill."""
    for name, intensity in FILL_LIGHTS.items():
        vis[f"/Lights/{name}/<object>"].set_property("intensity", intensity)
    reach = SHADOW_REACH * size
    camera = {"uuid": str(uuid.uuid4()), "type": "OrthographicCamera", "near": 0.0, "far": 4 * reach}
    camera |= {"left": -reach, "right": reach, "top": reach, "bottom": -reach}
    shadow = {
        "bias": -0.0005,
        "normalBias": 0.01 * size,
        "radius": 2,
        "mapSize": [2048, 2048],
        "camera": camera,
    }
    place = np.eye(4)
    place[:3, 3] = 2 * reach * SUN_DIRECTION / np.linalg.norm(SUN_DIRECTION)
    sun = {"uuid": str(uuid.uuid4()), "type": "DirectionalLight", "color": 0xFFFFFF, "shadow": shadow}
    sun |= {"intensity": SUN, "matrix": place.T.ravel().tolist()}
    message = {
        "metadata": {"version": 4.5, "type": "Object"},
        "geometries": [],
        "materials": [],
        "object": sun,
    }
    vis.window.send(ViewerCommand({"type": "set_object", "path": "/Lights/Sun", "object": message}))
