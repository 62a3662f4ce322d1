"""Iterates as Meshcat commands: the scene once, then poses, paths, a caption and the animation."""

from __future__ import annotations

import copy
import io
from typing import Any

import meshcat
import meshcat.geometry as shapes
import numpy as np
import pinocchio as pin
from PIL import Image, ImageDraw, ImageFont

from trajopt.errors import TrajoptError
from trajopt.replay.commands import Command, Recorder, Tracks, without_shadow
from trajopt.replay.motion import motion_of
from trajopt.replay.robot import draw_robot, draw_skeleton, joint_path, tip_frames
from trajopt.replay.scene import build_scene
from trajopt.robot_building import reach
from trajopt.solution import Solution
from trajopt.watching.iterate import Iterate
from trajopt.watching.motion import FRAME_RATE, MOST_POSES, Motion

TOP = "/meshcat"
ROBOT, POSES, PATHS, CAPTION = "robot", "poses", "paths", "caption"
# What a scene of the guess has that iterates do not move.
STILL = (ROBOT, "ground", "terrain", "surfaces", "obstacles", "goals")
# How much of the poses along the motion is seen.
POSE_OPACITY = 0.22
# Bytes of the robot's meshes from which further poses are skeletons: a browser holds each pose's own.
HEAVY = 8_000_000
# Colours of paths, of feet in turn, and of the centre of mass.
PATH_COLOURS, MASS_COLOUR = (0x1F77B4, 0x2CA02C, 0x9467BD, 0xC77700), 0x303438
# The caption: letters' height in pixels, of the plane over the robot's length, and how far above it stands.
LETTERS, LINE_HEIGHT, ABOVE = 32, 0.07, 1.0


class IterateScene:
    """Commands that show iterates of one problem after another in a Meshcat viewer."""

    def __init__(self) -> None:
        self._problem: Any = None
        self._model: pin.Model | None = None
        self._frames: list[int] = []
        self._caption = np.eye(4)
        self._letters = 1.0
        self.note = ""

    def commands(self, iterate: Iterate, *, animated: bool) -> list[Command]:
        """What the viewer is told of an iterate; of the first one of a problem the whole scene, too.

        animated: load its motion into the animation, which begins anew. An iterate none of whose nodes is
        finite changes the caption alone.
        """
        t, q, phase = iterate.configurations()
        recorder = Recorder()
        if len(t) and iterate.transcription.problem is not self._problem:
            self._begin(iterate, recorder)
        vis = meshcat.Visualizer(window=recorder)
        if self._model is None:
            return recorder.commands
        if len(t):
            motion = Motion(model=self._model, t=t, q=q, phase=phase, frames=self._frames)
            self._draw_poses(vis, motion)
            _draw_paths(vis[PATHS], motion)
            if animated:
                recorder.commands.append(_animation(vis, motion))
        self._draw_caption(vis[CAPTION], iterate, bool(len(t)))
        return recorder.commands

    def _begin(self, iterate: Iterate, recorder: Recorder) -> None:
        """The scene of a problem: its robot, ground, obstacles, light and camera; poses to be moved."""
        solution = iterate.solution()
        model = self._model = solution.model
        named = [model.getFrameId(name) for name in solution.contact_frames]
        self._problem, self._frames = iterate.transcription.problem, named or tip_frames(model)
        still, self.note, size, box = _still(solution)
        recorder.commands += [Command({"type": "delete", "path": TOP}), *still]
        recorder.commands += _posed(solution, still)
        self._letters = LINE_HEIGHT * size
        middle = np.array([*(box[0, :2] + box[1, :2]) / 2, box[0, 2] + ABOVE * size + self._letters])
        facing = pin.SE3(pin.utils.rotate("x", np.pi / 2), np.array([*middle[:2], max(middle[2], box[1, 2])]))
        self._caption = facing.homogeneous

    def _draw_poses(self, vis: Any, motion: Motion) -> None:
        joints, _, _ = motion.placed(motion.poses())
        for number in range(MOST_POSES):
            node = vis[POSES][str(number)]
            node.set_property("visible", number < len(joints))
            if number < len(joints):
                for joint in range(1, motion.model.njoints):
                    place = pin.XYZQUATToSE3(joints[number, joint]).homogeneous
                    node[joint_path(motion.model, joint)].set_transform(place)

    def _draw_caption(self, node: Any, iterate: Iterate, finite: bool) -> None:
        image = _caption(_words(iterate, finite))
        height = self._letters * image.height / LETTERS
        sides = [height * image.width / image.height, height]
        data = io.BytesIO()
        image.save(data, "png")
        texture = shapes.ImageTexture(shapes.PngImage(data.getvalue()))
        material = shapes.MeshBasicMaterial(map=texture, transparent=True, side=2)
        node.set_object(_Plane(*sides), material)
        without_shadow(node)
        node.set_transform(self._caption)


class _Plane(shapes.Geometry):
    """A rectangle ``width`` by ``height`` (m) around the origin, facing along z."""

    def __init__(self, width: float, height: float) -> None:
        super().__init__()
        self._sides = {"width": width, "height": height}

    def lower(self, object_data: Any) -> dict[str, Any]:
        """Return the geometry in the JSON of three.js."""
        return {"uuid": self.uuid, "type": "PlaneGeometry", **self._sides}


def _still(solution: Solution) -> tuple[list[Command], str, float, np.ndarray]:
    """What does not move with iterates, as a replay draws it; a note, size (m) and box (2, 3) m.

    A motion that no replay can show has its robot alone.
    """
    try:
        with np.errstate(all="ignore"):
            scene = build_scene([solution], [motion_of(solution)])
    except (TrajoptError, ArithmeticError, ValueError) as error:
        recorder = Recorder()
        drawn = draw_robot(meshcat.Visualizer(window=recorder), solution)
        size = reach(solution.model) or 1.0
        note = drawn.note or f"the robot is drawn without its surroundings: {error}"
        return recorder.commands, note, size, np.array([[-size] * 3, [size] * 3])
    kept = [command for command in scene.commands if _stands(command.message)]
    return kept, scene.note, scene.facts["size"], np.array(scene.facts["box"])


def _stands(message: dict[str, Any]) -> bool:
    if message["type"] == "set_animation":
        return False
    path = str(message["path"])
    if not path.startswith(f"{TOP}/"):
        return True
    return path.removeprefix(f"{TOP}/").split("/")[0] in STILL


def _posed(solution: Solution, still: list[Command]) -> list[Command]:
    """The robot again at every pose, translucent; as skeletons where its meshes are heavy."""
    start = f"{TOP}/{ROBOT}"
    own = [command.message for command in still if command.message["path"].startswith(f"{start}/")]
    if sum(_bytes(message) for message in own) > HEAVY:
        recorder = Recorder()
        draw_skeleton(meshcat.Visualizer(window=recorder), solution)
        own = [command.message for command in recorder.commands]
    found = []
    for number in range(MOST_POSES):
        for message in own:
            moved = _translucent(message) if message["type"] == "set_object" else dict(message)
            moved["path"] = f"{TOP}/{POSES}/{number}/{ROBOT}" + message["path"].removeprefix(start)
            found.append(Command(moved))
    return found


def _bytes(message: dict[str, Any]) -> int:
    """Bytes of a message's geometry, about: those of its binary parts."""

    def size(part: Any) -> int:
        if isinstance(part, dict):
            return sum(size(value) for value in part.values())
        if isinstance(part, list):
            return sum(size(value) for value in part)
        data = getattr(part, "data", part)
        return len(data) if isinstance(data, bytes | str) else 0

    return size(message)


def _translucent(message: dict[str, Any]) -> dict[str, Any]:
    """A set_object whose materials let most light through; the geometry's data is shared."""
    held = message["object"]
    materials = [copy.copy(material) for material in held.get("materials", [])]
    for material in materials:
        material |= {"opacity": POSE_OPACITY, "transparent": True, "depthWrite": False}
    return {**message, "object": {**held, "materials": materials}}


def _draw_paths(node: Any, motion: Motion) -> None:
    """The paths of contact frames (of tips where there are none) and of the centre of mass, as lines."""
    names = [motion.model.frames[frame].name.replace("/", "_") for frame in motion.frames]
    paths = [
        (name, motion.points[:, number], PATH_COLOURS[number % len(PATH_COLOURS)])
        for number, name in enumerate(names)
    ]
    for name, points, colour in (*paths, ("centre_of_mass", motion.mass, MASS_COLOUR)):
        line = shapes.PointsGeometry(position=points.T.astype(np.float32))
        node[name].set_object(shapes.Line(line, shapes.LineBasicMaterial(color=colour)))
        without_shadow(node[name])


def _animation(vis: Any, motion: Motion) -> Command:
    count = len(motion.joints)
    lasts = max(float(motion.t[-1] - motion.t[0]), 1 / FRAME_RATE)
    tracks = Tracks(count, (count - 1) / lasts, reach(motion.model) or 1.0)
    for joint in range(1, motion.model.njoints):
        node = vis[joint_path(motion.model, joint)]
        tracks.add(node, "position", "vector3", motion.joints[:, joint, :3])
        tracks.add(node, "quaternion", "quaternion", motion.joints[:, joint, 3:])
    return tracks.command()


def _words(iterate: Iterate, finite: bool) -> list[str]:
    """The caption: which solve, which iteration, its figures."""
    problem = iterate.transcription.problem.name
    first = " · ".join(part for part in (problem, iterate.label, iterate.grid) if part)
    if iterate.stage == "guess":
        return [first, "the guess"]
    figures = iterate.figures
    state = iterate.status or ("restoring feasibility" if figures.get("restoration") else "solving")
    second = f"iteration {figures['iteration']:.0f}, {state}" + ("" if finite else ", not finite")
    third = f"objective {figures['objective']:.5g}   infeasibility {figures['primal']:.0e}"
    return [first, second, f"{third}   optimality {figures['dual']:.0e}"]


def _caption(lines: list[str]) -> Image.Image:
    """Lines of dark text on nothing."""
    font = ImageFont.load_default(LETTERS)
    pen = ImageDraw.Draw(Image.new("RGBA", (1, 1)))
    text = "\n".join(lines)
    _, _, right, bottom = pen.multiline_textbbox((0, 0), text, font=font)
    image = Image.new("RGBA", (int(right) + LETTERS, int(bottom) + LETTERS), (0, 0, 0, 0))
    pen = ImageDraw.Draw(image)
    pen.multiline_text((LETTERS // 2, LETTERS // 2), text, font=font, fill=(30, 34, 40, 255), align="center")
    return image
