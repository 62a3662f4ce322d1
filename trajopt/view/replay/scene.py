"""The scene of a replay as Meshcat commands: robots, ground, force arrows, trails, camera, animation."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import meshcat
import numpy as np

from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.motion.solution import Solution
from trajopt.terrain.surface import Surface
from trajopt.view.replay.balance import SUPPORT_COLOUR, ZMP_COLOUR, balance_of, draw_balance
from trajopt.view.replay.bodies import (
    OBSTACLE_COLOUR,
    PAYLOAD_COLOUR,
    SHAPE_COLOUR,
    draw_obstacles,
    draw_payloads,
    draw_shapes,
)
from trajopt.view.replay.commands import Animation, Recorder, ViewerCommand
from trajopt.view.replay.contacts import COLOURS as CONE_COLOURS
from trajopt.view.replay.contacts import (
    FORCE_COLOUR,
    IMPULSE_COLOUR,
    USED,
    draw_arrows,
    draw_cones,
    draw_trails,
    weight_arrow_of,
)
from trajopt.view.replay.goals import ASKED_COLOUR, CROSS_COLOUR, draw_controller, draw_goals
from trajopt.view.replay.ground import GROUND_COLOUR, DrawnGround, draw_grounds, grounds_of
from trajopt.view.replay.motion import FLASH, ReplayMotion, phase_spans
from trajopt.view.replay.parts import placed
from trajopt.view.replay.robot import joint_path
from trajopt.view.replay.runs import (
    GHOST_COLOUR,
    PREFIX,
    DrawnSolution,
    draw_ghosts,
    drawn_runs,
    ghost_frames,
    tint,
    travels,
)
from trajopt.view.replay.surfaces import WALL_COLOUR, draw_surfaces

# Camera of Meshcat's own page (the player's are in web/cameras.js): vertical field of view in degrees, for
# little perspective.
FIELD_OF_VIEW = 35.0
# Direction from the robot to the camera: from its right and ahead, slightly above.
CAMERA_DIRECTION = np.array([0.62, -1.0, 0.42])
Line = dict[str, str]
# A robot ends elsewhere if its base moves by more than this, over its extent.
ELSEWHERE = 0.5

# Name, label, colour, and place in the scene tree of every run or of the scene.
LAYERS = (
    ("robot", "robot", 0x8A93A0, "robot"),
    ("shapes", "collision shapes", SHAPE_COLOUR, "shapes"),
    ("forces", "contact forces", FORCE_COLOUR, "forces"),
    ("controller", "controller: forces and goals", ASKED_COLOUR, "controller"),
    ("impulses", "impulses", IMPULSE_COLOUR, "impulses"),
    ("cones", "friction cones", 0x3C93C2, "cones"),
    ("com", "centre of mass", 0x1A1F26, "com"),
    ("zmp", "zero-moment point", ZMP_COLOUR, "zmp"),
    ("support", "support", SUPPORT_COLOUR, "support"),
    ("trails", "trails", 0x1F77B4, "trails"),
    ("ghosts", "poses at changes of phase", GHOST_COLOUR, "ghosts"),
    ("goals", "goals", CROSS_COLOUR, "goals"),
    ("payloads", "payload", PAYLOAD_COLOUR, "payloads"),
    ("obstacles", "obstacles", OBSTACLE_COLOUR, "obstacles"),
    ("surfaces", "walls and handles", WALL_COLOUR, "surfaces"),
    ("terrain", "terrain", GROUND_COLOUR, "ground"),
)


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


def caption_lines(
    runs: Sequence[DrawnSolution],
    motions: Sequence[ReplayMotion],
    layers: Collection[str],
    weight_arrow: float,
    note: str,
) -> list[Line]:
    """Return the lines of the caption: solutions, legend of ``layers``, a ``note`` on missing parts.

    Kinds are "", "run", "quiet", "scale", "warned" or "failed"; ``weight_arrow`` is the length of a weight's
    arrow, m. A line with a layer is shown while the layer is.
    """
    notes = [caption_line(note, "warned")] if note else []
    legend = [line for line in _legend(motions, weight_arrow) if line["layer"] in layers]
    return [*_about(runs), *legend, *notes]


def title(solution: Solution) -> str:
    """Return problem and robot of a solution."""
    names = [solution.description.problem, solution.description.robot]
    return " – ".join(dict.fromkeys(str(name) for name in names if name)) or "trajectory"


def _about(runs: Sequence[DrawnSolution]) -> list[Line]:
    """The caption's lines about the solutions, with labels if there are several."""
    names, lines = [title(run.solution) for run in runs], []
    for run, name in zip(runs, names, strict=True):
        if len(runs) > 1:
            usual = name.replace(" – ", " ")  # the default label of a run
            told = len(set(names)) == 1 or run.label == usual
            said = run.label if told else f"{run.label}: {name}"
            lines.append(caption_line(said, "run", f"#{run.colour:06x}"))
        lines.append(caption_line(_state(run.solution), "quiet"))
        if not run.solution.success:
            status = run.solution.statistics.status.replace("_", " ")
            lines.append(caption_line(f"not solved: {status}", "failed"))
    return lines


def _state(solution: Solution) -> str:
    """Length, grid, objective and, where it was measured, the open-loop error of a solution."""
    statistics, graded = solution.statistics, solution.statistics.graded
    said = [f"{solution.t[-1] - solution.t[0]:.2f} s"]
    if statistics.simulated:
        said.append("simulated")
    elif statistics.transcription:
        said.append(f"{statistics.transcription}, {solution.n_intervals} intervals")
    if statistics.objective is not None:
        said.append(f"objective {statistics.objective:.4g}")
    if graded is not None and graded.error_m is not None:
        said.append(f"open-loop error {1e3 * graded.error_m:.2g} mm")
    return "; ".join(said)


def _legend(motions: Sequence[ReplayMotion], weight_arrow: float) -> list[Line]:
    """Scales of arrows in terms of each robot's weight, and the colours of cones."""
    weights = dict.fromkeys(f"{motion.weight:.1f} N" for motion in motions)
    forces = f"forces: {weight_arrow:.2f} m is the weight, {' or '.join(weights)}"
    impulses = dict.fromkeys(
        f"{motion.weight * FLASH:.2f} N s" for motion in motions if motion.impact[..., :3].any()
    )
    struck = f"impulses: {weight_arrow:.2f} m is {' or '.join(impulses)}"
    ends = [f"#{colour:06x} {100 * used:.0f}%" for used, colour in zip(USED, CONE_COLOURS, strict=True)]
    cones = "cones: share of friction used, 0 to 100 %"
    asked = "controller: forces it asked for; crosses: its goals"
    return [
        caption_line(forces, "quiet", f"#{FORCE_COLOUR:06x}", "forces"),
        caption_line(asked, "quiet", f"#{ASKED_COLOUR:06x}", "controller"),
        caption_line(struck, "quiet", f"#{IMPULSE_COLOUR:06x}", "impulses"),
        caption_line(cones, "scale", f"linear-gradient(90deg, {', '.join(ends)})", "cones"),
    ]


def caption_line(text: str, kind: str = "", colour: str = "", layer: str = "") -> Line:
    """Return a line of the caption; ``colour`` as in CSS, also a gradient, ``layer``: whose legend it is."""
    return {"text": text, "kind": kind, "colour": colour, "layer": layer}


def layers_of(
    runs: Sequence[DrawnSolution], drawn: Collection[str], tangents: np.ndarray
) -> list[dict[str, Any]]:
    """The layers with something ``drawn`` (scene tree paths), and one for each run if there are several.

    ``tangents`` (2, 3) are those of the ground. Collision shapes are hidden at first, and so are ghosts
    unless they show the path of a single robot at a glance: both obscure the robot. The centre of mass is
    hidden for fixed bases, where it is of little interest.
    """
    hidden = {"shapes"}
    if len(runs) > 1 or not _parts_from_itself(runs[0], tangents):
        hidden.add("ghosts")
    if not any(BASE_JOINT[base_of(run.solution.model)] for run in runs):
        hidden.add("com")
    places = {"/".join(path.split("/")[:depth]) for path in drawn for depth in range(1, path.count("/") + 2)}
    listed = []
    for name, label, colour, place in LAYERS:
        wanted = [*(run.path(place) for run in runs), place]
        paths = [path for path in dict.fromkeys(wanted) if path in places]
        if paths:
            listed.append(layer(name, label, colour, paths, name not in hidden))
    if len(runs) > 1:
        listed += [layer(run.root, run.label, run.colour, [run.root]) for run in runs]
    return listed


def layer(name: str, label: str, colour: int, paths: list[str], visible: bool = True) -> dict[str, Any]:
    """Return a layer for the page: a toggle that shows and hides parts of the scene tree."""
    return {"name": name, "label": label, "colour": f"#{colour:06x}", "paths": paths, "visible": visible}


def _parts_from_itself(run: DrawnSolution, tangents: np.ndarray) -> bool:
    """Whether the robot ends away from its start but within one picture; always true for a fixed base."""
    if not BASE_JOINT[base_of(run.solution.model)]:
        return True
    way = float(np.linalg.norm((run.base[-1] - run.base[0]) @ tangents.T))
    return way > ELSEWHERE * run.size and not travels(run, tangents)
