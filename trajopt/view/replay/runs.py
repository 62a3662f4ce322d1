"""The solutions of one scene: each below its own scene tree node, tinted or moved aside; their ghosts."""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.errors import InputError
from trajopt.motion.solution import Solution
from trajopt.view.replay.commands import Recorder, ViewerCommand
from trajopt.view.replay.motion import ReplayMotion
from trajopt.view.replay.robot import DrawnRobot, draw_robot, joint_path, subsample

LAYOUTS = ("overlaid", "side-by-side")

# Colours of several solutions, distinct for the colour-blind (Okabe and Ito, "Color universal design").
RUN_COLOURS = (0x5B6570, 0x0072B2, 0xD55E00, 0x009E73, 0xCC79A7, 0xE69F00, 0x56B4E9)
# Distance between neighbours side by side, in robot extents.
GAP = 0.4
# Frames at which the extent of a motion is measured.
MEASURED_FRAMES = 12
# Most points of a mesh used to measure it.
MEASURED_POINTS = 300
# A motion travels if its base goes further along the ground than this many times the robot.
TRAVELS_FROM = 3.0
PREFIX = "/meshcat/"
TINT_OPACITY = 0.55
GHOST_COLOUR, GHOST_OPACITY = 0x5F7FA6, 0.2
# Most ghosts, and the least distance between any two, over the robot's extent: of the joint that moves most.
MOST_GHOSTS, APART = 6, 0.35
# Most changes of phase that are considered in a long gait.
MOST_COMPARED = 40


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnSolution:
    """One solution of a scene, drawn below ``node``, which is at ``root`` of the scene tree ("" for the top).

    Args:
        colour: in legends, and of the whole run if it is ``tinted``.
        robot: its drawing.
        cloud: points (k, 3) of the drawn robot at a few frames, in the world of the solution, m.
        size: largest extent of the robot at the start, m.
        shift: (3,) from the world of the solution to that of the scene, m.
    """

    solution: Solution
    motion: ReplayMotion
    node: Any
    root: str
    label: str
    colour: int
    tinted: bool
    robot: DrawnRobot
    cloud: np.ndarray
    size: float
    shift: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def ink(self, colour: int) -> int:
        """Return the colour for a drawing of the run: the run's own if it is tinted."""
        return self.colour if self.tinted else colour

    @property
    def base_joint(self) -> int:
        """The joint that carries the base: the first one of a fixed base, 0 without joints."""
        model = self.solution.model
        return BASE_JOINT[base_of(model)] or min(1, model.njoints - 1)

    @property
    def base_path(self) -> str:
        """Scene tree path of the node that moves with the base."""
        return self.path(joint_path(self.solution.model, self.base_joint))

    @property
    def base(self) -> np.ndarray:
        """Positions (n, 3) of the base in the scene's world, m."""
        return np.asarray(self.motion.joints[:, self.base_joint, :3, 3] + self.shift)

    def path(self, place: str) -> str:
        """Scene tree path of a place below this run."""
        return f"{self.root}/{place}" if self.root else place


def require_labels(labels: Sequence[str] | None, count: int) -> None:
    """Raise `InputError` unless there are no labels, or one for each of ``count`` solutions."""
    if labels is not None and len(labels) != count:
        raise InputError(f"{len(labels)} labels for {count} solutions", "one for each, in their order")


def drawn_runs(
    vis: Any,
    solutions: Sequence[Solution],
    motions: Sequence[ReplayMotion],
    layout: str | None,
    labels: Sequence[str] | None,
) -> list[DrawnSolution]:
    """Draw the robot of every solution; those after the first are tinted (overlaid) or moved aside.

    Raises `InputError` for an unknown layout or another number of labels.
    """
    if layout is None:
        layout = "side-by-side" if len({str(s.description.robot) for s in solutions}) > 1 else "overlaid"
    if layout not in LAYOUTS:
        raise InputError(f"unknown layout '{layout}'", f"allowed: {', '.join(LAYOUTS)}")
    require_labels(labels, len(solutions))
    names = list(labels) if labels is not None else _names(solutions)
    runs = []
    for number, (solution, motion) in enumerate(zip(solutions, motions, strict=True)):
        root = f"run{number}" if len(solutions) > 1 else ""
        node = vis[root] if root else vis
        robot = draw_robot(node, solution)
        cloud, size = _extent(robot, motion)
        run = DrawnSolution(
            solution=solution,
            motion=motion,
            node=node,
            root=root,
            label=names[number],
            colour=RUN_COLOURS[number % len(RUN_COLOURS)],
            tinted=layout == "overlaid" and number > 0,
            robot=robot,
            cloud=cloud,
            size=size,
        )
        runs.append(run)
    return _aside(runs) if layout == "side-by-side" else runs


def _names(solutions: Sequence[Solution]) -> list[str]:
    """Problem and robot of each, numbered where they are the same."""
    names = [
        " ".join(filter(None, (s.description.problem, s.description.robot))) or "trajectory"
        for s in solutions
    ]
    twice = len(set(names)) < len(names)
    return [f"{name} ({number + 1})" if twice else name for number, name in enumerate(names)]


def _extent(robot: DrawnRobot, motion: ReplayMotion) -> tuple[np.ndarray, float]:
    """Points (k, 3) of the robot at a few frames, m, and its extent at the start, m."""
    rows = np.unique(np.linspace(0, motion.n_frames - 1, MEASURED_FRAMES).astype(int))
    parts = [np.zeros((len(rows), 0, 3))]
    for joint, points in robot.points.items():
        placement = motion.joints[rows, joint]
        local = np.concatenate([subsample(part, MEASURED_POINTS) for part in points])
        parts.append(local @ placement[:, :3, :3].transpose(0, 2, 1) + placement[:, None, :3, 3])
    cloud = np.concatenate(parts, axis=1)
    extent = float(np.ptp(cloud[0], axis=0).max()) if cloud.size else 0.0
    return cloud.reshape(-1, 3), max(extent, 1e-3)


def _aside(runs: list[DrawnSolution]) -> list[DrawnSolution]:
    """Move runs next to each other, across the longer horizontal side of the first motion."""
    spans = np.ptp(runs[0].cloud[:, :2], axis=0)
    axis = 1 if spans[0] >= spans[1] else 0
    gap, placed = GAP * max(run.size for run in runs), runs[:1]
    for run in runs[1:]:
        before, shift = placed[-1], np.zeros(3)
        shift[axis] = before.shift[axis] + before.cloud[:, axis].max() + gap - run.cloud[:, axis].min()
        placed.append(replace(run, shift=shift))
    return placed


def travels(run: DrawnSolution, tangents: np.ndarray) -> bool:
    """Whether the base travels far along ground with these ``tangents`` (2, 3)."""
    along = (run.base - run.base[0]) @ tangents.T
    return float(np.ptp(along, axis=0).max()) > TRAVELS_FROM * run.size


def messages_below(recorder: Recorder, place: str) -> list[dict[str, Any]]:
    """Messages so far about objects below a ``place`` of the scene tree."""
    start = f"{PREFIX}{place}/"
    return [c.message for c in recorder.commands if c.message.get("path", "").startswith(start)]


def tint(recorder: Recorder, place: str, colour: int) -> None:
    """Give everything drawn below ``place`` one translucent colour."""
    start = f"{PREFIX}{place}/"
    recorder.commands[:] = [
        ViewerCommand(_in_colour(command.message, colour, TINT_OPACITY))
        if command.message.get("path", "").startswith(start) and command.message["type"] == "set_object"
        else command
        for command in recorder.commands
    ]


def draw_copy(recorder: Recorder, drawn: list[dict[str, Any]], place: str, copy: str, colour: int) -> None:
    """Draw what was ``drawn`` below ``place`` again below ``copy``, as a translucent ghost without shadow."""
    for message in drawn:
        path = f"{PREFIX}{copy}" + message["path"].removeprefix(f"{PREFIX}{place}")
        moved = {**message, "path": path}
        if message["type"] != "set_object":
            recorder.note(moved)
            continue
        recorder.note(_in_colour(moved, colour, GHOST_OPACITY, behind=True))
        for name in ("castShadow", "receiveShadow"):
            shadow = {"type": "set_property", "path": f"{path}/<object>", "property": name, "value": False}
            recorder.note(shadow)


def _in_colour(message: dict[str, Any], colour: int, opacity: float, behind: bool = False) -> dict[str, Any]:
    """The message of an object with another material, and the same geometry.

    With ``behind``, it is hidden where it coincides with another object.
    """
    content = message["object"]
    material = {
        "uuid": str(uuid.uuid4()),
        "type": "MeshLambertMaterial",
        "color": colour,
        "opacity": opacity,
        "transparent": True,
        "polygonOffset": behind,
        "polygonOffsetFactor": 2.0,
        "polygonOffsetUnits": 2.0,
    }
    geometries, shape = content.get("geometries", []), content["object"]
    if shape["type"] == "_meshfile_object":  # a file with its own materials: its geometry alone
        file = {"format": shape["format"], "data": shape["data"]}
        geometries = [{"uuid": str(uuid.uuid4()), "type": "_meshfile_geometry", **file}]
        matrix = shape.get("matrix", np.eye(4).ravel().tolist())
        shape = {"type": "Mesh", "geometry": geometries[0]["uuid"], "matrix": matrix}
    drawn = {key: value for key, value in shape.items() if key not in ("material", "data")}
    drawn |= {"uuid": str(uuid.uuid4()), "material": material["uuid"]}
    rest = {key: value for key, value in content.items() if key not in ("materials", "textures", "images")}
    return {**message, "object": {**rest, "geometries": geometries, "materials": [material], "object": drawn}}


def draw_ghosts(
    recorder: Recorder, run: DrawnSolution, joints: Sequence[tuple[int, str]], frames: list[int]
) -> None:
    """Draw translucent copies of a run's robot at ``frames``; ``joints`` come with their scene tree paths."""
    drawn = messages_below(recorder, run.path("robot"))
    for number, frame in enumerate(frames):
        ghost = f"{run.path('ghosts')}/pose{number}"
        for joint, place in joints:
            matrix = run.motion.joints[frame, joint].T.ravel().tolist()
            path = f"{PREFIX}{ghost}/{place.removeprefix('robot/')}"
            recorder.note({"type": "set_transform", "path": path, "matrix": matrix})
        draw_copy(recorder, drawn, run.path("robot"), ghost, run.ink(GHOST_COLOUR))


def ghost_frames(motion: ReplayMotion, size: float) -> list[int]:
    """Frames of start, changes of phase and end with distinct poses; an even selection if they are many."""
    changes = (np.flatnonzero(np.diff(motion.phase)) + 1).tolist()
    wanted = _spread([0, *changes, motion.n_frames - 1], MOST_COMPARED)
    kept: list[int] = []
    places = motion.joints[:, 1:, :3, 3]
    for frame in wanted:
        ways = np.linalg.norm(places[kept] - places[frame], axis=2)
        if (ways.max(axis=1, initial=0.0) > APART * size).all():
            kept.append(frame)
    return _spread(kept, MOST_GHOSTS)


def _spread(frames: list[int], most: int) -> list[int]:
    """At most ``most`` of the frames, evenly chosen, including the first and the last."""
    chosen = np.linspace(0, len(frames) - 1, min(len(frames), most)).round().astype(int)
    return [frames[index] for index in np.unique(chosen)]
