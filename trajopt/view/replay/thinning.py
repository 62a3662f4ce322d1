"""Fewer key frames: those that the viewer's interpolation reproduces within a given error are left out."""

from __future__ import annotations

import numpy as np

# Largest error of thinned tracks: positions and scales over the robot's extent, angles in rad (0.03 degrees).
POSITION_ERROR = 2e-4
ANGLE_ERROR = 5e-4
# For red, green and blue from 0 to 1: less than a step of an 8-bit screen.
COLOUR_ERROR = 2e-3
# Values are rounded to a power of two this many times finer than their error: noise does not compress.
FINER = 8.0
# Largest share of rounding in the error: half a step in each of a quaternion's four numbers is a step,
# and twice that as an angle.
ROUNDING = 2.0 / FINER


def thin_key_frames(values: np.ndarray, kind: str, error: float) -> np.ndarray:
    """Indices (k,) of the frames of ``values`` (n, d) to keep, the first and the last always among them.

    Between those kept a linear track ("vector3", "color") stays within ``error`` of every frame left out, a
    "quaternion" one, interpolated on great circles, within ``error`` rad, and a "boolean" one, which holds
    each value until the next, changes exactly. Segments are halved until they are accurate enough.
    """
    n = len(values)
    if kind == "boolean":
        changes = np.flatnonzero(np.any(values[1:] != values[:-1], axis=1)) + 1
        return np.unique([0, *changes, n - 1])
    kept = {0, n - 1}
    segments = np.array([[0, n - 1]])
    while len(segments := segments[segments[:, 1] - segments[:, 0] > 1]):
        bad = segments[_worst(values, segments, kind) > error]
        middle = (bad[:, 0] + bad[:, 1]) // 2
        kept.update(middle.tolist())
        halves = [np.column_stack([bad[:, 0], middle]), np.column_stack([middle, bad[:, 1]])]
        segments = np.concatenate(halves)
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
        errors = _angles(slerp(first, last, part), values[inner])
    else:
        errors = np.linalg.norm((1 - part) * first + part * last - values[inner], axis=1)
    return np.asarray(np.maximum.reduceat(errors, starts))


def slerp(first: np.ndarray, last: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Quaternions (n, 4) at ``part`` (n, 1) of the shorter great circle between two (n, 4)."""
    cosine = np.sum(first * last, axis=1, keepdims=True)
    last, cosine = np.where(cosine < 0, -last, last), np.minimum(np.abs(cosine), 1.0)
    angle = np.arccos(cosine)
    sine = np.sin(angle)
    close = sine < 1e-6
    safe = np.where(close, 1.0, sine)
    weight = np.where(close, 1 - part, np.sin((1 - part) * angle) / safe)
    other = np.where(close, part, np.sin(part * angle) / safe)
    return np.asarray(weight * first + other * last)


def _angles(first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Angle (n,) of the rotation between unit quaternions (n, 4), rad, exact for small ones."""
    apart = np.minimum(np.linalg.norm(first - last, axis=1), np.linalg.norm(first + last, axis=1))
    return np.asarray(4 * np.arcsin(np.minimum(apart / 2, 1.0)))


def rounded(values: np.ndarray, error: float) -> np.ndarray:
    """Values to the nearest multiple of a power of two that is `FINER` times below ``error``."""
    step = 2.0 ** np.floor(np.log2(error / FINER))
    return np.asarray(np.round(values / step) * step)


def hold_while_hidden(values: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """Rows (n, ...) held at the last ``shown`` (n,) value while hidden, so that they need no frames."""
    if not shown.any():
        return np.repeat(values[:1], len(values), axis=0)
    index = np.where(shown, np.arange(len(values)), -1)
    index = np.maximum.accumulate(index)
    return np.asarray(values[np.where(index < 0, np.argmax(shown), index)])
