"""Friction cones of a replay, at the point of the force, coloured by the share of friction used."""

from __future__ import annotations

from typing import Any

import meshcat.geometry as shapes
import numpy as np

from trajopt.motion.touched import TouchedSurfaces
from trajopt.view.replay.commands import Animation
from trajopt.view.replay.motion import LEAST_PRESSURE, ReplayMotion
from trajopt.view.replay.parts import (
    UPWARD,
    WHITE,
    ColouredMesh,
    ColouredMeshGeometry,
    colour_array,
    draw_unshadowed,
    line_points,
)
from trajopt.view.replay.runs import DrawnSolution
from trajopt.view.replay.turns import turns_to

# Length of a cone's side over the robot's extent; half angle, axis and apex are to scale.
SIDE = 0.16
OPACITY = 0.3
# Colour by the share of friction used: |f_t| / (mu f_n) is 0 along the axis and 1 on the cone.
USED = (0.0, 0.6, 0.85, 1.0)
COLOURS = (0x3C93C2, 0x3C93C2, 0xF0A202, 0xB0170B)
ROUND, RIBS = 24, 8


def draw_cones(run: DrawnSolution, tracks: Animation, touched: TouchedSurfaces, size: float) -> None:
    """Animate the cone of every unilateral contact; ``touched`` is at the motion's frames.

    Hidden while the contact is not active; a contact on a bilateral surface has none, as its force is free.
    """
    motion = run.motion
    shown = motion.active & ~touched.bilateral
    used = friction_used(motion, touched)
    for contact, frame in enumerate(run.solution.contact_frames):
        visible = shown[:, contact]
        if not visible.any():
            continue
        place = run.node["cones"][frame.replace("/", "_")]
        _draw(place)
        friction = touched.friction[:, contact]
        height = SIDE * size / np.sqrt(1 + friction**2)
        scale = np.column_stack([friction * height, friction * height, height])
        tracks.add(place, "visible", visible)
        tracks.add(place, "position", motion.pressed[:, contact], visible)
        tracks.add(place, "quaternion", turns_to(touched.normal[:, contact]), visible)
        tracks.add(place, "scale", scale, visible)
        for part in ("side", "rim"):
            tracks.add(place[part]["<object>"], "material.color", colours_of(used[:, contact]), visible)


def friction_used(motion: ReplayMotion, touched: TouchedSurfaces) -> np.ndarray:
    """Share (n, nc) of friction that each force uses, |f_t| / (mu f_n), at most 1; 0 for tiny forces."""
    force = motion.force / motion.weight
    normal = touched.along_normal(force)
    along = np.linalg.norm(force - normal[..., None] * touched.normal, axis=-1)
    allowed = touched.friction * np.maximum(normal, 0.0)
    used = np.divide(along, allowed, out=np.ones_like(along), where=allowed > along)
    return np.where(np.linalg.norm(force, axis=-1) > LEAST_PRESSURE, used, 0.0)


def colours_of(used: np.ndarray) -> np.ndarray:
    """Colours (n, 3) from 0 to 1 of the used share (n,) of friction."""
    stops = np.array([colour_array(colour) for colour in COLOURS])
    return np.column_stack([np.interp(used, USED, stops[:, channel]) for channel in range(3)])


def _draw(node: Any) -> None:
    """A cone of height and radius one about z with its tip at the origin, its rim and some ribs."""
    turn = np.linspace(0, 2 * np.pi, ROUND, endpoint=False)
    rim = np.column_stack([np.cos(turn), np.sin(turn), np.ones(ROUND)])
    points = np.vstack([np.zeros(3), rim])
    index = np.array([(0, 1 + i, 1 + (i + 1) % ROUND) for i in range(ROUND)])
    mesh = ColouredMesh.joined([(points, UPWARD, WHITE, index)])
    colour = COLOURS[0]
    glass = shapes.MeshBasicMaterial(color=colour, opacity=OPACITY, transparent=True, depthWrite=False)
    draw_unshadowed(node["side"], ColouredMeshGeometry(mesh), glass)
    ends = np.repeat(np.vstack([rim, rim[:1]]), 2, axis=0)[1:-1]
    ribs = np.concatenate([[np.zeros(3), rim[i]] for i in range(0, ROUND, ROUND // RIBS)])
    lines = line_points(np.vstack([ends, ribs]))
    draw_unshadowed(node["rim"], lines, shapes.LineBasicMaterial(color=colour), shapes.LineSegments)
