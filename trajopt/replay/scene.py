"""The scene of a replay as Meshcat commands: robot, ground, force arrows, trails, camera, animation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import meshcat
import meshcat.geometry as shapes
import numpy as np
import pinocchio as pin

from trajopt.certify.touched import terrain_of
from trajopt.replay.arrows import WEIGHT_ARROW, draw_arrows
from trajopt.replay.commands import Command, Recorder, Tracks, without_shadow
from trajopt.replay.ground import light_and_ground
from trajopt.replay.motion import Motion
from trajopt.replay.obstacles import draw_obstacles
from trajopt.replay.robot import DrawnRobot, draw_robot, joint_path, tip_frames
from trajopt.replay.surfaces import curved_drop, draw_surfaces, plane_of, seen_plane, touches_of
from trajopt.replay.terrain import draw_terrain
from trajopt.robot_building import BASE_JOINT, base_of
from trajopt.solution import Solution
from trajopt.surface import Surface
from trajopt.terrain import PiecewiseTerrain, SmoothTerrain

TRAIL_COLOURS = (0x1F77B4, 0x2CA02C, 0x9467BD, 0xC77700)
# Vertical field of view in degrees: little perspective.
FIELD_OF_VIEW = 35.0
# Direction from the robot to the camera: from its right and ahead, slightly above.
CAMERA_DIRECTION = np.array([0.62, -1.0, 0.42])
# The camera travels with the base if the motion is longer than this many times the robot.
FOLLOW_FROM = 3.0
# Frames at which the extent of the motion is measured.
MEASURED_FRAMES = 12


@dataclass(frozen=True)
class Scene:
    """Commands in order; ``note`` if the robot is not drawn in full; ``weight_arrow`` in m."""

    commands: list[Command]
    note: str
    weight_arrow: float


def build_scene(solution: Solution, motion: Motion) -> Scene:
    """Return everything that a Meshcat viewer has to be told to show ``motion``."""
    recorder = Recorder()
    vis = meshcat.Visualizer(window=recorder)
    tracks = Tracks(motion.n_frames, motion.frame_rate)
    robot = draw_robot(vis, solution)
    for joint in range(1, solution.model.njoints):
        _animate_placement(tracks, vis[joint_path(solution.model, joint)], motion.joints[:, joint])
    cloud = _cloud(robot, motion)
    size = max(float(np.ptp(cloud[0], axis=0).max()), 1e-3)
    standing, elsewhere = touches_of(solution, motion)
    terrain, ground = terrain_of(solution.meta.get("terrain")), plane_of(solution)
    uneven = isinstance(terrain, PiecewiseTerrain | SmoothTerrain)
    if standing and not uneven:
        ground = seen_plane(standing, solution, motion, robot, size)
    places = draw_surfaces(vis["surfaces"], elsewhere, solution, motion, robot, size)
    obstacles = draw_obstacles(vis["obstacles"], solution)
    cloud = np.concatenate([cloud.reshape(-1, 3), places, obstacles])
    box = np.array([cloud.min(axis=0), cloud.max(axis=0)])
    if isinstance(terrain, PiecewiseTerrain | SmoothTerrain):
        draw_terrain(vis, terrain, box, curved_drop(standing, solution, motion, robot, size), size)
    else:
        light_and_ground(vis, box, ground, size)
    draw_arrows(vis, tracks, solution, motion, size)
    _trails(vis["trails"], solution, motion)
    carrier = BASE_JOINT[base_of(solution.model)] or min(1, solution.model.njoints - 1)
    _camera(vis, tracks, motion, carrier, box, ground, size)
    recorder.commands.append(tracks.command())
    return Scene(recorder.commands, robot.note, WEIGHT_ARROW * size)


def _animate_placement(tracks: Tracks, node: Any, placements: np.ndarray) -> None:
    quaternions = [pin.Quaternion(matrix[:3, :3]).coeffs() for matrix in placements]
    tracks.add(node, "position", "vector3", placements[:, :3, 3])
    tracks.add(node, "quaternion", "quaternion", np.array(quaternions))


def _cloud(robot: DrawnRobot, motion: Motion) -> np.ndarray:
    """World points (frames, k, 3) of the drawn robot at a few frames, the first included."""
    rows = np.unique(np.linspace(0, motion.n_frames - 1, MEASURED_FRAMES).astype(int))
    parts = []
    for joint, points in robot.points.items():
        placement = motion.joints[rows, joint]
        local = np.concatenate(points)
        parts.append(local @ placement[:, :3, :3].transpose(0, 2, 1) + placement[:, None, :3, 3])
    return np.concatenate(parts, axis=1)


def _trails(node: Any, solution: Solution, motion: Motion) -> None:
    """Draw the path of each contact frame as a thin line; of each tip if there are no contacts."""
    names, paths = list(solution.contact_frames), motion.feet
    if not names:
        frames = tip_frames(solution.model)
        names = [solution.model.frames[frame].name for frame in frames]
        paths = _frame_paths(solution.model, motion, frames)
    for number, name in enumerate(names):
        points = shapes.PointsGeometry(position=paths[:, number].T.astype(np.float32))
        colour = TRAIL_COLOURS[number % len(TRAIL_COLOURS)]
        trail = node[name.replace("/", "_")]
        trail.set_object(shapes.Line(points, shapes.LineBasicMaterial(color=colour)))
        without_shadow(trail)


def _frame_paths(model: pin.Model, motion: Motion, frames: list[int]) -> np.ndarray:
    paths = np.empty((motion.n_frames, len(frames), 3))
    for column, frame in enumerate(frames):
        joint = model.frames[frame].parentJoint
        local = np.append(model.frames[frame].placement.translation, 1.0)
        paths[:, column] = (motion.joints[:, joint] @ local)[:, :3]
    return paths


def _camera(
    vis: Any, tracks: Tracks, motion: Motion, carrier: int, box: np.ndarray, ground: Surface, size: float
) -> None:
    """Frame the whole motion; if it is long, travel along the ground with the base, on the joint ``carrier``.

    Meshcat's camera always looks at the origin of the viewer: the world is moved there instead.
    """
    base = motion.joints[:, carrier, :3, 3]
    travel = (base - base[0]) @ ground.tangents.T
    middle = box.mean(axis=0)
    below = middle - ground.distance(middle) * ground.normal
    low, high = np.minimum(box[0], below), np.maximum(box[1], below)
    follows = float(np.ptp(travel, axis=0).max()) > FOLLOW_FROM * size
    if follows:
        low, high = base[0] - 0.75 * size, base[0] + 0.75 * size
    target = (low + high) / 2
    distance = float(np.linalg.norm(high - low)) / 2 / np.sin(np.radians(FIELD_OF_VIEW) / 2)
    offset = distance * CAMERA_DIRECTION / np.linalg.norm(CAMERA_DIRECTION)
    lens = vis["/Cameras/default/rotated/<object>"]
    lens.set_property("fov", FIELD_OF_VIEW)
    lens.set_property("position", [float(offset[0]), float(offset[2]), float(-offset[1])])  # y is up there
    vis.set_transform(pin.SE3(np.eye(3), -target).homogeneous)
    if follows:
        tracks.add(vis, "position", "vector3", -target - travel @ ground.tangents)
