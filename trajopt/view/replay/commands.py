"""Messages to a Meshcat viewer: recorded commands and animated properties."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import umsgpack

from trajopt.view.replay.thinning import (
    ANGLE_ERROR,
    COLOUR_ERROR,
    POSITION_ERROR,
    ROUNDING,
    hold_while_hidden,
    rounded,
    thin_key_frames,
)
from trajopt.view.replay.turns import quaternions_of

# Types in three.js of the animated properties.
KINDS = {
    "position": "vector3",
    "scale": "vector3",
    "quaternion": "quaternion",
    "material.color": "color",
    "visible": "boolean",
}
# msgpack extension of a Float32Array, as Meshcat's viewer decodes it.
FLOAT32 = 0x17


@dataclass(frozen=True)
class ViewerCommand:
    """One message to a Meshcat viewer."""

    message: dict[str, Any]

    def lower(self) -> dict[str, Any]:
        """Return the message, for Meshcat's window."""
        return self.message


class Recorder:
    """A Meshcat window that records messages instead of sending them to a server."""

    def __init__(self) -> None:
        self.commands: list[ViewerCommand] = []

    def send(self, command: Any) -> None:
        """Record the command."""
        self.note(command.lower())

    def note(self, message: dict[str, Any]) -> None:
        """Record a message."""
        self.commands.append(ViewerCommand(message))


class Animation:
    """Animated properties by place in the scene tree, given at the same frames and thinned.

    length: m, the robot's extent, the unit of the allowed error of positions and scales.
    """

    def __init__(self, n_frames: int, frame_rate: float, length: float) -> None:
        self._n_frames = n_frames
        self._frame_rate = frame_rate
        self._error = {
            "vector3": POSITION_ERROR * length,
            "quaternion": ANGLE_ERROR,
            "color": COLOUR_ERROR,
            "boolean": 0.0,
        }
        self._clips: dict[str, list[dict[str, Any]]] = {}

    def add(self, node: Any, name: str, values: np.ndarray, shown: np.ndarray | None = None) -> None:
        """Animate property ``name`` (of `KINDS`) of ``node``: a row of ``values`` a frame.

        Vectors, quaternions and colours are interpolated between the frames that `thin_key_frames` keeps,
        within its errors; a boolean holds until the next. ``shown`` (n,): frames at which values matter.
        """
        kind = KINDS[name]
        if shown is not None:
            values = hold_while_hidden(values, shown)
        rows, error = np.asarray(values).reshape(self._n_frames, -1), self._error[kind]
        kept = thin_key_frames(rows, kind, error * (1 - ROUNDING))
        if kind == "boolean":
            packed: Any = rows[kept].ravel().astype(bool).tolist()
        else:
            packed = umsgpack.Ext(FLOAT32, rounded(rows[kept], error).astype(np.float32).tobytes())
        times = umsgpack.Ext(FLOAT32, kept.astype(np.float32).tobytes())
        track = {"name": f".{name}", "type": kind, "times": times, "values": packed}
        self._clips.setdefault(node.path.lower(), []).append(track)

    def place(self, node: Any, placements: np.ndarray) -> None:
        """Animate position and rotation of ``node``: a placement (4, 4) a frame."""
        self.add(node, "position", placements[:, :3, 3])
        self.add(node, "quaternion", quaternions_of(placements[:, :3, :3]))

    def command(self) -> ViewerCommand:
        """Return the message that loads the animation and plays it in a loop."""
        animations = [
            {"path": path, "clip": {"fps": self._frame_rate, "name": "default", "tracks": tracks}}
            for path, tracks in self._clips.items()
        ]
        options = {"play": True, "repetitions": float("inf")}
        return ViewerCommand(
            {"type": "set_animation", "path": "", "animations": animations, "options": options}
        )


def without_shadow(node: Any) -> None:
    """Let the object of ``node`` cast no shadow; Meshcat's own set_property loses the capital of the name."""
    message = {"type": "set_property", "property": "castShadow", "value": False}
    node.window.send(ViewerCommand({**message, "path": node["<object>"].path.lower()}))
