"""Topics about the whole body: base, centre of mass, momentum, power, clearances."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from trajopt.dynamics.base_joint import base_of
from trajopt.view.plotting import sheet as plot
from trajopt.view.plotting import style
from trajopt.view.plotting.joints import JointAxis
from trajopt.view.plotting.motion import PlottedMotion
from trajopt.view.plotting.sheet import Sheet
from trajopt.view.plotting.topics_joints import limbs
from trajopt.view.plotting.track import MotionQuantity, Track

# For a planar robot, a component that moves less than this (SI units) is out of its plane.
STILL = 1e-9
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


def draw_base(sheet: Sheet) -> None:
    """Draw position, orientation and velocities of a moving base, and forces of thrusters."""
    if has_base(sheet.tracks):
        sheet.notes.append("Angles continue past half a turn.")
        for name in VECTORS:
            if name.startswith("base"):
                draw_vector(sheet, name)
    draw_thrust(sheet)


def draw_momentum(sheet: Sheet) -> None:
    """Draw centre of mass, linear and centroidal angular momentum, power."""
    for name in ("centre of mass", "linear momentum", "angular momentum"):
        draw_vector(sheet, name)
    draw_power(sheet)
    if sheet.tracks[0].solution.description.payloads:
        sheet.notes.append("Of the robot without what it carries.")


def draw_clearance(sheet: Sheet) -> None:
    """Draw distances from obstacles and between links, if there are any."""
    tracks = sheet.tracks
    names = dict.fromkeys(name for track in tracks for name in track.dense.clearances)
    if not names:
        return
    axes = sheet.panel("clearance", "least distance of the links", "distance d [m]")
    plot.curves(axes, tracks, {name: partial(_clearance, name) for name in names}, dots=False)
    plot.fit(axes, zero=True)
    axes.axhline(0.0, **plot.LIMIT)
    sheet.notes.append("Distances are signed, by Coal; below zero shapes overlap.")


def _clearance(name: str, motion: PlottedMotion) -> np.ndarray:
    return motion.clearances.get(name, np.full(len(motion.t), np.nan))


def has_base(tracks: Sequence[Track]) -> bool:
    """Whether the robot's base moves."""
    return base_of(tracks[0].solution.model) != "fixed"


def draw_vector(sheet: Sheet, name: str) -> None:
    """Draw one of `VECTORS`; for a planar robot only the components within its plane."""
    title, ylabel, words, values, zero = VECTORS[name]
    named = {word: plot.column(values, i) for i, word in enumerate(words)}
    if base_of(sheet.tracks[0].solution.model) == "planar":
        moving = {word: of for word, of in named.items() if any(_moves(of(t.dense)) for t in sheet.tracks)}
        named = moving or {words[0]: named[words[0]]}
    axes = sheet.panel(name, title, ylabel)
    plot.curves(axes, sheet.tracks, named)
    plot.fit(axes, zero=zero)


def _moves(values: np.ndarray) -> bool:
    return bool(np.abs(values[np.isfinite(values)]).max(initial=0.0) > STILL)


def draw_thrust(sheet: Sheet) -> None:
    """Draw the forces of the thrusters between their limits, if there are any."""
    thrusters = sheet.tracks[0].solution.description.thrusters
    if not thrusters:
        return
    first = sheet.tracks[0].solution.tau.shape[1] - len(thrusters)
    forces = {
        thruster.name: plot.column(lambda motion: motion.solution.tau, first + i)
        for i, thruster in enumerate(thrusters)
    }
    axes = sheet.panel("thrust", "forces of the thrusters and their limits", "force u [N]")
    plot.curves(axes, sheet.tracks, forces, apart=True)
    plot.fit(axes, zero=True)
    for limit in {limit for thruster in thrusters for limit in (thruster.least, thruster.most)}:
        axes.axhline(limit, **plot.LIMIT)


def draw_power(sheet: Sheet) -> None:
    """Draw the mechanical power of all joints, and of each limb, or of each joint of a single limb.

    It is the torque of the drives times the rate.
    """
    tracks = sheet.tracks
    actuated = {limb: [axis for axis in limb.axes if axis.torque is not None] for limb in limbs(tracks)}
    groups = {limb.name: axes for limb, axes in actuated.items() if axes}
    if not groups:
        return
    if len(groups) == 1:
        names = {axis: short for limb in actuated for axis, short in zip(limb.axes, limb.short, strict=True)}
        groups = {names[axis]: [axis] for axes in groups.values() for axis in axes}
    axes = sheet.panel(
        "power", f"mechanical power of the {'drives' if tracks[0].dense.drives else 'joints'}", "power P [W]"
    )
    total = {"all": lambda motion: motion.power.sum(axis=1)}
    plot.curves(axes, tracks, total, marker="", linewidth=2.0, color=style.GREY)
    if 1 < len(groups) <= len(style.COLOURS):
        parts = {name: partial(_power, group) for name, group in groups.items()}
        plot.curves(axes, tracks, parts, apart=True)
    plot.fit(axes, zero=True)
    axes.axhline(0.0, color=style.GREY, linewidth=0.5)


def _power(axes: Sequence[JointAxis], motion: PlottedMotion) -> np.ndarray:
    rows = [axis.torque for axis in axes if axis.torque is not None]
    return np.asarray(motion.power[:, rows].sum(axis=1))
