"""Iterates as Meshcat commands and facts for the page: the scene once, then poses, paths, the animation."""

import itertools
from dataclasses import dataclass, field
from typing import Any

import meshcat
import numpy as np
import pinocchio as pin
import umsgpack

from trajopt.errors import TrajoptError
from trajopt.motion.solution import Solution
from trajopt.robot.building import reach
from trajopt.solving.monitoring import Iterate
from trajopt.view.replay.commands import Animation, Recorder, ViewerCommand
from trajopt.view.replay.contacts import TRAIL_COLOURS
from trajopt.view.replay.motion import placements, replay_motion, spans
from trajopt.view.replay.parts import draw_line
from trajopt.view.replay.robot import draw_robot, draw_skeleton, joint_path, tip_frames
from trajopt.view.replay.runs import GHOST_COLOUR, draw_copy, messages_below
from trajopt.view.replay.scene import build_scene, caption_line, layer, title

# Frame rate of the animation: its frames are closer than the nodes.
FRAME_RATE = 30.0
# Poses of the robot along the motion.
LEAST_POSES, MOST_POSES = 4, 6
TOP = "/meshcat"
ROBOT, POSES, PATHS = "robot", "poses", "paths"
# Parts kept from the scene of the guess: iterates do not move them.
STILL = (ROBOT, "ground", "terrain", "surfaces", "obstacles", "goals")
# Size of the robot's meshes in bytes from which poses are skeletons: a browser stores them for each pose.
HEAVY = 8_000_000
MASS_COLOUR = 0x303438


@dataclass(kw_only=True, eq=False)
class IterateMotion:
    """Configurations of an iterate at nodes t (n,) s, q (n, nq), phase (n,); placements at even frames."""

    model: pin.Model
    t: np.ndarray
    q: np.ndarray
    phase: np.ndarray
    frames: list[int]
    joints: np.ndarray = field(init=False)
    points: np.ndarray = field(init=False)
    mass: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        count = max(2, round(self.duration * FRAME_RATE) + 1)
        self.joints, self.points, self.mass = self.placed(np.linspace(self.t[0], self.t[-1], count))

    @property
    def duration(self) -> float:
        """Seconds from the first node to the last; at least one picture."""
        return max(float(self.t[-1] - self.t[0]), 1 / FRAME_RATE)

    def placed(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Placements of joints (k, njoints, 4, 4), positions of ``frames`` (k, f, 3) and of mass (k, 3), m.

        At ``times`` (k,), s; configurations are interpolated on the geodesics between nodes.
        """
        last, part = spans(self.t, times)
        ends = zip(self.q[last], self.q[np.minimum(last + 1, len(self.t) - 1)], part, strict=True)
        q = np.array([pin.interpolate(self.model, *pair, float(way)) for *pair, way in ends])
        joints, frames = placements(self.model, self.frames, q)
        data = self.model.createData()
        mass = np.array([pin.centerOfMass(self.model, data, row) for row in q])
        return joints, frames[:, :, :3, 3], mass

    def poses(self) -> np.ndarray:
        """Times (k,) of drawn poses: starts of phases and the end; some of many, even times if few."""
        starts = np.flatnonzero(np.diff(self.phase)) + 1
        changes = np.unique(np.concatenate([self.t[:1], self.t[starts], self.t[-1:]]))
        if LEAST_POSES <= len(changes) <= MOST_POSES:
            return changes
        if len(changes) > MOST_POSES:
            return np.asarray(changes[np.linspace(0, len(changes) - 1, MOST_POSES).round().astype(int)])
        return np.linspace(self.t[0], self.t[-1], LEAST_POSES)


@dataclass(frozen=True, kw_only=True)
class Picture:
    """Data of an iterate for a viewer: commands, and facts for the page; ``new``: of a new scene."""

    new: bool
    commands: list[ViewerCommand]
    facts: dict[str, Any]


class IterateScene:
    """Pictures of iterates, one problem after another."""

    def __init__(self) -> None:
        self._problem: Any = None
        self._model: pin.Model = pin.Model()
        self._frames: list[int] = []
        self._facts: dict[str, Any] = {}

    def picture(self, iterate: Iterate) -> Picture | None:
        """The picture of an iterate; for the first one of a problem, the whole scene.

        An iterate without finite nodes changes only the caption; None if nothing could be drawn yet.
        """
        t, q, phase = iterate.configurations()
        recorder, new = Recorder(), False
        if len(t) and iterate.transcription.problem is not self._problem:
            self._begin(iterate, recorder)
            new = True
        if self._problem is None:
            return None
        facts = self._facts | {"lines": [caption_line(text, kind) for text, kind in _words(iterate, len(t))]}
        if len(t):
            motion = IterateMotion(model=self._model, t=t, q=q, phase=phase, frames=self._frames)
            _draw_motion(recorder, motion)
            times = _times(iterate, motion)
            self._facts |= times
            facts |= times
        return Picture(new=new, commands=recorder.commands, facts=facts)

    def _begin(self, iterate: Iterate, recorder: Recorder) -> None:
        """The scene of a problem: its robot, ground, obstacles, light and camera; poses to be moved."""
        solution = iterate.solution()
        self._model, self._problem = solution.model, iterate.transcription.problem
        self._frames = solution.contact_ids or tip_frames(self._model)
        still, self._facts = still_scene(solution)
        self._facts |= {"title": f"solving {title(solution)}"}
        recorder.commands += [ViewerCommand({"type": "delete", "path": TOP}), *still]
        _draw_poses(recorder, solution)


def still_scene(solution: Solution) -> tuple[list[ViewerCommand], dict[str, Any]]:
    """Return the static parts of the scene, as a replay draws them, and the page's facts.

    If the motion cannot be replayed, only the robot is drawn.
    """
    added = [
        layer(POSES, "poses on the way", GHOST_COLOUR, [POSES]),
        layer(PATHS, "paths of feet and mass", TRAIL_COLOURS[0], [PATHS]),
    ]
    try:
        with np.errstate(all="ignore"):
            scene = build_scene([solution], [replay_motion(solution)])
    except (TrajoptError, ArithmeticError, ValueError):
        recorder = Recorder()
        draw_robot(meshcat.Visualizer(window=recorder), solution)
        size = reach(solution.model) or 1.0
        facts = {"start": 0.0, "speed": 1.0, "size": size, "box": [[-size] * 3, [size] * 3], "runs": []}
        return recorder.commands, facts | {"title": title(solution), "layers": added}

    def moves(path: str) -> bool:
        return path.startswith(f"{TOP}/") and path.split("/")[2] not in STILL

    layers = [
        one for one in scene.facts["layers"] if not any(moves(f"{TOP}/{path}") for path in one["paths"])
    ]
    messages = [command.message for command in scene.commands]
    kept = [m for m in messages if m["type"] != "set_animation" and not moves(m["path"])]
    return [ViewerCommand(message) for message in kept], scene.facts | {
        "title": title(solution),
        "layers": [*layers, *added],
    }


def _draw_poses(recorder: Recorder, solution: Solution) -> None:
    """Draw the robot again for every pose, translucent; as a skeleton where its meshes are heavy."""
    drawn = messages_below(recorder, ROBOT)
    if len(umsgpack.packb(drawn)) > HEAVY:
        skeleton = Recorder()
        draw_skeleton(meshcat.Visualizer(window=skeleton), solution)
        drawn = messages_below(skeleton, ROBOT)
    for number in range(MOST_POSES):
        draw_copy(recorder, drawn, ROBOT, f"{POSES}/{number}/{ROBOT}", GHOST_COLOUR)


def _draw_motion(recorder: Recorder, motion: IterateMotion) -> None:
    """Move the poses and the robot, and draw the paths of ``frames`` and of the centre of mass."""
    vis, model, count = meshcat.Visualizer(window=recorder), motion.model, len(motion.joints)
    places = [(joint, joint_path(model, joint)) for joint in range(1, model.njoints)]
    poses, _, _ = motion.placed(motion.poses())
    for number in range(MOST_POSES):
        node = vis[POSES][str(number)]
        node.set_property("visible", number < len(poses))
        for joint, place in places if number < len(poses) else ():
            node[place].set_transform(poses[number, joint])
    for number, frame in enumerate(motion.frames):
        name = model.frames[frame].name.replace("/", "_")
        draw_line(vis[PATHS][name], motion.points[:, number], TRAIL_COLOURS[number % len(TRAIL_COLOURS)])
    draw_line(vis[PATHS]["centre of mass"], motion.mass, MASS_COLOUR)
    tracks = Animation(count, (count - 1) / motion.duration, reach(model) or 1.0)
    for joint, place in places:
        tracks.place(vis[place], motion.joints[:, joint])
    recorder.commands.append(tracks.command())


def _times(iterate: Iterate, motion: IterateMotion) -> dict[str, Any]:
    """Start, duration and phases of a motion; they change with iterates if times are variables."""
    starts = [0, *(np.flatnonzero(np.diff(motion.phase)) + 1).tolist()]
    edges = [*motion.t[starts].tolist(), float(motion.t[-1])]
    names = [iterate.transcription.layout.schedule.phases[motion.phase[first]].name for first in starts]
    phases = [
        {"name": name, "start": start, "end": end}
        for name, (start, end) in zip(names, itertools.pairwise(edges), strict=True)
    ]
    span = {"start": float(motion.t[0]), "duration": motion.duration, "picture": 1 / FRAME_RATE}
    return {**span, "phases": phases}


def _words(iterate: Iterate, finite: int) -> list[tuple[str, str]]:
    """The caption's lines and their kinds: which solve, which iteration, its figures."""
    first = ", ".join(part for part in (iterate.label, iterate.grid, iterate.solver) if part)
    if iterate.stage == "guess":
        return [(first, "quiet"), ("the guess", "run")]
    figures = iterate.figures
    trouble = "restoring feasibility" if figures.get("restoration") else ""
    state = iterate.status or trouble or "solving"
    kind = "run" if state in ("solving", "solved") else "warned" if state == trouble else "failed"
    lines = [(first, "quiet"), (f"iteration {figures['iteration']:.0f}: {state}", kind)]
    if not finite:
        lines.append(("no node of this iterate is finite", "failed"))
    lines.append((f"objective {figures['objective']:.5g}", "quiet"))
    return [*lines, (f"infeasibility {figures['primal']:.1e}, optimality {figures['dual']:.1e}", "quiet")]
