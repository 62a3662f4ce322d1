"""Copies of drawn objects: ghosts of a robot at other times, and robots in their solution's colour."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from typing import Any

import numpy as np

from trajopt.view.replay.commands import Recorder, ViewerCommand
from trajopt.view.replay.motion import ReplayMotion
from trajopt.view.replay.runs import DrawnSolution

PREFIX = "/meshcat/"
TINT_OPACITY = 0.55
GHOST_COLOUR, GHOST_OPACITY = 0x5F7FA6, 0.2
# Most ghosts, and the least distance between any two of some point of the robot, over its extent.
MOST_GHOSTS, APART = 6, 0.35
# Most changes of phase that are considered in a long gait.
MOST_COMPARED = 40


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
    """The message of an object with its geometry, shared, and another material.

    ``behind``: where it coincides with another object, that one is visible.
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
    drawn = {key: value for key, value in content["object"].items() if key not in ("material", "data")}
    drawn |= {"uuid": str(uuid.uuid4()), "material": material["uuid"]}
    geometries = content.get("geometries", [])
    if content["object"]["type"] == "_meshfile_object":  # a file with its own materials: its geometry alone
        kept = {key: content["object"][key] for key in ("format", "data")}
        geometries = [{"uuid": str(uuid.uuid4()), "type": "_meshfile_geometry", **kept}]
        drawn = {
            "uuid": str(uuid.uuid4()),
            "type": "Mesh",
            "geometry": geometries[0]["uuid"],
            "material": material["uuid"],
            "matrix": content["object"].get("matrix", np.eye(4).ravel().tolist()),
        }
    rest = {key: value for key, value in content.items() if key not in ("materials", "textures", "images")}
    return {**message, "object": {**rest, "geometries": geometries, "materials": [material], "object": drawn}}


def draw_ghosts(
    recorder: Recorder, run: DrawnSolution, joints: Sequence[tuple[int, str]], frames: list[int]
) -> None:
    """Draw translucent copies of a run's robot as it is at ``frames``; ``joints`` with their paths in it."""
    drawn = messages_below(recorder, run.path("robot"))
    for number, frame in enumerate(frames):
        ghost = f"{run.path('ghosts')}/pose{number}"
        for joint, place in joints:
            matrix = run.motion.joints[frame, joint].T.ravel().tolist()
            path = f"{PREFIX}{ghost}/{place.removeprefix('robot/')}"
            recorder.note({"type": "set_transform", "path": path, "matrix": matrix})
        draw_copy(recorder, drawn, run.path("robot"), ghost, run.ink(GHOST_COLOUR))


def ghost_frames(motion: ReplayMotion, size: float) -> list[int]:
    """Frames of the start, the changes of phase and the end whose poses differ, spread if they are many."""
    changes = (np.flatnonzero(np.diff(motion.phase)) + 1).tolist()
    wanted = _spread([0, *changes, motion.n_frames - 1], MOST_COMPARED)
    kept: list[int] = []
    for frame in wanted:
        place = motion.joints[frame, 1:, :3, 3]
        ways = [np.linalg.norm(motion.joints[other, 1:, :3, 3] - place, axis=1) for other in kept]
        if all(way.max(initial=0.0) > APART * size for way in ways):
            kept.append(frame)
    return _spread(kept, MOST_GHOSTS)


def _spread(frames: list[int], most: int) -> list[int]:
    """At most that many of the frames, evenly chosen, with the first and the last."""
    chosen = np.linspace(0, len(frames) - 1, min(len(frames), most)).round().astype(int)
    return [frames[index] for index in np.unique(chosen)]
