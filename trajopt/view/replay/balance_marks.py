"""Balance in a replay: centre of mass and its projection, zero-moment point, support polygons."""

from __future__ import annotations

from typing import Any

import meshcat.geometry as shapes
import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.terrain.surface import frame_of_normal
from trajopt.view.replay.balance import Balance, SupportArea, upward
from trajopt.view.replay.commands import Animation
from trajopt.view.replay.parts import (
    DARK,
    UPRIGHT,
    WHITE,
    ColouredMesh,
    ColouredMeshGeometry,
    bullseye,
    colour_array,
    draw_line,
    draw_showing_through,
    draw_unshadowed,
    fan,
    placed,
    two_tone_ball,
    two_tone_disc,
)
from trajopt.view.replay.runs import DrawnSolution
from trajopt.view.replay.thinning import hold_while_hidden

ZMP_COLOUR, SUPPORT_COLOUR = 0xB5179E, 0x2A9D6F
COM_TRAIL_COLOUR, PLUMB_COLOUR = 0x30343B, 0x50565F
SUPPORT_OPACITY = 0.28
# The robot covers these marks most of the time: they shine through it.
THROUGH = 0.75
# Over the robot's extent: radii of the ball, its projection, the zero-moment point, the vertical line, and
# half the width of a support that is a segment.
BALL, MARK, ZMP_MARK, PLUMB, SEGMENT = 0.032, 0.028, 0.024, 0.0025, 0.006
# Heights of flat marks over the drawn ground, over the robot's extent: above its grid, one above the other.
SUPPORT_LIFT, MARK_LIFT, ZMP_LIFT = 0.003, 0.0045, 0.006


def draw_balance(run: DrawnSolution, tracks: Animation, balance: Balance, drop: float, size: float) -> None:
    """Animate the marks; ``drop`` m is how far below the contacts the drawn ground lies."""
    node, model = run.node, run.solution.model
    dark = colour_array(run.colour) if run.tinted else DARK
    _draw_com(run, tracks, balance, drop, size, dark)
    if not balance.supports or not BASE_JOINT[base_of(model)]:  # a fixed base
        return
    _draw_zmp(node["zmp"], tracks, balance, drop, size, run.ink(ZMP_COLOUR))
    for number, support in enumerate(balance.supports):
        place = node["support"][f"stance{number}"]
        _draw_support(place, support, drop, size, run.ink(SUPPORT_COLOUR))
        tracks.add(place, "visible", support.rows)


def _draw_com(
    run: DrawnSolution, tracks: Animation, balance: Balance, drop: float, size: float, dark: np.ndarray
) -> None:
    node, up = run.node["com"], upward(run.solution.model)
    draw_showing_through(node["ball"], two_tone_ball(BALL * size, dark), through=THROUGH, vertexColors=True)
    tracks.add(node["ball"], "position", balance.com)
    draw_line(node["trail"], balance.com, run.ink(COM_TRAIL_COLOUR))
    shown = np.isfinite(balance.below).all(axis=1)
    if not shown.any():
        return
    ground = hold_while_hidden(balance.below, shown) - drop * up
    height = np.maximum((balance.com - ground) @ up, 0.0)
    turn = frame_of_normal(up)
    mark, plumb = node["projection"], node["plumb"]
    draw_showing_through(mark["disc"], two_tone_disc(MARK * size, dark), lit=False, vertexColors=True)
    mark["disc"].set_transform(placed(MARK_LIFT * size * up, turn))
    tracks.add(mark, "position", ground)
    tracks.add(mark, "visible", shown)
    upright, rod = plumb["upright"], plumb["upright"]["length"]
    upright.set_transform(placed(np.zeros(3), turn))
    line = shapes.MeshBasicMaterial(color=run.ink(PLUMB_COLOUR))
    draw_unshadowed(rod["rod"], shapes.Cylinder(1.0, PLUMB * size), line)
    rod["rod"].set_transform(placed([0.0, 0.0, 0.5], UPRIGHT))
    tracks.add(plumb, "position", ground)
    tracks.add(plumb, "visible", shown)
    tracks.add(rod, "scale", np.column_stack([np.ones((len(height), 2)), height]))


def _draw_zmp(node: Any, tracks: Animation, balance: Balance, drop: float, size: float, colour: int) -> None:
    shown = np.isfinite(balance.zmp).all(axis=1)
    if not shown.any():
        return
    place, turn = np.zeros_like(balance.zmp), np.tile([0.0, 0.0, 0.0, 1.0], (len(shown), 1))
    for support in balance.supports:
        normal = support.plane.normal
        place[support.rows] = balance.zmp[support.rows] + (ZMP_LIFT * size - drop) * normal
        turn[support.rows] = pin.Quaternion(support.plane.frame).coeffs()
    mark = node["mark"]
    draw_showing_through(
        mark, bullseye(ZMP_MARK * size, colour), lit=False, through=THROUGH, vertexColors=True
    )
    tracks.add(mark, "position", place, shown)
    tracks.add(mark, "quaternion", turn, shown)
    tracks.add(mark, "visible", shown)


def _draw_support(node: Any, support: SupportArea, drop: float, size: float, colour: int) -> None:
    normal = support.plane.normal
    hull = support.hull + (SUPPORT_LIFT * size - drop) * normal
    if len(hull) < 2:
        return
    if len(hull) == 2:
        across = np.cross(normal, hull[1] - hull[0])
        across *= SEGMENT * size / np.linalg.norm(across)
        hull = np.array([hull[0] - across, hull[1] - across, hull[1] + across, hull[0] + across])
    mesh = ColouredMesh.joined([(hull, normal, WHITE, fan(len(hull)))])
    glass = shapes.MeshBasicMaterial(
        color=colour, opacity=SUPPORT_OPACITY, transparent=True, depthWrite=False
    )
    draw_unshadowed(node["area"], ColouredMeshGeometry(mesh), glass)
    draw_line(node["edge"], hull, colour, closed=True)
