"""Pages about the whole body: base, centre of mass, momentum, power, clearances."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from trajopt.dynamics.base_joint import base_of
from trajopt.view.plotting import draw, style
from trajopt.view.plotting.draw import Curve, Values
from trajopt.view.plotting.motion import Motion
from trajopt.view.plotting.page import Page, Panel, Row, Tracks
from trajopt.view.plotting.topics_power import power_row

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# A component that moves less than this (SI units) on a robot in a plane lies across it.
STILL = 1e-9
LEAST_SPAN = 1e-6
WORLD = ("x", "y", "z")


def three(
    tracks: Tracks,
    name: str,
    title: str,
    ylabel: str,
    words: Sequence[str],
    values: Values,
    *,
    zero: bool = False,
) -> Row:
    """A row of one panel with the components of a vector (K, 3); of robots in a plane those within it."""
    drawn = [
        Curve(label=word, values=partial(_component, values=values, i=i), number=i)
        for i, word in enumerate(words)
    ]
    if base_of(tracks[0].solution.model) == "planar":
        drawn = [
            curve for curve in drawn if any(_moves(curve.values(track.dense)) for track in tracks)
        ] or drawn[:1]
    return Row(
        title=title,
        panels=(Panel(name=name, ylabel=ylabel, draw=partial(_plain, drawn=drawn, zero=zero)),),
        legend=tuple(curve.entry for curve in drawn),
    )


def _component(motion: Motion, values: Values, i: int) -> np.ndarray:
    return np.asarray(values(motion)[:, i])


def _moves(values: np.ndarray) -> bool:
    finite = values[np.isfinite(values)]
    return bool(finite.size and np.abs(finite).max() > STILL)


def _plain(axes: Axes, tracks: Tracks, drawn: Sequence[Curve], zero: bool) -> None:
    draw.curves(axes, tracks, drawn)
    draw.fit(axes, zero=zero, least=LEAST_SPAN)


def has_base(tracks: Tracks) -> bool:
    """Whether the robot's base moves."""
    return base_of(tracks[0].solution.model) != "fixed"


def position_row(tracks: Tracks) -> Row:
    """Position of the base in the world."""
    return three(tracks, "base position", "base position, world", "p [m]", WORLD, lambda m: m.base_position)


def orientation_row(tracks: Tracks) -> Row:
    """Roll, pitch and yaw."""
    words = ("roll", "pitch", "yaw")
    title = "base orientation, R = Rz(yaw) Ry(pitch) Rx(roll)"
    return three(tracks, "base orientation", title, "angle [rad]", words, lambda m: m.base_angles)


def base_pages(tracks: Tracks) -> list[Page]:
    """Position, orientation and velocities of a base that moves."""
    if not has_base(tracks):
        return []
    linear = three(
        tracks,
        "base velocity",
        "base velocity, world",
        "v [m/s]",
        WORLD,
        lambda m: m.base_twist[:, :3],
        zero=True,
    )
    angular = three(
        tracks,
        "base angular velocity",
        "base angular velocity, world",
        "\u03c9 [rad/s]",
        WORLD,
        lambda m: m.base_twist[:, 3:],
        zero=True,
    )
    rows = (position_row(tracks), orientation_row(tracks), linear, angular)
    return [Page(name="base", title="base", rows=rows, note="Angles continue past half a turn.")]


def centre_row(tracks: Tracks) -> Row:
    """Centre of mass in the world."""
    return three(tracks, "centre of mass", "centre of mass, world", "c [m]", WORLD, lambda m: m.centre)


def angular_row(tracks: Tracks) -> Row:
    """Angular momentum about the centre of mass."""
    return three(
        tracks,
        "angular momentum",
        "angular momentum about the centre of mass, world",
        "L [kg m\u00b2/s]",
        WORLD,
        lambda m: m.momentum[:, 3:],
        zero=True,
    )


def linear_row(tracks: Tracks) -> Row:
    """Linear momentum."""
    return three(
        tracks,
        "linear momentum",
        "linear momentum, world",
        "p [kg m/s]",
        WORLD,
        lambda m: m.momentum[:, :3],
        zero=True,
    )


def momentum_pages(tracks: Tracks) -> list[Page]:
    """Centre of mass, linear and centroidal angular momentum, power."""
    rows = [centre_row(tracks), linear_row(tracks), angular_row(tracks)]
    power = power_row(tracks)
    rows += [power] if power else []
    note = "Of the robot without what it carries." if tracks[0].meta.get("payloads") else ""
    return [Page(name="momentum", title="centre of mass, momentum and power", rows=tuple(rows), note=note)]


def clearance_row(tracks: Tracks) -> Row | None:
    """Distances from obstacles and between links."""
    names = list(dict.fromkeys(name for track in tracks for name in track.dense.clearances))
    if not names:
        return None
    drawn = [
        Curve(label=name, values=partial(_clearance, name), number=i, dots=False)
        for i, name in enumerate(names)
    ]
    return Row(
        title="least distance of the links' capsules",
        panels=(Panel(name="clearance", ylabel="distance d [m]", draw=partial(_clearances, drawn=drawn)),),
        legend=tuple(curve.entry for curve in drawn),
    )


def _clearance(name: str, motion: Motion) -> np.ndarray:
    return motion.clearances.get(name, np.full(len(motion.t), np.nan))


def _clearances(axes: Axes, tracks: Tracks, drawn: Sequence[Curve]) -> None:
    draw.curves(axes, tracks, drawn)
    draw.fit(axes, zero=True)
    axes.axhline(0.0, color=style.BLACK, linewidth=0.8, linestyle=draw.LIMIT_DASHES)


def clearance_pages(tracks: Tracks) -> list[Page]:
    """Distances from obstacles."""
    row = clearance_row(tracks)
    note = "Signed distance by Coal; below zero shapes overlap."
    return [] if row is None else [Page(name="clearance", title="clearance", rows=(row,), note=note)]
