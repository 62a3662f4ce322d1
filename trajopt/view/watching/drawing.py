"""Iterates as Meshcat commands and facts for the page: the scene once, then poses, paths, the animation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import meshcat
import numpy as np
import pinocchio as pin
import umsgpack

from trajopt.errors import TrajoptError
from trajopt.robot.building import reach
from trajopt.solution.solution import Solution
from trajopt.solving.monitoring import Iterate
from trajopt.view.replay.arrows import TRAIL_COLOURS
from trajopt.view.replay.caption import caption_line, title
from trajopt.view.replay.commands import Animation, Recorder, ViewerCommand
from trajopt.view.replay.copies import GHOST_COLOUR, draw_copy, messages_below
from trajopt.view.replay.layers import layer
from trajopt.view.replay.motion import replay_motion
from trajopt.view.replay.parts import draw_line
from trajopt.view.replay.robot import draw_robot, draw_skeleton, joint_path, tip_frames
from trajopt.view.replay.scene import build_scene
from trajopt.view.watching.motion import FRAME_RATE, MOST_POSES, IterateMotion

TOP = "/meshcat"
ROBOT, POSES, PATHS = "robot", "poses", "paths"
# Parts kept from the scene of the guess: iterates do not move them.
STILL = (ROBOT, "ground", "terrain", "surfaces", "obstacles", "goals")
# Size of the robot's meshes in bytes from which poses are skeletons: a browser stores them for each pose.
HEAVY = 8_000_000
MASS_COLOUR = 0x303438


@dataclass(frozen=True, kw_only=True)
class Picture:
    """Data of an iterate for a viewer: commands, and facts for the page; ``new``: of another scene."""

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

        An iterate none of whose nodes is finite changes the caption alone; None before anything could be
        drawn.
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
            vis = meshcat.Visualizer(window=recorder)
            _move_poses(vis[POSES], motion)
            _draw_paths(vis[PATHS], motion)
            recorder.commands.append(_animation(vis, motion))
            self._facts |= _times(iterate, motion)
            facts |= _times(iterate, motion)
        return Picture(new=new, commands=recorder.commands, facts=facts)

    def _begin(self, iterate: Iterate, recorder: Recorder) -> None:
        """The scene of a problem: its robot, ground, obstacles, light and camera; poses to be moved."""
        solution = iterate.solution()
        self._model, self._problem = solution.model, iterate.transcription.problem
        named = [self._model.getFrameId(name) for name in solution.contact_frames]
        self._frames = named or tip_frames(self._model)
        still, self._facts = _still(solution)
        recorder.commands += [ViewerCommand({"type": "delete", "path": TOP}), *still]
        _draw_poses(recorder, solution)


def _still(solution: Solution) -> tuple[list[ViewerCommand], dict[str, Any]]:
    """The static parts of the scene, as a replay draws them, and the page's facts.

    A motion that cannot be replayed has only its robot.
    """
    name = f"solving {title(solution)}"
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
        return recorder.commands, facts | {"title": name, "layers": added}
    layers = [one for one in scene.facts["layers"] if all(_is_still(path) for path in one["paths"])]
    kept = [command for command in scene.commands if _stands(command.message)]
    return kept, scene.facts | {"title": name, "layers": [*layers, *added]}


def _is_still(path: str) -> bool:
    return path.split("/")[0] in STILL


def _stands(message: dict[str, Any]) -> bool:
    path = str(message["path"])
    above = not path.startswith(f"{TOP}/")
    return message["type"] != "set_animation" and (above or _is_still(path.removeprefix(f"{TOP}/")))


def _draw_poses(recorder: Recorder, solution: Solution) -> None:
    """Draw the robot again for every pose, translucent; as a skeleton where its meshes are heavy."""
    drawn = messages_below(recorder, ROBOT)
    if len(umsgpack.packb(drawn)) > HEAVY:
        skeleton = Recorder()
        draw_skeleton(meshcat.Visualizer(window=skeleton), solution)
        drawn = messages_below(skeleton, ROBOT)
    for number in range(MOST_POSES):
        draw_copy(recorder, drawn, ROBOT, f"{POSES}/{number}/{ROBOT}", GHOST_COLOUR)


def _move_poses(node: Any, motion: IterateMotion) -> None:
    joints, _, _ = motion.placed(motion.poses())
    for number in range(MOST_POSES):
        node[str(number)].set_property("visible", number < len(joints))
        for joint in range(1, motion.model.njoints if number < len(joints) else 0):
            node[str(number)][joint_path(motion.model, joint)].set_transform(joints[number, joint])


def _draw_paths(node: Any, motion: IterateMotion) -> None:
    """The paths of contact frames (of tips where there are none) and of the centre of mass, as lines."""
    for number, frame in enumerate(motion.frames):
        name = motion.model.frames[frame].name.replace("/", "_")
        draw_line(node[name], motion.points[:, number], TRAIL_COLOURS[number % len(TRAIL_COLOURS)])
    draw_line(node["centre of mass"], motion.mass, MASS_COLOUR)


def _animation(vis: Any, motion: IterateMotion) -> ViewerCommand:
    count = len(motion.joints)
    tracks = Animation(count, (count - 1) / motion.duration, reach(motion.model) or 1.0)
    for joint in range(1, motion.model.njoints):
        tracks.place(vis[joint_path(motion.model, joint)], motion.joints[:, joint])
    return tracks.command()


def _times(iterate: Iterate, motion: IterateMotion) -> dict[str, Any]:
    """Start, duration and phases of a motion, whose times may be variables."""
    starts = [0, *(np.flatnonzero(np.diff(motion.phase)) + 1).tolist()]
    edges = [*motion.t[starts].tolist(), float(motion.t[-1])]
    names = [phase.name for phase in iterate.transcription.layout.schedule.phases]
    phases = [
        {"name": names[motion.phase[first]], "start": edges[number], "end": edges[number + 1]}
        for number, first in enumerate(starts)
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
