"""What a whole-body controller asked for in a simulation: contact forces as arrows, goals as crosses.

The wanted centre of mass is a cross, the measured one a ball beside it; a wanted foot is a small cross, where
the foot would touch.
"""

from __future__ import annotations

from typing import Any

import meshcat.geometry as shapes
import numpy as np

from trajopt.view.replay.arrows import LEAST_FORCE, ArrowLook, draw_arrow
from trajopt.view.replay.balance_marks import THROUGH
from trajopt.view.replay.commands import Animation
from trajopt.view.replay.goals import draw_cross
from trajopt.view.replay.motion import pressing_soles, pressure_offsets
from trajopt.view.replay.parts import draw_showing_through
from trajopt.view.replay.runs import DrawnSolution

ASKED_COLOUR, MEASURED_COLOUR = 0x00A08A, 0x1A1F26
# A broad translucent arrow around the force that acts: both are seen where they are the same.
BROAD, OPACITY = 2.2, 0.35
# Over the robot's extent: half a cross of the centre of mass and of a foot, radius of a bar, measured ball.
COM_CROSS, FOOT_CROSS, BAR, BALL = 0.05, 0.025, 0.003, 0.008


def draw_controller(
    run: DrawnSolution, tracks: Animation, com: np.ndarray, size: float, weight_arrow: float
) -> None:
    """Animate what a solution's controller asked for, if it had one.

    com: measured (n, 3), m. Lengths of arrows are those of `draw_arrows`. ``size`` is the robot's extent, m.
    """
    solution, motion, node = run.solution, run.motion, run.node["controller"]
    if solution.asked_force is None or solution.com_goal is None or solution.foot_goal is None:
        return
    look = ArrowLook(size=size, scale=weight_arrow, colour=ASKED_COLOUR, broad=BROAD, opacity=OPACITY)
    wrench, soles = motion.between(solution.asked_force), pressing_soles(solution)[motion.last]
    start = motion.feet + pressure_offsets(motion.contacts, wrench, soles, motion.weight)
    below = solution.description.radii[:, None] * motion.touched.normal
    wanted_feet = motion.between(solution.foot_goal) - below
    for contact, frame in enumerate(solution.contact_frames):
        name, force = frame.replace("/", "_"), wrench[:, contact, :3] / motion.weight
        shown = np.linalg.norm(force, axis=1) > LEAST_FORCE
        if shown.any():
            draw_arrow(node["forces"][name], tracks, start[:, contact], force, shown, look)
        _mark(node["feet"][name], tracks, wanted_feet[:, contact], FOOT_CROSS * size, BAR * size)
    wanted = motion.between(solution.com_goal)
    if _mark(node["com"], tracks, wanted, COM_CROSS * size, BAR * size):
        ball = shapes.Sphere(BALL * size)
        draw_showing_through(node["measured"], ball, through=THROUGH, color=MEASURED_COLOUR)
        tracks.add(node["measured"], "position", com)
        tracks.add(node["measured"], "visible", np.isfinite(wanted).all(axis=1))


def _mark(node: Any, tracks: Animation, place: np.ndarray, half: float, radius: float) -> bool:
    """Animate a cross at places (n, 3), m, NaN where there is none; whether there is any."""
    shown = np.isfinite(place).all(axis=1)
    if not shown.any():
        return False
    draw_cross(node, half, radius, ASKED_COLOUR, THROUGH)
    tracks.add(node, "position", place, shown)
    tracks.add(node, "visible", shown)
    return True
