"""Contacts of a replay: forces and impulses as arrows while they act, and their paths as trails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import meshcat.geometry as shapes
import numpy as np
import pinocchio as pin

from trajopt.view.replay.commands import Animation
from trajopt.view.replay.motion import ReplayMotion
from trajopt.view.replay.parts import HIDDEN_OPACITY, UPRIGHT, draw_line, draw_showing_through, placed
from trajopt.view.replay.robot import tip_frames
from trajopt.view.replay.runs import DrawnSolution
from trajopt.view.replay.thinning import hold_while_hidden
from trajopt.view.replay.turns import turns_to

FORCE_COLOUR, IMPULSE_COLOUR = 0xD9421F, 0x7A1FA2
TRAIL_COLOURS = (0x1F77B4, 0x2CA02C, 0x9467BD, 0xC77700)
# Over the robot's extent: largest length of the weight's arrow, and of the longest arrow of the motion.
WEIGHT_ARROW, LONGEST_ARROW = 0.8, 1.2
# Arrow over the robot's extent; a head never takes more than half of its arrow.
SHAFT_RADIUS, HEAD_RADIUS, HEAD_LENGTH = 0.007, 0.02, 0.055
# Forces below this fraction of the weight are not drawn.
LEAST_FORCE = 1e-3


@dataclass(frozen=True, kw_only=True)
class ArrowLook:
    """Look of an arrow: for a robot of ``size`` m, with ``scale`` m a unit of its vector.

    broad: its width over that of a force's arrow.
    """

    size: float
    scale: float
    colour: int
    broad: float = 1.0
    opacity: float = 1.0


def draw_arrows(run: DrawnSolution, tracks: Animation, size: float, weight_arrow: float) -> None:
    """Animate an arrow for each contact's force, and for its impulses (as forces over `FLASH`) if it has any.

    Lengths are proportional to force over weight: ``weight_arrow`` m for the weight. ``size`` is the robot's
    extent, m.
    """
    motion = run.motion
    always = np.ones_like(motion.active)
    kinds = (
        ("forces", motion.pressed, motion.force, motion.active, FORCE_COLOUR),
        ("impulses", motion.struck, motion.impact, always, IMPULSE_COLOUR),
    )
    for contact, frame in enumerate(run.solution.contact_frames):
        for layer, start, vector, active, colour in kinds:
            force = vector[:, contact] / motion.weight
            shown = active[:, contact] & (np.linalg.norm(force, axis=1) > LEAST_FORCE)
            if not shown.any():
                continue
            node = run.node[layer][frame.replace("/", "_")]
            look = ArrowLook(size=size, scale=weight_arrow, colour=run.ink(colour))
            draw_arrow(node, tracks, start[:, contact], force, shown, look)


def draw_arrow(
    node: Any, tracks: Animation, start: np.ndarray, vector: np.ndarray, shown: np.ndarray, look: ArrowLook
) -> None:
    """Animate an arrow from ``start`` (n, 3), m, along a vector (n, 3) while it is ``shown`` (n,)."""
    _draw(node, look)
    length = np.linalg.norm(vector, axis=1) * look.scale
    tracks.add(node, "position", start, shown)
    tracks.add(node, "quaternion", turns_to(vector), shown)
    tracks.add(node, "visible", shown)
    _stretch(node, tracks, hold_while_hidden(length, shown), HEAD_LENGTH * look.size)


def weight_arrow_of(motions: Sequence[ReplayMotion], size: float) -> float:
    """Length in m of the arrow of a weight, the same for all ``motions`` of robots of this ``size`` m."""
    forces = [np.linalg.norm(motion.force, axis=-1)[motion.active] / motion.weight for motion in motions]
    largest = float(np.concatenate([np.zeros(1), *forces]).max())
    return size * (WEIGHT_ARROW if largest <= LONGEST_ARROW / WEIGHT_ARROW else LONGEST_ARROW / largest)


def _stretch(node: Any, tracks: Animation, length: np.ndarray, tip: float) -> None:
    """Give an arrow its length (n,) m; its head is ``tip`` m long, or half of a short arrow."""
    head = np.minimum(1.0, length / (2 * tip))
    neck = length - head * tip
    across = np.zeros_like(neck)
    tracks.add(node["shaft"], "scale", np.column_stack([head, head, neck]))
    tracks.add(node["head"], "scale", np.column_stack([head, head, head]))
    tracks.add(node["head"], "position", np.column_stack([across, across, neck]))


def _draw(node: Any, look: ArrowLook) -> None:
    """Shaft of length one and head, along z; they shine through the robot."""
    tip, width = HEAD_LENGTH * look.size, look.broad * look.size
    parts = {
        "shaft": (shapes.Cylinder(1.0, SHAFT_RADIUS * width), 0.5),
        "head": (shapes.Cylinder(tip, radiusTop=0.0, radiusBottom=HEAD_RADIUS * width), tip / 2),
    }
    glass: dict[str, Any] = {"opacity": look.opacity, "transparent": True} if look.opacity < 1 else {}
    for name, (shape, height) in parts.items():
        draw_showing_through(
            node[name], shape, through=HIDDEN_OPACITY * look.opacity, color=look.colour, **glass
        )
        for part in ("solid", "hidden"):
            node[name][part].set_transform(placed([0.0, 0.0, height], UPRIGHT))


def draw_trails(run: DrawnSolution) -> None:
    """Draw the path of each contact frame; of each tip if there are no contacts."""
    model, names, paths = run.solution.model, list(run.solution.contact_frames), run.motion.feet
    if not names:
        frames = tip_frames(model)
        names = [model.frames[frame].name for frame in frames]
        paths = _frame_paths(model, run.motion, frames)
    for number, name in enumerate(names):
        colour = run.ink(TRAIL_COLOURS[number % len(TRAIL_COLOURS)])
        draw_line(run.node["trails"][name.replace("/", "_")], paths[:, number], colour)


def _frame_paths(model: pin.Model, motion: ReplayMotion, frames: list[int]) -> np.ndarray:
    paths = np.empty((motion.n_frames, len(frames), 3))
    for column, frame in enumerate(frames):
        joint = model.frames[frame].parentJoint
        local = np.append(model.frames[frame].placement.translation, 1.0)
        paths[:, column] = (motion.joints[:, joint] @ local)[:, :3]
    return paths
