"""Arrows of a replay: contact forces while they act, impulses of impacts as a flash in another colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import meshcat.geometry as shapes
import numpy as np
import pinocchio as pin

from trajopt.solution.solution import Solution
from trajopt.view.replay.commands import Animation
from trajopt.view.replay.motion import ReplayMotion
from trajopt.view.replay.parts import draw_showing_through
from trajopt.view.replay.thinning import hold_while_hidden
from trajopt.view.replay.turns import turns_to

FORCE_COLOUR, IMPULSE_COLOUR = 0xD9421F, 0x7A1FA2
# An arrow of the robot's weight is at most this part of the robot's largest extent long, and so long that the
# longest arrow of the motion is no longer than that.
WEIGHT_ARROW, LONGEST_ARROW = 0.8, 1.2
# Arrow over the robot's extent; a head never takes more than half of its arrow.
SHAFT_RADIUS, HEAD_RADIUS, HEAD_LENGTH = 0.007, 0.02, 0.055
# Forces below this part of the weight are not drawn.
LEAST_FORCE = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class _Arrow:
    """One arrow at n frames: start (n, 3) m, force (n, 3) over the weight, shown (n,)."""

    start: np.ndarray
    force: np.ndarray
    shown: np.ndarray
    colour: int


def draw_arrows(
    vis: Any,
    tracks: Animation,
    solution: Solution,
    motion: ReplayMotion,
    size: float,
    weight_arrow: float,
    tint: int | None = None,
) -> None:
    """Animate an arrow for each contact's force, and for its impulses (as forces over `FLASH`) if it has any.

    Lengths are proportional to force over weight: ``weight_arrow`` m for the weight. ``size`` is the robot's
    extent, m. ``tint`` is the colour of both for a robot laid over another.
    """
    colour = FORCE_COLOUR if tint is None else tint
    for contact, frame in enumerate(solution.contact_frames):
        place = frame.replace("/", "_")
        force, impact = motion.force[:, contact] / motion.weight, motion.impact[:, contact] / motion.weight
        shown = motion.active[:, contact] & (np.linalg.norm(force, axis=1) > LEAST_FORCE)
        push = _Arrow(start=motion.pressed[:, contact], force=force, shown=shown, colour=colour)
        _animate(vis["forces"][place], tracks, push, size, weight_arrow)
        colour_of_blow = IMPULSE_COLOUR if tint is None else tint
        shown = np.linalg.norm(impact, axis=1) > LEAST_FORCE
        if shown.any():
            blow = _Arrow(start=motion.struck[:, contact], force=impact, shown=shown, colour=colour_of_blow)
            _animate(vis["impulses"][place], tracks, blow, size, weight_arrow)


def weight_arrow_of(motions: Sequence[ReplayMotion], size: float) -> float:
    """Length in m of the arrow of a weight, the same for all ``motions`` of robots of this ``size`` m."""
    forces = [np.linalg.norm(motion.force, axis=-1)[motion.active] / motion.weight for motion in motions]
    largest = float(np.concatenate([np.zeros(1), *forces]).max())
    return size * (WEIGHT_ARROW if largest <= LONGEST_ARROW / WEIGHT_ARROW else LONGEST_ARROW / largest)


def _animate(node: Any, tracks: Animation, arrow: _Arrow, size: float, weight_arrow: float) -> None:
    if not arrow.shown.any():
        return
    length = hold_while_hidden(np.linalg.norm(arrow.force, axis=1)[:, None] * weight_arrow, arrow.shown)[:, 0]
    head = np.minimum(1.0, length / (2 * HEAD_LENGTH * size))
    neck = length - head * HEAD_LENGTH * size
    across = np.zeros_like(neck)
    _draw(node, size, arrow.colour)
    tracks.add(node, "position", "vector3", hold_while_hidden(arrow.start, arrow.shown))
    tracks.add(node, "quaternion", "quaternion", hold_while_hidden(turns_to(arrow.force), arrow.shown))
    tracks.add(node, "visible", "boolean", arrow.shown)
    tracks.add(node["shaft"], "scale", "vector3", np.column_stack([head, head, neck]))
    tracks.add(node["head"], "scale", "vector3", np.column_stack([head, head, head]))
    tracks.add(node["head"], "position", "vector3", np.column_stack([across, across, neck]))


def _draw(node: Any, size: float, colour: int) -> None:
    """Shaft of length one and head, along z; where the robot hides them, they shine through."""
    tip = HEAD_LENGTH * size
    parts = {
        "shaft": (shapes.Cylinder(1.0, SHAFT_RADIUS * size), 0.5),
        "head": (shapes.Cylinder(tip, radiusTop=0.0, radiusBottom=HEAD_RADIUS * size), tip / 2),
    }
    upright = pin.utils.rotate("x", np.pi / 2)  # Meshcat's cylinders lie along y
    for name, (shape, height) in parts.items():
        draw_showing_through(node[name], shape, color=colour)
        for part in ("solid", "hidden"):
            node[name][part].set_transform(pin.SE3(upright, np.array([0.0, 0.0, height])).homogeneous)
