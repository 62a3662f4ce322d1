"""What a replay draws of balance: centre of mass and its projection, zero-moment point, support polygons."""

from __future__ import annotations

from typing import Any

import meshcat.geometry as shapes
import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.solution.solution import Solution
from trajopt.terrain.surface import frame_of_normal
from trajopt.view.replay.balance import Balance, SupportArea, upward
from trajopt.view.replay.coloured_mesh import WHITE, ColouredMesh, fan
from trajopt.view.replay.commands import Animation
from trajopt.view.replay.parts import (
    DARK,
    ColouredMeshGeometry,
    bullseye,
    colour_array,
    draw_line,
    draw_showing_through,
    draw_unshadowed,
    two_tone_ball,
    two_tone_disc,
)
from trajopt.view.replay.thinning import hold_while_hidden

ZMP_COLOUR, SUPPORT_COLOUR, COM_TRAIL_COLOUR = 0xB5179E, 0x2A9D6F, 0x30343B
SUPPORT_OPACITY = 0.28
# The robot hides these marks most of the time: they shine through it.
THROUGH = 0.75
# Over the robot's extent: radii of the ball, its projection, the zero-moment point, the vertical line, and
# half the width of a support that is a segment.
BALL, MARK, ZMP_MARK, PLUMB, SEGMENT = 0.032, 0.028, 0.024, 0.0025, 0.006
# Heights of flat marks over the drawn ground, over the robot's extent: above its grid, one above the other.
SUPPORT_LIFT, MARK_LIFT, ZMP_LIFT = 0.003, 0.0045, 0.006


def draw_balance(
    node: Any,
    tracks: Animation,
    solution: Solution,
    balance: Balance,
    drop: float,
    size: float,
    tint: int | None = None,
) -> None:
    """Animate the marks; ``drop`` m is how far below the contacts the drawn ground lies, ``size`` the extent.

    ``tint`` colours everything of a robot laid over another.
    """
    up = upward(solution.model)
    _draw_com(node["com"], tracks, balance, up, drop, size, tint)
    if not balance.supports or not BASE_JOINT[base_of(solution.model)]:  # a base that is bolted down
        return
    _draw_zmp(node["zmp"], tracks, balance, drop, size, ZMP_COLOUR if tint is None else tint)
    for number, support in enumerate(balance.supports):
        place = node["support"][f"stance{number}"]
        _draw_support(place, support, drop, size, SUPPORT_COLOUR if tint is None else tint)
        tracks.add(place, "visible", "boolean", support.rows)


def _draw_com(
    node: Any,
    tracks: Animation,
    balance: Balance,
    up: np.ndarray,
    drop: float,
    size: float,
    tint: int | None,
) -> None:
    dark = DARK if tint is None else colour_array(tint)
    draw_showing_through(node["ball"], two_tone_ball(BALL * size, dark), through=THROUGH, vertexColors=True)
    tracks.add(node["ball"], "position", "vector3", balance.com)
    draw_line(node["trail"], balance.com, COM_TRAIL_COLOUR if tint is None else tint)
    shown = np.isfinite(balance.below).all(axis=1)
    if not shown.any():
        return
    ground = hold_while_hidden(balance.below, shown) - drop * up
    height = np.maximum((balance.com - ground) @ up, 0.0)
    turn = frame_of_normal(up)
    mark, plumb = node["projection"], node["plumb"]
    draw_showing_through(mark["disc"], two_tone_disc(MARK * size, dark), lit=False, vertexColors=True)
    mark["disc"].set_transform(pin.SE3(turn, MARK_LIFT * size * up).homogeneous)
    tracks.add(mark, "position", "vector3", ground)
    tracks.add(mark, "visible", "boolean", shown)
    colour = 0x50565F if tint is None else tint
    upright, rod = plumb["upright"], plumb["upright"]["length"]
    upright.set_transform(pin.SE3(turn, np.zeros(3)).homogeneous)
    draw_unshadowed(rod["rod"], shapes.Cylinder(1.0, PLUMB * size), shapes.MeshBasicMaterial(color=colour))
    lying = pin.utils.rotate("x", np.pi / 2)  # Meshcat's cylinders lie along y
    rod["rod"].set_transform(pin.SE3(lying, np.array([0.0, 0.0, 0.5])).homogeneous)
    tracks.add(plumb, "position", "vector3", ground)
    tracks.add(plumb, "visible", "boolean", shown)
    tracks.add(rod, "scale", "vector3", np.column_stack([np.ones((len(height), 2)), height]))


def _draw_zmp(node: Any, tracks: Animation, balance: Balance, drop: float, size: float, colour: int) -> None:
    shown = np.isfinite(balance.zmp).all(axis=1)
    if not shown.any():
        return
    place, turn = np.zeros_like(balance.zmp), np.tile([0.0, 0.0, 0.0, 1.0], (len(shown), 1))
    for support in balance.supports:
        normal = support.plane.normal
        place[support.rows] = balance.zmp[support.rows] + (ZMP_LIFT * size - drop) * normal
        turn[support.rows] = pin.Quaternion(support.plane.frame).coeffs()
    draw_showing_through(
        node["mark"], bullseye(ZMP_MARK * size, colour), lit=False, through=THROUGH, vertexColors=True
    )
    tracks.add(node["mark"], "position", "vector3", hold_while_hidden(place, shown))
    tracks.add(node["mark"], "quaternion", "quaternion", hold_while_hidden(turn, shown))
    tracks.add(node["mark"], "visible", "boolean", shown)


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
