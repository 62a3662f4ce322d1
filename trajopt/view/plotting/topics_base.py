"""Pages about the whole body: base, centre of mass, momentum, power, clearances."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from trajopt.dynamics.base_joint import base_of
from trajopt.view.plotting import draw, style
from trajopt.view.plotting.draw import Curve, PlotPage, PlotRow, Tracks, page_of
from trajopt.view.plotting.joints import JointAxis
from trajopt.view.plotting.motion import PlottedMotion
from trajopt.view.plotting.topics_joints import limbs
from trajopt.view.plotting.track import MotionQuantity

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# For a planar robot, a component that moves less than this (SI units) is out of its plane.
STILL = 1e-9
LEAST_SPAN = 1e-6
WORLD = ("x", "y", "z")
# By name: title, label of the axis, components, values (K, 3), and whether the axis includes zero.
VECTORS: dict[str, tuple[str, str, Sequence[str], MotionQuantity, bool]] = {
    "base position": ("base position, world", "p [m]", WORLD, lambda m: m.base_position, False),
    "base orientation": (
        "base orientation, R = Rz(yaw) Ry(pitch) Rx(roll)",
        "angle [rad]",
        ("roll", "pitch", "yaw"),
        lambda m: m.base_angles,
        False,
    ),
    "base velocity": ("base velocity, world", "v [m/s]", WORLD, lambda m: m.base_twist[:, :3], True),
    "base angular velocity": (
        "base angular velocity, world",
        "\u03c9 [rad/s]",
        WORLD,
        lambda m: m.base_twist[:, 3:],
        True,
    ),
    "centre of mass": ("centre of mass, world", "c [m]", WORLD, lambda m: m.centre, False),
    "linear momentum": ("linear momentum, world", "p [kg m/s]", WORLD, lambda m: m.momentum[:, :3], True),
    "angular momentum": (
        "angular momentum about the centre of mass, world",
        "L [kg m\u00b2/s]",
        WORLD,
        lambda m: m.momentum[:, 3:],
        True,
    ),
}


def vector_row(tracks: Tracks, name: str) -> PlotRow:
    """Return the row of one of `VECTORS`; for a planar robot only the components within its plane."""
    title, ylabel, words, values, zero = VECTORS[name]
    curves = draw.numbered((word, draw.column(values, i)) for i, word in enumerate(words))
    if base_of(tracks[0].solution.model) == "planar":
        moving = [curve for curve in curves if any(_moves(curve.values(track.dense)) for track in tracks)]
        curves = moving or curves[:1]
    return draw.curve_row(name, title, ylabel, curves, partial(draw.fit, zero=zero, least=LEAST_SPAN))


def _moves(values: np.ndarray) -> bool:
    return bool(np.abs(values[np.isfinite(values)]).max(initial=0.0) > STILL)


def has_base(tracks: Tracks) -> bool:
    """Whether the robot's base moves."""
    return base_of(tracks[0].solution.model) != "fixed"


def base_pages(tracks: Tracks) -> list[PlotPage]:
    """Return position, orientation and velocities of a moving base, and forces of thrusters."""
    names = [name for name in VECTORS if name.startswith("base")] if has_base(tracks) else []
    rows = [*(vector_row(tracks, name) for name in names), thrust_row(tracks)]
    return page_of("base", "base", rows, note="Angles continue past half a turn.")


def thrust_row(tracks: Tracks) -> PlotRow | None:
    """Return the forces of the thrusters between their limits; None without thrusters."""
    thrusters = tracks[0].solution.description.thrusters
    if not thrusters:
        return None
    first = tracks[0].solution.tau.shape[1] - len(thrusters)
    curves = draw.numbered(
        (thruster.name, draw.column(lambda motion: motion.solution.tau, first + i))
        for i, thruster in enumerate(thrusters)
    )
    limits = {limit for thruster in thrusters for limit in (thruster.least, thruster.most)}

    def scale(axes: Axes) -> None:
        draw.fit(axes, zero=True)
        for limit in limits:
            axes.axhline(limit, **draw.LIMIT)

    title = "forces of the thrusters and their limits"
    return draw.curve_row("thrust", title, "force u [N]", draw.told_apart(tracks, curves), scale)


def momentum_pages(tracks: Tracks) -> list[PlotPage]:
    """Return centre of mass, linear and centroidal angular momentum, power."""
    names = ("centre of mass", "linear momentum", "angular momentum")
    rows = [*(vector_row(tracks, name) for name in names), power_row(tracks)]
    note = "Of the robot without what it carries." if tracks[0].solution.description.payloads else ""
    return page_of("momentum", "centre of mass, momentum and power", rows, note=note)


def power_row(tracks: Tracks) -> PlotRow | None:
    """Return the mechanical power of all joints, and of each limb, or of each joint of a single limb.

    It is the torque of the drives times the rate; None without actuators.
    """
    actuated = [(limb, [axis for axis in limb.axes if axis.torque is not None]) for limb in limbs(tracks)]
    actuated = [(limb, axes) for limb, axes in actuated if axes]
    if not actuated:
        return None
    groups = {limb.name: axes for limb, axes in actuated}
    if len(actuated) == 1:
        limb, axes = actuated[0]
        groups = {short: [axis] for short, axis in zip(limb.short, limb.axes, strict=True) if axis in axes}
    if not 1 < len(groups) <= len(style.COLOURS):
        groups = {}
    total = Curve(
        label="all", values=lambda motion: motion.power.sum(axis=1), marked=False, width=2.0, shade=style.GREY
    )
    parts = draw.numbered((name, partial(_power, axes)) for name, axes in groups.items())
    title = f"mechanical power of the {'drives' if tracks[0].dense.drives else 'joints'}"
    scale = partial(draw.fit_with_zero_line, color=style.GREY, linewidth=0.5)
    drawn = [total, *draw.told_apart(tracks, parts)]
    return draw.curve_row("power", title, "power P [W]", drawn, scale)


def _power(axes: Sequence[JointAxis], motion: PlottedMotion) -> np.ndarray:
    rows = [axis.torque for axis in axes if axis.torque is not None]
    return np.asarray(motion.power[:, rows].sum(axis=1))


def clearance_row(tracks: Tracks) -> PlotRow | None:
    """Return distances from obstacles and between links; None if there are none."""
    names = list(dict.fromkeys(name for track in tracks for name in track.dense.clearances))
    if not names:
        return None
    curves = draw.numbered(((name, partial(_clearance, name)) for name in names), dots=False)
    title, scale = "least distance of the links", partial(draw.fit_with_zero_line, **draw.LIMIT)
    return draw.curve_row("clearance", title, "distance d [m]", curves, scale)


def _clearance(name: str, motion: PlottedMotion) -> np.ndarray:
    return motion.clearances.get(name, np.full(len(motion.t), np.nan))


def clearance_pages(tracks: Tracks) -> list[PlotPage]:
    """Return distances from obstacles."""
    note = "Signed distance by Coal; below zero shapes overlap."
    return page_of("clearance", "clearance", [clearance_row(tracks)], note=note)
