"""The scene of a replay as Meshcat commands: robots, ground, force arrows, trails, camera, animation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import meshcat
import meshcat.geometry as shapes
import numpy as np
import pinocchio as pin

from trajopt.certify.touched import terrain_of
from trajopt.replay.arrows import WEIGHT_ARROW, draw_arrows
from trajopt.replay.camera import initial_camera
from trajopt.replay.commands import Command, Recorder, Tracks, without_shadow
from trajopt.replay.ground import light_and_ground
from trajopt.replay.layers import layers_of
from trajopt.replay.motion import Motion
from trajopt.replay.obstacles import draw_obstacles
from trajopt.replay.robot import joint_path, tip_frames
from trajopt.replay.runs import Run, drawn_runs, travels
from trajopt.replay.surfaces import curved_drop, draw_surfaces, plane_of, seen_plane, touches_of
from trajopt.replay.terrain import draw_terrain
from trajopt.solution import Solution
from trajopt.surface import Surface
from trajopt.terrain import PiecewiseTerrain, SmoothTerrain

TRAIL_COLOURS = (0x1F77B4, 0x2CA02C, 0x9467BD, 0xC77700)
PREFIX = "/meshcat/"


@dataclass(frozen=True)
class Scene:
    """Commands in order; ``note`` if a robot is not drawn in full; ``weight_arrow`` in m.

    facts: what a page tells of the scene, JSON-able: ``start`` (s of the solution), ``speed``, ``duration``
    (s of playback), ``phases`` [{name, start, end}] of the first solution, s, ``layers`` [{name, label,
    colour, paths, visible}], ``runs`` [{label, colour, root, base}] with places in the scene tree, ``size``
    (m, the largest robot's extent), ``box`` [[low], [high]] (m, world) around all motions and what they
    touch, ``travels``: whether a base goes so far that a camera should follow it.
    """

    commands: list[Command]
    note: str
    weight_arrow: float
    facts: dict[str, Any] = field(default_factory=dict)


def build_scene(
    solutions: Sequence[Solution],
    motions: Sequence[Motion],
    layout: str = "overlaid",
    labels: Sequence[str] | None = None,
) -> Scene:
    """Return everything that a Meshcat viewer has to be told to show ``motions``, of the same frames.

    Of several solutions the later ones are tinted and laid over the first (``layout`` "overlaid") or moved
    aside ("side-by-side"); ``labels`` name them. Raises `InputError` for a layout or labels that do not fit.
    """
    recorder = Recorder()
    vis = meshcat.Visualizer(window=recorder)
    tracks = Tracks(motions[0].n_frames, motions[0].frame_rate)
    runs = drawn_runs(vis, solutions, motions, layout, labels)
    size = max(run.size for run in runs)
    points = [_draw_run(tracks, run, size) for run in runs]
    cloud = np.concatenate(points)
    box = np.array([cloud.min(axis=0), cloud.max(axis=0)])
    ground = _draw_ground(vis, runs, box, size)
    follows = travels(runs[0], ground.tangents)
    initial_camera(vis, tracks, runs[0].base, box, ground, size, follows)
    recorder.commands.append(tracks.command())
    notes = list(dict.fromkeys(run.robot.note for run in runs if run.robot.note))
    facts = _facts(runs, layers_of(runs, _drawn(recorder)), box, size, follows)
    return Scene(recorder.commands, "; ".join(notes), WEIGHT_ARROW * size, facts)


def _draw_run(tracks: Tracks, run: Run, size: float) -> np.ndarray:
    """Draw what belongs to one solution; returns points (k, 3) of the scene's world that it takes up, m."""
    solution, motion, node = run.solution, run.motion, run.node
    if run.shift.any():
        node.set_transform(pin.SE3(np.eye(3), run.shift).homogeneous)
    for joint in range(1, solution.model.njoints):
        _animate_placement(tracks, node[joint_path(solution.model, joint)], motion.joints[:, joint])
    _, elsewhere = touches_of(solution, motion)
    places = draw_surfaces(node["surfaces"], elsewhere, solution, motion, run.robot, size)
    obstacles = draw_obstacles(node["obstacles"], solution)
    draw_arrows(node, tracks, solution, motion, size)
    _trails(node["trails"], solution, motion)
    return np.asarray(np.concatenate([run.cloud, places, obstacles]) + run.shift)


def _draw_ground(vis: Any, runs: list[Run], box: np.ndarray, size: float) -> Surface:
    """Draw the first solution's ground, with sky and light; returns its plane."""
    run = runs[0]
    standing, _ = touches_of(run.solution, run.motion)
    terrain = terrain_of(run.solution.meta.get("terrain"))
    ground = plane_of(run.solution)
    if isinstance(terrain, PiecewiseTerrain | SmoothTerrain):
        drop = curved_drop(standing, run.solution, run.motion, run.robot, size)
        draw_terrain(vis, terrain, box, drop, size)
        return ground
    if standing:
        ground = seen_plane(standing, run.solution, run.motion, run.robot, size)
    light_and_ground(vis, box, ground, size)
    return ground


def _drawn(recorder: Recorder) -> list[str]:
    """Scene tree paths of all objects."""
    messages = [command.message for command in recorder.commands]
    return [m["path"].removeprefix(PREFIX) for m in messages if m["type"] == "set_object"]


def _facts(
    runs: list[Run], layers: list[dict[str, Any]], box: np.ndarray, size: float, follows: bool
) -> dict[str, Any]:
    motion = runs[0].motion
    return {
        "start": float(motion.t[0]),
        "speed": motion.speed,
        "duration": (motion.n_frames - 1) / motion.frame_rate,
        "phases": _phases(runs[0].solution),
        "layers": layers,
        "runs": [
            {"label": run.label, "colour": f"#{run.colour:06x}", "root": run.root, "base": run.base_path}
            for run in runs
        ],
        "size": size,
        "box": box.tolist(),
        "travels": follows,
    }


def _phases(solution: Solution) -> list[dict[str, Any]]:
    """Name, start and end (s) of every phase; numbered where the solution has no names."""
    names = solution.meta.get("phase_names") or []
    found = []
    for rows in solution.phases:
        index = int(solution.phase[rows.start])
        name = str(names[index]) if index < len(names) else f"phase {index + 1}"
        found.append(
            {"name": name, "start": float(solution.t[rows.start]), "end": float(solution.t[rows.stop - 1])}
        )
    return found


def _animate_placement(tracks: Tracks, node: Any, placements: np.ndarray) -> None:
    quaternions = [pin.Quaternion(matrix[:3, :3]).coeffs() for matrix in placements]
    tracks.add(node, "position", "vector3", placements[:, :3, 3])
    tracks.add(node, "quaternion", "quaternion", np.array(quaternions))


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
