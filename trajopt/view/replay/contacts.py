"""Contacts of a replay: arrows of forces and impulses, friction cones, and the contacts' paths as trails."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import meshcat.geometry as shapes
import numpy as np

from trajopt.view.replay import parts
from trajopt.view.replay.commands import Animation, hold_while_hidden, turns_to
from trajopt.view.replay.motion import LEAST_PRESSURE, ReplayMotion
from trajopt.view.replay.robot import tip_frames
from trajopt.view.replay.runs import DrawnSolution

FORCE_COLOUR, IMPULSE_COLOUR = 0xD9421F, 0x7A1FA2
TRAIL_COLOURS = (0x1F77B4, 0x2CA02C, 0x9467BD, 0xC77700)
# Over the robot's extent: largest length of the weight's arrow, and of any arrow of the motion.
WEIGHT_ARROW, LONGEST_ARROW = 0.8, 1.2
# Arrow over the robot's extent; a head never takes more than half of its arrow.
SHAFT_RADIUS, HEAD_RADIUS, HEAD_LENGTH = 0.007, 0.02, 0.055
# Forces below this fraction of the weight are not drawn.
LEAST_FORCE = 1e-3
# Length of a cone's side over the robot's extent; half angle, axis and apex are to scale.
SIDE = 0.16
OPACITY = 0.3
# Colour by the share of friction used: |f_t| / (mu f_n) is 0 along the axis and 1 on the cone.
USED = (0.0, 0.6, 0.85, 1.0)
COLOURS = (0x3C93C2, 0x3C93C2, 0xF0A202, 0xB0170B)
ROUND, RIBS = 24, 8


@dataclass(frozen=True, kw_only=True)
class ArrowLook:
    """Look of an arrow, for a robot of ``size`` m; ``scale`` is its length per unit of the vector, m.

    ``broad`` is its width over that of a force's arrow.
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
    kinds = (
        ("forces", motion.wrench, motion.active, FORCE_COLOUR),
        ("impulses", motion.impact, np.ones_like(motion.active), IMPULSE_COLOUR),
    )
    starts = [motion.pressed(wrench) for _, wrench, *_ in kinds]
    for contact, frame in enumerate(run.solution.contact_frames):
        for start, (layer, wrench, active, colour) in zip(starts, kinds, strict=True):
            force = wrench[:, contact, :3] / motion.weight
            shown = active[:, contact] & (np.linalg.norm(force, axis=1) > LEAST_FORCE)
            look = ArrowLook(size=size, scale=weight_arrow, colour=run.ink(colour))
            node = run.node[layer][frame.replace("/", "_")]
            draw_arrow(node, tracks, start[:, contact], force, shown, look)


def draw_arrow(
    node: Any, tracks: Animation, start: np.ndarray, vector: np.ndarray, shown: np.ndarray, look: ArrowLook
) -> None:
    """Animate an arrow from ``start`` (n, 3), m, along a vector (n, 3) while it is ``shown`` (n,)."""
    if not shown.any():
        return
    tip, width = HEAD_LENGTH * look.size, look.broad * look.size
    shapes_of_parts = {
        "shaft": (shapes.Cylinder(1.0, SHAFT_RADIUS * width), 0.5),
        "head": (shapes.Cylinder(tip, radiusTop=0.0, radiusBottom=HEAD_RADIUS * width), tip / 2),
    }
    glass: dict[str, Any] = {"opacity": look.opacity, "transparent": True} if look.opacity < 1 else {}
    through = parts.HIDDEN_OPACITY * look.opacity
    for name, (shape, height) in shapes_of_parts.items():  # along z; the shaft's length is one
        parts.draw_showing_through(node[name], shape, through=through, color=look.colour, **glass)
        for part in ("solid", "hidden"):
            node[name][part].set_transform(parts.placed([0.0, 0.0, height], parts.UPRIGHT))
    tracks.show(node, shown, position=start, quaternion=turns_to(vector))
    length = hold_while_hidden(np.linalg.norm(vector, axis=1) * look.scale, shown)
    head = np.minimum(1.0, length / (2 * tip))  # at most half of a short arrow
    neck, across = length - head * tip, np.zeros_like(length)
    tracks.add(node["shaft"], "scale", np.column_stack([head, head, neck]))
    tracks.add(node["head"], "scale", np.column_stack([head, head, head]))
    tracks.add(node["head"], "position", np.column_stack([across, across, neck]))


def weight_arrow_of(motions: Sequence[ReplayMotion], size: float) -> float:
    """Length of the arrow of the weight, m, common to all ``motions`` of robots of extent ``size``, m."""
    forces = [np.linalg.norm(motion.force, axis=-1)[motion.active] / motion.weight for motion in motions]
    largest = float(np.concatenate([np.zeros(1), *forces]).max())
    return size * (WEIGHT_ARROW if largest <= LONGEST_ARROW / WEIGHT_ARROW else LONGEST_ARROW / largest)


def draw_trails(run: DrawnSolution) -> None:
    """Draw the path of each contact frame, or of each tip if there are no contacts."""
    model, motion = run.solution.model, run.motion
    named = dict(zip(run.solution.contact_frames, motion.feet.swapaxes(0, 1), strict=True))
    for frame in [] if named else [model.frames[number] for number in tip_frames(model)]:
        tip = np.append(frame.placement.translation, 1.0)
        named[frame.name] = (motion.joints[:, frame.parentJoint] @ tip)[:, :3]
    for number, (name, path) in enumerate(named.items()):
        colour = run.ink(TRAIL_COLOURS[number % len(TRAIL_COLOURS)])
        parts.draw_line(run.node["trails"][name.replace("/", "_")], path, colour)


def draw_cones(run: DrawnSolution, tracks: Animation, size: float) -> None:
    """Animate the friction cone of every unilateral contact while it is active.

    A contact on a bilateral surface has none, as its force is free.
    """
    motion, touched = run.motion, run.motion.touched
    shown, used = motion.active & ~touched.bilateral, _friction_used(motion)
    pressed = motion.pressed(motion.wrench)
    stops = np.array([parts.colour_array(colour) for colour in COLOURS])
    for contact, frame in enumerate(run.solution.contact_frames):
        visible = shown[:, contact]
        if not visible.any():
            continue
        place = run.node["cones"][frame.replace("/", "_")]
        _draw_cone(place)
        friction = touched.friction[:, contact]
        height = SIDE * size / np.sqrt(1 + friction**2)
        tracks.show(
            place,
            visible,
            position=pressed[:, contact],
            quaternion=turns_to(touched.normal[:, contact]),
            scale=np.column_stack([friction * height, friction * height, height]),
        )
        colours = np.column_stack([np.interp(used[:, contact], USED, channel) for channel in stops.T])
        for part in ("side", "rim"):
            tracks.add(place[part]["<object>"], "material.color", colours, visible)


def _friction_used(motion: ReplayMotion) -> np.ndarray:
    """Share (n, nc) of friction that each force uses, |f_t| / (mu f_n), at most 1; 0 for tiny forces."""
    force, touched = motion.force / motion.weight, motion.touched
    normal = touched.along_normal(force)
    along = np.linalg.norm(force - normal[..., None] * touched.normal, axis=-1)
    allowed = touched.friction * np.maximum(normal, 0.0)
    used = np.divide(along, allowed, out=np.ones_like(along), where=allowed > along)
    return np.where(np.linalg.norm(force, axis=-1) > LEAST_PRESSURE, used, 0.0)


def _draw_cone(node: Any) -> None:
    """Draw a cone about z of unit height and radius with its tip at the origin, its rim and some ribs."""
    rim = parts.circle(np.linspace(0, 2 * np.pi, ROUND, endpoint=False)) + parts.UPWARD
    index = np.array([(0, 1 + i, 1 + (i + 1) % ROUND) for i in range(ROUND)])
    side = [(np.vstack([np.zeros(3), rim]), parts.UPWARD, parts.WHITE, index)]
    colour = COLOURS[0]
    glass = shapes.MeshBasicMaterial(color=colour, opacity=OPACITY, transparent=True, depthWrite=False)
    parts.draw_unshadowed(node["side"], parts.ColouredMeshGeometry.joined(side), glass)
    ends = np.repeat(np.vstack([rim, rim[:1]]), 2, axis=0)[1:-1]
    ribs = np.concatenate([[np.zeros(3), rim[i]] for i in range(0, ROUND, ROUND // RIBS)])
    lines = parts.line_points(np.vstack([ends, ribs]))
    parts.draw_unshadowed(node["rim"], lines, shapes.LineBasicMaterial(color=colour), shapes.LineSegments)
