"""The scene of a replay as Meshcat commands: robots, ground, force arrows, trails, camera, animation."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import meshcat
import numpy as np

from trajopt.solution.solution import Solution
from trajopt.terrain.surface import Surface
from trajopt.view.replay.balance import balance_of, draw_balance
from trajopt.view.replay.bodies import draw_obstacles, draw_payloads, draw_shapes
from trajopt.view.replay.commands import Animation, Recorder, ViewerCommand
from trajopt.view.replay.contacts import draw_arrows, draw_cones, draw_trails, weight_arrow_of
from trajopt.view.replay.goals import draw_controller, draw_goals
from trajopt.view.replay.ground import DrawnGround, draw_grounds, grounds_of
from trajopt.view.replay.layers import caption_lines, layers_of, title
from trajopt.view.replay.motion import ReplayMotion, phase_spans
from trajopt.view.replay.parts import placed
from trajopt.view.replay.robot import joint_path
from trajopt.view.replay.runs import (
    PREFIX,
    DrawnSolution,
    draw_ghosts,
    drawn_runs,
    ghost_frames,
    tint,
    travels,
)
from trajopt.view.replay.surfaces import draw_surfaces

# Camera of Meshcat's own page (the player's are in web/cameras.js): vertical field of view in degrees, for
# little perspective.
FIELD_OF_VIEW = 35.0
# Direction from the robot to the camera: from its right and ahead, slightly above.
CAMERA_DIRECTION = np.array([0.62, -1.0, 0.42])


@dataclass(frozen=True)
class ReplayScene:
    """Commands in order, and a ``note`` if a robot is not drawn in full.

    ``facts`` describe the scene for a page, JSON-able: ``start`` (s of the solution), ``speed``,
    ``duration`` (s of playback), ``phases`` [{name, start, end}] of the first solution, s, ``layers`` [{name,
    label, colour, paths, visible}], ``runs`` [{label, colour, root, base}] with places in the scene tree,
    ``size`` (m, the largest robot's extent), ``box`` [[low], [high]] (m, world) around all motions and their
    contacts, ``travels``: whether a base goes so far that a camera should follow it, ``title``, ``picture``
    (s of the solution between two pictures of the animation), ``lines`` [{text, kind, colour, layer}] of the
    caption.
    """

    commands: list[ViewerCommand]
    note: str
    facts: dict[str, Any]


def build_scene(
    solutions: Sequence[Solution],
    motions: Sequence[ReplayMotion],
    layout: str | None = None,
    labels: Sequence[str] | None = None,
) -> ReplayScene:
    """Return the Meshcat commands that show ``motions``, with equal frames.

    Later solutions are tinted and laid over the first (``layout`` "overlaid") or moved aside ("side-by-side",
    the default for different robots); ``labels`` name them. Raises `InputError` for a layout or labels that
    do not fit.
    """
    recorder, first = Recorder(), motions[0]
    vis = meshcat.Visualizer(window=recorder)
    runs = drawn_runs(vis, solutions, motions, layout, labels)
    for run in runs:
        if run.tinted:
            tint(recorder, run.path("robot"), run.colour)
    size = max(run.size for run in runs)
    tracks = Animation(first.n_frames, first.frame_rate, size)
    grounds, weight_arrow = grounds_of(runs, size), weight_arrow_of(motions, size)
    cloud = np.concatenate(
        [
            _draw_run(recorder, tracks, run, ground, size, weight_arrow)
            for run, ground in zip(runs, grounds, strict=True)
        ]
    )
    box = np.array([cloud.min(axis=0), cloud.max(axis=0)])
    ground = draw_grounds(vis, runs, grounds, box, size)
    messages = [command.message for command in recorder.commands]
    drawn = [m["path"].removeprefix(PREFIX) for m in messages if m["type"] == "set_object"]
    layers = layers_of(runs, drawn, ground.tangents)
    for layer in layers:
        for path in () if layer["visible"] else layer["paths"]:
            vis[path].set_property("visible", False)
    _frame(vis, box, ground)
    recorder.commands.append(tracks.command())
    note = "; ".join(dict.fromkeys(run.robot.note for run in runs if run.robot.note))
    facts = {
        "start": float(first.t[0]),
        "speed": first.speed,
        "duration": first.duration,
        "phases": [vars(span) for span in phase_spans(solutions[0])],
        "layers": layers,
        "runs": [
            {"label": run.label, "colour": f"#{run.colour:06x}", "root": run.root, "base": run.base_path}
            for run in runs
        ],
        "size": size,
        "box": box.tolist(),
        "travels": travels(runs[0], ground.tangents),
        "title": " | ".join(dict.fromkeys(title(solution) for solution in solutions)),
        "picture": first.speed / first.frame_rate,
        "lines": caption_lines(runs, motions, [layer["name"] for layer in layers], weight_arrow, note),
    }
    return ReplayScene(recorder.commands, note, facts)


def _draw_run(
    recorder: Recorder,
    tracks: Animation,
    run: DrawnSolution,
    ground: DrawnGround,
    size: float,
    weight_arrow: float,
) -> np.ndarray:
    """Draw one solution; returns points (k, 3) of its extent in the scene's world, m."""
    model, motion, node = run.solution.model, run.motion, run.node
    if run.shift.any():
        node.set_transform(placed(run.shift))
    joints = [(joint, joint_path(model, joint)) for joint in range(1, model.njoints)]
    draw_ghosts(recorder, run, joints, ghost_frames(motion, run.size))
    for joint, place in joints:
        tracks.place(node[place], motion.joints[:, joint])
    places = [
        run.cloud,
        draw_surfaces(run, ground.elsewhere, size),
        draw_obstacles(run),
        draw_goals(run, ground.drop, size),
        draw_payloads(run, tracks),
    ]
    draw_shapes(run, tracks)
    draw_arrows(run, tracks, size, weight_arrow)
    draw_cones(run, tracks, size)
    balance = balance_of(run.solution, motion)
    draw_balance(run, tracks, balance, ground.drop, size)
    draw_controller(run, tracks, balance.com, size, weight_arrow)
    draw_trails(run)
    return np.asarray(np.concatenate(places) + run.shift)


def _frame(vis: Any, box: np.ndarray, ground: Surface) -> None:
    """Make the camera of Meshcat's own page show the whole ``box`` (2, 3), m, and the ground below it.

    Meshcat's camera always looks at the origin of the viewer, so the world is moved there.
    """
    middle = box.mean(axis=0)
    below = middle - ground.distance(middle) * ground.normal
    low, high = np.minimum(box[0], below), np.maximum(box[1], below)
    target = (low + high) / 2
    distance = float(np.linalg.norm(high - low)) / 2 / np.sin(np.radians(FIELD_OF_VIEW) / 2)
    offset = distance * CAMERA_DIRECTION / np.linalg.norm(CAMERA_DIRECTION)
    lens = vis["/Cameras/default/rotated/<object>"]
    lens.set_property("fov", FIELD_OF_VIEW)
    lens.set_property("position", [float(offset[0]), float(offset[2]), float(-offset[1])])  # y is up there
    vis.set_transform(placed(-target))
