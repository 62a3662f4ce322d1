"""Iterates as Meshcat commands and facts for the page: the scene once, then poses, paths, the animation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import meshcat
import numpy as np
import pinocchio as pin

from trajopt.errors import TrajoptError
from trajopt.robot.building import reach
from trajopt.solution.solution import Solution
from trajopt.solving.monitoring import Iterate
from trajopt.view.replay.caption import page_facts, title
from trajopt.view.replay.commands import Animation, Recorder, ViewerCommand
from trajopt.view.replay.copies import GHOST_COLOUR, GHOST_OPACITY, messages_below, tint
from trajopt.view.replay.motion import replay_motion
from trajopt.view.replay.parts import draw_line
from trajopt.view.replay.robot import draw_robot, draw_skeleton, joint_path, tip_frames
from trajopt.view.replay.scene import build_scene
from trajopt.view.watching.motion import FRAME_RATE, MOST_POSES, IterateMotion

TOP = "/meshcat"
ROBOT, POSES, PATHS = "robot", "poses", "paths"
# What a scene of the guess has that iterates do not move.
STILL = (ROBOT, "ground", "terrain", "surfaces", "obstacles", "goals")
# Bytes of the robot's meshes from which poses are skeletons: a browser holds each pose's own.
HEAVY = 8_000_000
# Colours of paths, of feet in turn, and of the centre of mass.
PATH_COLOURS, MASS_COLOUR = (0x1F77B4, 0x2CA02C, 0x9467BD, 0xC77700), 0x303438


@dataclass(frozen=True, kw_only=True)
class Picture:
    """What a viewer is told of an iterate: commands, and facts for the page; ``new``: of another scene."""

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
        """What shows an iterate; of the first one of a problem the whole scene.

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
        facts = self._facts | {"lines": [_line(text, kind) for text, kind in _words(iterate, len(t))]}
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
        recorder.commands += _posed(solution, recorder)


def _still(solution: Solution) -> tuple[list[ViewerCommand], dict[str, Any]]:
    """What does not move with iterates, as a replay draws it, and the page's facts about it.

    A motion that no replay can show has its robot alone.
    """
    name = f"solving {title(solution)}"
    own = [
        _layer(POSES, "poses on the way", GHOST_COLOUR),
        _layer(PATHS, "paths of feet and mass", PATH_COLOURS[0]),
    ]
    try:
        with np.errstate(all="ignore"):
            motion = replay_motion(solution)
            scene = build_scene([solution], [motion])
            facts = page_facts(scene, [solution], [motion])
    except (TrajoptError, ArithmeticError, ValueError):
        recorder = Recorder()
        draw_robot(meshcat.Visualizer(window=recorder), solution)
        size = reach(solution.model) or 1.0
        facts = {"start": 0.0, "speed": 1.0, "size": size, "box": [[-size] * 3, [size] * 3], "runs": []}
        return recorder.commands, facts | {"title": name, "layers": own}
    layers = [layer for layer in facts["layers"] if all(_is_still(path) for path in layer["paths"])]
    kept = [command for command in scene.commands if _stands(command.message)]
    return kept, facts | {"title": name, "layers": [*layers, *own]}


def _layer(place: str, label: str, colour: int) -> dict[str, Any]:
    return {"name": place, "label": label, "colour": f"#{colour:06x}", "paths": [place], "visible": True}


def _is_still(path: str) -> bool:
    return path.split("/")[0] in STILL


def _stands(message: dict[str, Any]) -> bool:
    path = str(message["path"])
    if message["type"] == "set_animation":
        return False
    return not path.startswith(f"{TOP}/") or _is_still(path.removeprefix(f"{TOP}/"))


def _posed(solution: Solution, drawn: Recorder) -> list[ViewerCommand]:
    """The robot that is ``drawn``, again at every pose, translucent; skeletons where its meshes are heavy."""
    own = messages_below(drawn, ROBOT)
    if sum(_bytes(message) for message in own) > HEAVY:
        skeleton = Recorder()
        draw_skeleton(meshcat.Visualizer(window=skeleton), solution)
        own = messages_below(skeleton, ROBOT)
    recorder = Recorder()
    for number in range(MOST_POSES):
        place = f"{TOP}/{POSES}/{number}/"
        for message in own:
            path = place + message["path"].removeprefix(f"{TOP}/")
            recorder.commands.append(ViewerCommand({**message, "path": path}))
            if message["type"] == "set_object":
                shadow = {"type": "set_property", "property": "castShadow", "value": False}
                recorder.commands.append(ViewerCommand({**shadow, "path": f"{path}/<object>"}))
    tint(recorder, POSES, GHOST_COLOUR, GHOST_OPACITY)
    return recorder.commands


def _bytes(part: Any) -> int:
    """Bytes of a message, about: those of its text and binary parts."""
    if isinstance(part, dict):
        return sum(_bytes(value) for value in part.values())
    if isinstance(part, list):
        return sum(_bytes(value) for value in part)
    data = getattr(part, "data", part)
    return len(data) if isinstance(data, bytes | str) else 0


def _move_poses(node: Any, motion: IterateMotion) -> None:
    joints, _, _ = motion.placed(motion.poses())
    for number in range(MOST_POSES):
        node[str(number)].set_property("visible", number < len(joints))
        for joint in range(1, motion.model.njoints if number < len(joints) else 0):
            place = pin.XYZQUATToSE3(joints[number, joint]).homogeneous
            node[str(number)][joint_path(motion.model, joint)].set_transform(place)


def _draw_paths(node: Any, motion: IterateMotion) -> None:
    """The paths of contact frames (of tips where there are none) and of the centre of mass, as lines."""
    names = [motion.model.frames[frame].name.replace("/", "_") for frame in motion.frames]
    paths = [
        (name, motion.points[:, number], PATH_COLOURS[number % len(PATH_COLOURS)])
        for number, name in enumerate(names)
    ]
    for name, points, colour in (*paths, ("centre of mass", motion.mass, MASS_COLOUR)):
        draw_line(node[name], points, colour)


def _animation(vis: Any, motion: IterateMotion) -> ViewerCommand:
    count = len(motion.joints)
    tracks = Animation(count, (count - 1) / motion.duration, reach(motion.model) or 1.0)
    for joint in range(1, motion.model.njoints):
        node = vis[joint_path(motion.model, joint)]
        tracks.add(node, "position", "vector3", motion.joints[:, joint, :3])
        tracks.add(node, "quaternion", "quaternion", motion.joints[:, joint, 3:])
    return tracks.command()


def _times(iterate: Iterate, motion: IterateMotion) -> dict[str, Any]:
    """Start, duration and phases of a motion, whose times may be unknowns."""
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
    found = [(first, "quiet"), (f"iteration {figures['iteration']:.0f}: {state}", kind)]
    if not finite:
        found.append(("no node of this iterate is finite", "failed"))
    found.append((f"objective {figures['objective']:.5g}", "quiet"))
    return [*found, (f"infeasibility {figures['primal']:.1e}, optimality {figures['dual']:.1e}", "quiet")]


def _line(text: str, kind: str) -> dict[str, str]:
    return {"text": text, "kind": kind, "colour": ""}
