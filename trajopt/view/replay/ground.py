"""The ground of a replay: planes, solid blocks or a smooth surface below the drawn feet; light and sky."""

import uuid
from dataclasses import dataclass, replace
from typing import Any

import meshcat.geometry as shapes
import numpy as np
from pinocchio.visualize.meshcat_visualizer import Plane

from trajopt.collision.shapes import box_corners
from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.terrain.bodies import solids_within
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.smooth import SmoothTerrain
from trajopt.terrain.surface import Surface
from trajopt.view.replay import parts
from trajopt.view.replay.commands import ViewerCommand
from trajopt.view.replay.runs import GAP, DrawnSolution
from trajopt.view.replay.surfaces import Touch, depth_below_contacts, drawn_plane, plane_of, touches_of

SKY_TOP, SKY_BOTTOM = [0.70, 0.79, 0.90], [0.96, 0.97, 0.98]
GROUND_COLOUR, GRID_COLOUR = 0xDCE1E8, 0xAEB7C3
# Grid cells over the robot's extent, rounded down to 1, 2 or 5 times a power of ten; bold every fifth.
CELL_PART, BOLD_EVERY = 0.3, 5
# Approximate limit of cells along a motion: a motion that flies off gets larger cells.
MOST_CELLS = 250
# Ground on each side of the motion, in robot extents.
PLANE_MARGIN = 8.0
# Light from the sun and from the sky: together they make a level white surface just white.
SUN = 0.6
FILL_LIGHTS = (
    ("AmbientLight", 0.45),
    ("FillLight", 0.15),
    ("PointLightNegativeX", 0.1),
    ("PointLightPositiveX", 0.1),
)
SUN_DIRECTION = np.array([0.35, -0.5, 1.0])
# A robot hangs if it reaches this far below its base, over its extent.
HANGING = 0.1
# Half the side of the square with shadows, in robot extents.
SHADOW_REACH = 3.0
# The plane lies below the grid's lines by this fraction of the robot's extent, so that both are visible.
GRID_LIFT = 0.002
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


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnGround:
    """The ground under one solution.

    Args:
        plane: of the terrain; a level one for uneven ground.
        seen: the plane as drawn.
        drop: depth of the drawn ground below the contacts, m.
        elsewhere: contacts with surfaces other than the terrain.
        uneven: the terrain, if it is not a plane.
    """

    plane: Surface
    seen: Surface
    drop: float
    elsewhere: list[Touch]
    uneven: PiecewiseTerrain | SmoothTerrain | None


def grounds_of(runs: list[DrawnSolution], size: float) -> list[DrawnGround]:
    """The ground under each solution, in its own world; ``size`` m is the robots' extent.

    A plane on which several stand is drawn at the height of the smallest feet: larger feet sink into it.
    """
    grounds = [_ground_of(run, size) for run in runs]
    plane = grounds[0].plane
    shared = [g for g in grounds if g.uneven is None and g.drop > 0 and g.plane.same_plane(plane)]
    if not shared:
        return grounds
    highest = min(shared, key=lambda ground: ground.drop)
    return [replace(g, seen=highest.seen, drop=highest.drop) if g in shared else g for g in grounds]


def _ground_of(run: DrawnSolution, size: float) -> DrawnGround:
    standing, elsewhere = touches_of(run)
    terrain, plane = run.solution.description.ground, plane_of(run.solution)
    if isinstance(terrain, PiecewiseTerrain | SmoothTerrain):
        drop = depth_below_contacts(standing, run, size)
        return DrawnGround(plane=plane, seen=plane, drop=drop, elsewhere=elsewhere, uneven=terrain)
    seen = drawn_plane(standing, run, size) if standing else _floor(run, plane)
    drop = max(plane.height - seen.height, 0.0) if standing else 0.0
    return DrawnGround(plane=plane, seen=seen, drop=drop, elsewhere=elsewhere, uneven=None)


def _floor(run: DrawnSolution, plane: Surface) -> Surface:
    """The plane under a robot without contacts; for a fixed base it is moved to where the base ends.

    An arm stands on that floor. Below a hanging robot, such as a pendulum, it is as low as the robot reaches.
    """
    if BASE_JOINT[base_of(run.solution.model)] or not run.cloud.size:
        return plane
    foot = [part for part in run.robot.points.get(0, []) if part.size]  # points of the fixed links, world
    low = min((float((part @ plane.normal).min()) for part in foot), default=0.0)
    reached = float((run.cloud @ plane.normal).min())
    height = reached if reached < low - HANGING * run.size else low
    return Surface(point=plane.point + (height - plane.height) * plane.normal, normal=plane.normal)


def draw_grounds(
    vis: Any, runs: list[DrawnSolution], grounds: list[DrawnGround], box: np.ndarray, size: float
) -> Surface:
    """Draw sky, light and each different ground; returns the first solution's plane.

    ``box`` (2, 3) m encloses everything. Runs on planes share the first plane; uneven ground of runs that are
    moved aside moves with them, and extends at most half way to the next run.
    """
    _draw_sky_and_light(vis, size)
    aside, drawn = any(run.shift.any() for run in runs), []
    for run, ground in zip(runs, grounds, strict=True):
        described = ground.uneven and (ground.uneven.describe(), run.shift.tolist())
        if described in drawn:
            continue
        drawn.append(described)
        if ground.uneven is None:
            _draw_plane(vis["ground"], box, ground.seen, size)
            continue
        margin = np.full(2, MARGIN * size)
        if aside:
            margin[runs[-1].shift[:2] != 0] = GAP * size / 2
        extent = np.array([run.cloud.min(axis=0), run.cloud.max(axis=0)]) if aside else box
        area = np.array([extent[0, :2] - margin, extent[1, :2] + margin])
        node = (run.node if aside else vis)["ground"]
        if isinstance(ground.uneven, PiecewiseTerrain):
            _draw_faces(node, ground.uneven, area, ground.drop, size)
        else:
            _draw_smooth(node, ground.uneven, area, ground.drop, size)
    return grounds[0].seen


def _draw_plane(node: Any, box: np.ndarray, ground: Surface, size: float) -> None:
    """Draw plane and grid of the ``ground`` around ``box`` (2, 3).

    The grid's lines run along the plane's tangents, every line at a round distance from the world's origin.
    """
    cell = grid_cell(box, size)
    step = BOLD_EVERY * cell
    corners = box_corners(*box) @ ground.tangents.T
    low = np.floor((corners.min(axis=0) - PLANE_MARGIN * size) / step) * step
    high = np.ceil((corners.max(axis=0) + PLANE_MARGIN * size) / step) * step
    centre = ground.frame @ np.array([*(low + high) / 2, ground.height - GRID_LIFT * size])
    width, depth = (float(side) for side in high - low)
    node["plane"].set_object(Plane(width, depth), shapes.MeshLambertMaterial(color=GROUND_COLOUR))
    node["plane"].set_transform(parts.placed(centre, ground.frame))
    node["grid"].set_object(_grid(low, high, cell, ground, bold=False))
    node["bold"].set_object(_grid(low, high, cell, ground, bold=True))


def grid_cell(box: np.ndarray, size: float) -> float:
    """Side of a cell of the grid around a ``box`` (2, 3) for robots of this ``size``, all in m."""
    length = max(CELL_PART * size, float(np.ptp(box, axis=0).max()) / MOST_CELLS)
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
    points = parts.line_points(np.concatenate(pieces) @ ground.frame.T)
    return shapes.LineSegments(points, shapes.LineBasicMaterial(color=GRID_STRONG if bold else GRID_COLOUR))


def _draw_sky_and_light(vis: Any, size: float) -> None:
    """Draw a pale sky, and a sun with shadows around the viewer's origin; Meshcat's lights only fill."""
    vis["/Background"].set_property("top_color", SKY_TOP)
    vis["/Background"].set_property("bottom_color", SKY_BOTTOM)
    vis["/Grid"].set_property("visible", False)
    vis["/Axes"].set_property("visible", False)
    for name, intensity in FILL_LIGHTS:
        vis[f"/Lights/{name}/<object>"].set_property("intensity", intensity)
    reach = SHADOW_REACH * size
    camera = {"uuid": str(uuid.uuid4()), "type": "OrthographicCamera", "near": 0.0, "far": 4 * reach}
    camera |= {"left": -reach, "right": reach, "top": reach, "bottom": -reach}
    shadow = {"bias": -0.0005, "normalBias": 0.01 * size, "radius": 2, "mapSize": [2048, 2048]}
    place = parts.placed(2 * reach * SUN_DIRECTION / np.linalg.norm(SUN_DIRECTION))
    sun = {"uuid": str(uuid.uuid4()), "type": "DirectionalLight", "color": 0xFFFFFF}
    sun |= {"shadow": shadow | {"camera": camera}, "intensity": SUN, "matrix": place.T.ravel().tolist()}
    scene = {"metadata": {"version": 4.5, "type": "Object"}, "geometries": [], "materials": [], "object": sun}
    vis.window.send(ViewerCommand({"type": "set_object", "path": "/Lights/Sun", "object": scene}))


def _draw_faces(node: Any, terrain: PiecewiseTerrain, area: np.ndarray, drop: float, size: float) -> None:
    planes: list[Surface] = []
    material = shapes.MeshLambertMaterial(vertexColors=True)
    for number, (face, solid) in enumerate(solids_within(terrain, area[0], area[1], DEPTH * size)):
        plane, (top, under) = face.surface, np.split(solid - drop * parts.UPWARD, 2)
        place = next((i for i, other in enumerate(planes) if plane.same_plane(other)), len(planes))
        if place == len(planes):
            planes.append(plane)
        block = _block(top, under, GROUND_TINTS[place % len(GROUND_TINTS)])
        node[f"face{number}"].set_object(block, material)
        outline = parts.line_points(np.vstack([top, top[:1]]) + LINE_LIFT * size * parts.UPWARD)
        edge = shapes.Line(outline, shapes.LineBasicMaterial(color=GRID_STRONG))
        node[f"edge{number}"].set_object(edge)


def _block(top: np.ndarray, under: np.ndarray, colour: int) -> parts.ColouredMeshGeometry:
    """A prism under a convex polygon (k, 3): its top in ``colour``, darker walls down to ``under`` (k, 3)."""
    tone = parts.colour_array(colour)
    faces: list[parts.MeshPart] = [(top, _normal(top), tone, parts.fan(len(top)))]
    for i in range(len(top)):  # walls do not share corners, so that each is shaded flat
        j = (i + 1) % len(top)
        wall = np.array([under[i], under[j], top[j], top[i]])
        faces.append((wall, _normal(wall), WALL_SHADE * tone, parts.fan(4)))
    return parts.ColouredMeshGeometry.joined(faces)


def _normal(polygon: np.ndarray) -> np.ndarray:
    """The unit normal (3,) of a polygon's plane by Newell's sum; zero for a polygon without area."""
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
    mesh = shapes.TriangularMeshGeometry(grid.reshape(-1, 3), parts.grid_triangles(len(x) - 1, len(y) - 1))
    node["smooth"].set_object(mesh, shapes.MeshLambertMaterial(color=SMOOTH_COLOUR))
    lifted = grid + LINE_LIFT * size * parts.UPWARD
    lines = [np.repeat(row, 2, axis=0)[1:-1] for row in (*lifted[::4], *lifted.transpose(1, 0, 2)[::4])]
    points = parts.line_points(np.concatenate(lines))
    node["grid"].set_object(shapes.LineSegments(points, shapes.LineBasicMaterial(color=GRID_STRONG)))
