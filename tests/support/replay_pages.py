"""A short hop to replay, and what the page of a replay holds, decoded."""

import base64
import gzip
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import umsgpack
from scipy.spatial.transform import Rotation, Slerp

from tests.support.page_meshes import restored
from tests.support.synthetic_motions import Motion, sampled, standing, with_meta
from trajopt.motion.solution import Solution
from trajopt.robot.robot import Robot
from trajopt.terrain.surface import Surface
from trajopt.view.replay.show import replay as show
from trajopt_library import robots

INTERVALS = 3
STANCE, FLIGHT = 0.2, 0.1  # s


def hopping() -> Solution:
    """Solo12, with its meshes, stands, floats where it stood, and stands again."""
    robot = robots.load("solo12")
    stance = standing(robot, STANCE)
    return sampled(
        robot, [stance, flying(robot), stance], INTERVALS, visual=robot.visual.to_meta(), problem="hop"
    )


def flying(robot: Robot) -> Motion:
    still = standing(robot)
    return replace(still, duration=FLIGHT, contacts=(), f=lambda t: np.zeros_like(still.f(t)))


def shown(solution: Solution, tmp_path: Path, **options: float) -> dict:
    show(solution, html=tmp_path / "page.html", **options)
    return scene_of((tmp_path / "page.html").read_text())


def on_surface(solution: Solution, *surfaces: dict[str, Surface]) -> Solution:
    described = [{frame: surface.describe() for frame, surface in phase.items()} for phase in surfaces]
    return with_meta(solution, surfaces=described)


def scene_of(text: str) -> dict:
    packed = re.search(r'<script id="scene"[^>]*>([^<]*)</script>', text).group(1)
    scene = umsgpack.unpackb(gzip.decompress(base64.b64decode(packed)))
    return {**scene, "meshes": [restored(mesh) for mesh in scene["meshes"]]}


def tracks_of(scene: dict) -> dict[tuple[str, str], np.ndarray]:
    """(place, property) -> rows of values, one a frame, as three.js interpolates them."""
    message = next(command for command in scene["commands"] if command["type"] == "set_animation")
    found = {}
    for animation in message["animations"]:
        for track in animation["clip"]["tracks"]:
            key = (animation["path"].removeprefix("/meshcat/"), track["name"].removeprefix("."))
            found[key] = _every_frame(track)
    return found


def _every_frame(track: dict) -> np.ndarray:
    """Values (n, d) of a track at every frame from its key frames."""
    at, values = np.frombuffer(track["times"].data, np.float32).astype(int), track["values"]
    assert at[0] == 0
    frames = np.arange(at[-1] + 1)
    if track["type"] == "boolean":
        return np.array(values)[np.searchsorted(at, frames, side="right") - 1, None]
    rows = np.frombuffer(values.data, np.float32).astype(float).reshape(len(at), -1)
    if track["type"] == "quaternion":
        return Slerp(at, Rotation.from_quat(rows))(frames).as_quat()
    return np.column_stack([np.interp(frames, at, column) for column in rows.T])


def key_frames_of(scene: dict) -> dict[tuple[str, str], int]:
    """(place, property) -> number of key frames."""
    message = next(command for command in scene["commands"] if command["type"] == "set_animation")
    return {
        (animation["path"].removeprefix("/meshcat/"), track["name"].removeprefix(".")): len(
            track["times"].data
        )
        // 4
        for animation in message["animations"]
        for track in animation["clip"]["tracks"]
    }


def objects_of(scene: dict) -> dict[str, dict]:
    return {
        command["path"].removeprefix("/meshcat/"): command["object"]
        for command in scene["commands"]
        if command["type"] == "set_object"
    }


def placements_of(scene: dict) -> dict[str, np.ndarray]:
    """Place -> homogeneous matrix (4, 4) of every part that is placed once."""
    return {
        command["path"].removeprefix("/meshcat/"): np.reshape(command["matrix"], (4, 4)).T
        for command in scene["commands"]
        if command["type"] == "set_transform"
    }
