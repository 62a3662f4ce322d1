"""Walls, boards, steps and handles of a replay: contact surfaces other than the terrain."""

from dataclasses import dataclass
from typing import Any

import meshcat.geometry as shapes
import numpy as np

from trajopt.motion.solution import Solution
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.surface import UP, Surface, by_plane, frame_of_normal
from trajopt.view.replay.parts import UPRIGHT, draw_unshadowed, placed
from trajopt.view.replay.runs import DrawnSolution

WALL_COLOUR, HANDLE_COLOUR = 0xB98A4E, 0x1E8C7E
WALL_OPACITY, HANDLE_OPACITY = 0.45, 0.8
# Over the robot's extent: a patch reaches this far beyond the contacts on it; radius of a handle; thickness.
PATCH_MARGIN, HANDLE_RADIUS, THICKNESS = 0.15, 0.06, 0.01
# Largest distance of a foot's or hand's visual beyond its contact frame, over the robot's extent.
DEEPEST_FOOT = 0.15
# Frames at which the lowest points of the links in contact are measured.
MEASURED_STANCES = 20
# Normals flatter than 45 degrees get edges along the world's x and y, the others a horizontal edge.
STEEPEST_FLOOR = np.sqrt(0.5)


@dataclass(frozen=True, kw_only=True, eq=False)
class Touch:
    """A contact, by its column, on a surface at some frames ``rows`` (n,), true where it touches."""

    surface: Surface
    contact: int
    rows: np.ndarray


def plane_of(solution: Solution) -> Surface:
    """Return the ground's plane: for uneven ground a level one, used for the camera.

    Level at height 0 where the solution has no terrain.
    """
    terrain = solution.description.ground
    if isinstance(terrain, PiecewiseTerrain):
        return terrain.surface
    return terrain if isinstance(terrain, Surface) else Surface(point=np.zeros(3), normal=np.array(UP))


def depth_below_contacts(standing: list[Touch], run: DrawnSolution, size: float) -> float:
    """Return how far drawn feet reach below their contact frames on uneven ground, m."""
    drops = [
        _believed(_reach_below(run, (int(row), touch.contact), np.array(UP)), size)
        for touch in standing
        for row in np.flatnonzero(np.diff(touch.rows.astype(int), prepend=0) == 1)
    ]
    return float(np.median(drops)) if drops else 0.0


def touches_of(run: DrawnSolution) -> tuple[list[Touch], list[Touch]]:
    """Return the contacts with the terrain, and those with other surfaces by phase and contact.

    A contact whose own surface is the terrain's plane touches the terrain, unless that surface is bilateral.
    """
    solution, motion = run.solution, run.motion
    terrain, on_terrain, elsewhere = plane_of(solution), motion.active.copy(), []
    for phase, contact, surface in solution.description.separate_surfaces:
        rows = motion.active[:, contact] & (motion.phase == phase)
        if rows.any() and (surface.bilateral or not surface.same_plane(terrain)):
            elsewhere.append(Touch(surface=surface, contact=contact, rows=rows))
            on_terrain[rows, contact] = False
    standing = [
        Touch(surface=terrain, contact=contact, rows=rows)
        for contact, rows in enumerate(on_terrain.T)
        if rows.any()
    ]
    return standing, elsewhere


def drawn_plane(touches: list[Touch], run: DrawnSolution, size: float) -> Surface:
    """Return the plane that the drawn feet of ``touches`` (one or more, on one plane) stand on.

    Contact frames may lie inside the foot (the centre of a rounded tip): the plane is drawn deeper
    along its normal by the typical distance from the frame to the lowest point of its link in contact.
    """
    surface = touches[0].surface
    normal = surface.normal
    stances = [(row, touch.contact) for touch in touches for row in np.flatnonzero(touch.rows).tolist()]
    heights = [float(normal @ run.motion.feet[stance]) for stance in stances]
    measured = np.unique(np.linspace(0, len(stances) - 1, MEASURED_STANCES).astype(int))
    drop = float(np.median([_reach_below(run, stances[number], normal) for number in measured]))
    height = min(heights) - _believed(drop, size)
    return Surface(point=surface.point + (height - surface.height) * normal, normal=normal)


def _reach_below(run: DrawnSolution, stance: tuple[int, int], normal: np.ndarray) -> float:
    """How far a drawn link reaches below its contact frame, m; ``stance``: row of the motion, contact."""
    row, contact = stance
    model, motion = run.solution.model, run.motion
    joint = model.frames[model.getFrameId(run.solution.contact_frames[contact])].parentJoint
    turn, place = motion.joints[row, joint, :3, :3], motion.joints[row, joint, :3, 3]
    points = np.concatenate(run.robot.points.get(joint, [np.zeros((1, 3))]))
    lowest = float((points @ (turn.T @ normal)).min() + normal @ place)
    return float(normal @ motion.feet[stance]) - lowest


def _believed(drop: float, size: float) -> float:
    """Depth of drawn feet below their contacts, 0 if it is implausibly large."""
    return drop if 0 < drop < DEEPEST_FOOT * size else 0.0


def draw_surfaces(run: DrawnSolution, touches: list[Touch], size: float) -> np.ndarray:
    """Draw each plane as a patch around its contacts, and a handle where a contact is held.

    Returns the corners of the patches and the positions of the handles (k, 3), m, for the camera.
    """
    places, motion, vis = [np.zeros((0, 3))], run.motion, run.node["surfaces"]
    unilateral = [touch for touch in touches if not touch.surface.bilateral]
    for number, group in enumerate(by_plane(unilateral, lambda touch: touch.surface)):
        plane = drawn_plane(group, run, size)
        points = np.concatenate([motion.feet[touch.rows, touch.contact] for touch in group])
        places.append(_patch(vis[f"patch{number}"], plane, points, size))
    handles: list[np.ndarray] = []
    for touch in touches:
        if touch.surface.bilateral:
            place = motion.feet[touch.rows, touch.contact].mean(axis=0)
            if all(np.linalg.norm(place - other) > HANDLE_RADIUS * size for other in handles):
                _handle(vis[f"handle{len(handles)}"], touch.surface, place, size)
                handles.append(place)
    return np.concatenate([*places, np.reshape(handles, (-1, 3))])


def _patch(node: Any, plane: Surface, points: np.ndarray, size: float) -> np.ndarray:
    """Draw a translucent board with its front in the plane, around ``points`` (k, 3); returns its corners."""
    turn = _patch_frame(plane.normal)
    local = (points - plane.point) @ turn[:, :2]
    low, high = local.min(axis=0) - PATCH_MARGIN * size, local.max(axis=0) + PATCH_MARGIN * size
    thickness = THICKNESS * size
    centre = plane.point + turn @ np.array([*(low + high) / 2, -thickness / 2])
    material = shapes.MeshLambertMaterial(color=WALL_COLOUR, opacity=WALL_OPACITY)
    draw_unshadowed(node, shapes.Box([*(high - low).tolist(), thickness]), material)
    node.set_transform(placed(centre, turn))
    corners = np.array([[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])])
    return np.asarray(plane.point + corners @ turn[:, :2].T)


def _patch_frame(normal: np.ndarray) -> np.ndarray:
    """Columns edge, edge, normal (3, 3), right-handed; a wall's first edge is horizontal."""
    if abs(normal[2]) > STEEPEST_FLOOR:
        return frame_of_normal(normal)
    edge = np.cross(UP, normal)
    edge /= np.linalg.norm(edge)
    return np.column_stack([edge, np.cross(normal, edge), normal])


def _handle(node: Any, surface: Surface, place: np.ndarray, size: float) -> None:
    """Draw a disc with its front at the grasped contact."""
    thickness = THICKNESS * size
    turn = frame_of_normal(surface.normal) @ UPRIGHT
    material = shapes.MeshLambertMaterial(color=HANDLE_COLOUR, opacity=HANDLE_OPACITY)
    draw_unshadowed(node, shapes.Cylinder(thickness, HANDLE_RADIUS * size), material)
    node.set_transform(placed(place - thickness / 2 * surface.normal, turn))
