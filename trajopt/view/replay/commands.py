"""Messages to a Meshcat viewer: recorded commands, and animated properties in few key frames."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import umsgpack

# Largest error of thinned tracks: positions and scales over the robot's extent, angles in rad (0.03 degrees).
POSITION_ERROR, ANGLE_ERROR = 2e-4, 5e-4
# For red, green and blue from 0 to 1: less than a step of an 8-bit screen.
COLOUR_ERROR = 2e-3
# Values are rounded to a power of two this many times finer than their error: noise does not compress.
FINER = 8.0
# Share of the error that rounding may take: half a step in each of a quaternion's four numbers is one step in
# all, and twice that as an angle.
ROUNDING = 2.0 / FINER
# A unit vector with a z component below this points straight down.
DOWN = -1 + 1e-12
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
    """Animated properties by place in the scene tree, sampled at common frames and thinned.

    ``length`` is the robot's extent, m, to which allowed errors of positions and scales refer.
    """

    def __init__(self, n_frames: int, frame_rate: float, length: float) -> None:
        self._n_frames, self._frame_rate = n_frames, frame_rate
        errors = {"quaternion": ANGLE_ERROR, "color": COLOUR_ERROR, "boolean": 0.0}
        self._error = {"vector3": POSITION_ERROR * length, **errors}
        self._clips: dict[str, list[dict[str, Any]]] = {}

    def add(self, node: Any, name: str, values: np.ndarray, shown: np.ndarray | None = None) -> None:
        """Animate property ``name`` (of `KINDS`) of ``node``: one row of ``values`` per frame.

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

    def show(self, node: Any, shown: np.ndarray, **values: np.ndarray) -> None:
        """Animate properties of ``node`` by name, and show it while ``shown`` (n,)."""
        for name, rows in values.items():
            self.add(node, name, rows, shown)
        self.add(node, "visible", shown)

    def place(self, node: Any, placements: np.ndarray) -> None:
        """Animate position and rotation of ``node``: one placement (4, 4) per frame."""
        self.add(node, "position", placements[:, :3, 3])
        self.add(node, "quaternion", quaternions(placements[:, :3, :3]))

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
    """Make the object of ``node`` cast no shadow; Meshcat's set_property loses the capital of the name."""
    message = {"type": "set_property", "property": "castShadow", "value": False}
    node.window.send(ViewerCommand({**message, "path": node["<object>"].path.lower()}))


def quaternions(rotations: np.ndarray) -> np.ndarray:
    """Quaternions (n, 4), in the order of three.js, of rotation matrices (n, 3, 3).

    They are the normalised longest column of 4 q q^T, which is linear in the matrix.
    """
    (a, b, c), (d, e, f), (g, h, i) = np.moveaxis(rotations, 0, 2)
    columns = [
        [1 + a - e - i, b + d, c + g, h - f],
        [b + d, 1 - a + e - i, f + h, c - g],
        [c + g, f + h, 1 - a - e + i, d - b],
        [h - f, c - g, d - b, 1 + a + e + i],
    ]
    products = np.moveaxis(np.array(columns), 2, 0)
    longest = np.argmax(np.einsum("nii->ni", products), axis=1)
    found = products[np.arange(len(products)), longest]
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


def turns_to(directions: np.ndarray) -> np.ndarray:
    """Quaternions (n, 4), in the order of three.js, of the least rotations from z to directions (n, 3).

    The identity for zero vectors.
    """
    length = np.linalg.norm(directions, axis=1, keepdims=True)
    unit = np.divide(directions, length, out=np.tile([0.0, 0.0, 1.0], (len(length), 1)), where=length > 0)
    down = unit[:, 2] <= DOWN
    half = np.column_stack([-unit[:, 1], unit[:, 0], np.zeros(len(unit)), 1 + unit[:, 2]])
    half[down] = [1.0, 0.0, 0.0, 0.0]
    return np.asarray(half / np.linalg.norm(half, axis=1, keepdims=True))


def thin_key_frames(values: np.ndarray, kind: str, error: float) -> np.ndarray:
    """Indices (k,) of the frames of ``values`` (n, d) to keep, the first and the last always among them.

    Interpolated between the frames kept, a linear track ("vector3", "color") stays within ``error`` of all
    others, and a "quaternion" track, on great circles, within ``error`` rad. A "boolean" track, which holds
    each value until the next, is exact. Segments are halved until they are accurate enough.
    """
    n = len(values)
    if kind == "boolean":
        changes = np.flatnonzero(np.any(values[1:] != values[:-1], axis=1)) + 1
        return np.unique([0, *changes, n - 1])
    kept = {0, n - 1}
    segments = np.array([[0, n - 1]])
    while len(segments := segments[segments[:, 1] - segments[:, 0] > 1]):
        first, last = segments[_worst(values, segments, kind) > error].T
        middle = (first + last) // 2
        kept.update(middle.tolist())
        segments = np.concatenate([np.column_stack([first, middle]), np.column_stack([middle, last])])
    return np.array(sorted(kept))


def _worst(values: np.ndarray, segments: np.ndarray, kind: str) -> np.ndarray:
    """Largest error (s,) of the frames inside segments [first, last] (s, 2) interpolated from their ends."""
    counts = segments[:, 1] - segments[:, 0] - 1
    owner = np.repeat(np.arange(len(segments)), counts)
    starts = np.cumsum(counts) - counts
    inner = np.arange(counts.sum()) - starts[owner] + segments[owner, 0] + 1
    first, last = values[segments[owner, 0]], values[segments[owner, 1]]
    part = ((inner - segments[owner, 0]) / (counts[owner] + 1))[:, None]
    if kind == "quaternion":
        turned = slerp(first, last, part)
        apart = [np.linalg.norm(turned + sign * values[inner], axis=1) for sign in (-1, 1)]
        errors = 4 * np.arcsin(np.minimum(np.minimum(*apart) / 2, 1.0))  # exact for small angles
    else:
        errors = np.linalg.norm((1 - part) * first + part * last - values[inner], axis=1)
    return np.asarray(np.maximum.reduceat(errors, starts))


def slerp(first: np.ndarray, last: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Quaternions (n, 4) at fraction ``part`` (n, 1) of the shorter great circle between two (n, 4)."""
    cosine = np.sum(first * last, axis=1, keepdims=True)
    last, cosine = np.where(cosine < 0, -last, last), np.minimum(np.abs(cosine), 1.0)
    angle = np.arccos(cosine)
    sine = np.sin(angle)
    close = sine < 1e-6
    safe = np.where(close, 1.0, sine)
    weight = np.where(close, 1 - part, np.sin((1 - part) * angle) / safe)
    other = np.where(close, part, np.sin(part * angle) / safe)
    return np.asarray(weight * first + other * last)


def rounded(values: np.ndarray, error: float) -> np.ndarray:
    """Values rounded to a multiple of a power of two at least `FINER` times below ``error``."""
    step = 2.0 ** np.floor(np.log2(error / FINER))
    return np.asarray(np.round(values / step) * step)


def hold_while_hidden(values: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """Rows (n, ...) held at the last ``shown`` (n,) value while hidden, so that they need no frames."""
    if not shown.any():
        return np.repeat(values[:1], len(values), axis=0)
    index = np.maximum.accumulate(np.where(shown, np.arange(len(values)), -1))
    return np.asarray(values[np.where(index < 0, np.argmax(shown), index)])
