"""Pages about joints: positions, velocities and torques by limb, against their limits."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from trajopt.view.plotting import draw, style
from trajopt.view.plotting.draw import Curve
from trajopt.view.plotting.joints import JointAxis, Limb, limbs_of, position
from trajopt.view.plotting.motion import MotionQuantities
from trajopt.view.plotting.page import PlotPage, PlotPanel, PlotRow, Tracks, batches, page_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Rows of limbs on one page; robots with this few limbs have a whole row for each kind of quantity.
LIMBS_A_PAGE, WIDE_LIMBS = 6, 2
# Smallest span of a vertical axis in SI units: smaller differences are rounding.
LEAST_SPAN = 1e-6
# A limit is shown if values reach this fraction of it, else it would only flatten the curves.
NEAR = 0.75
SYMBOLS = {"position": "q", "velocity": "v", "torque": "\u03c4"}
KINDS = ("position", "velocity", "torque")


def limbs(tracks: Tracks) -> tuple[Limb, ...]:
    """The limbs of the solutions' robot."""
    return limbs_of(tracks[0].axes, tracks[0].solution.model)


def share(kind: str, axis: JointAxis, motion: MotionQuantities) -> np.ndarray:
    """Share (K,) of the limit that an axis uses; NaN where it has none.

    For a position, its distance from the middle of its range over half the range; for velocities and torques,
    the magnitude over the limit.
    """
    lower, upper = limit_of(kind, axis)
    half = (upper - lower) / 2
    if not (np.isfinite(half) and half > 0):
        return np.full(len(motion.t), np.nan)
    return np.abs(value(kind, axis, motion) - (upper + lower) / 2) / half


def value(kind: str, axis: JointAxis, motion: MotionQuantities) -> np.ndarray:
    """Position, velocity or torque (K,) of an axis."""
    if kind == "position":
        return position(axis, motion)
    if kind == "velocity":
        return motion.solution.v[:, axis.row]
    if axis.torque is None:
        return np.full(len(motion.t), np.nan)
    return motion.solution.tau[:, axis.torque]


def limit_of(kind: str, axis: JointAxis) -> tuple[float, float]:
    """Least and largest allowed value of an axis."""
    if kind == "position":
        return axis.lower, axis.upper
    most = axis.speed if kind == "velocity" else axis.effort
    return -most, most


def joint_pages(tracks: Tracks) -> list[PlotPage]:
    """Position, velocity and torque of every limb's joints, against their limits."""
    found = limbs(tracks)
    wide, alone = len(found) <= WIDE_LIMBS, len(found) == 1
    rows = [row for limb in found for row in limb_rows(limb, wide=wide, alone=alone)]
    note = (
        "Curves are the solution's own interpolation, dots its collocation points. Dashed: limits that "
        "values come near, in the joint's colour; black, hatched beyond, where a panel's joints share them."
    )
    return page_of("joints", "joints", *batches(rows, LIMBS_A_PAGE), note=note)


def limb_rows(limb: Limb, *, wide: bool, alone: bool = False) -> list[PlotRow]:
    """Position, velocity and torque of a limb's joints side by side, or ``wide`` below one another.

    A limb that is ``alone`` needs no name besides the prefix of its joints.
    """
    legend = tuple(curve.entry for curve in draw.numbered((name, _nothing) for name in limb.short))
    panels = [
        PlotPanel(
            name=f"{kind}:{limb.name}",
            ylabel=f"{_noun(kind, limb)} {SYMBOLS[kind]} [{_unit(kind, limb)}]",
            draw=partial(_limb, limb=limb, kind=kind),
            gap=0.66,
        )
        for kind in KINDS
        if kind != "torque" or any(axis.torque is not None for axis in limb.axes)
    ]
    if not wide:
        return [PlotRow(title=limb.name, panels=tuple(panels), legend=legend)]
    name = limb.prefix if alone else limb.name
    titles = [f"{name}: {_noun(kind, limb)}" if name else _noun(kind, limb) for kind in KINDS]
    return [
        PlotRow(title=title, panels=(panel,), legend=legend)
        for title, panel in zip(titles, panels, strict=False)
    ]


def _nothing(motion: MotionQuantities) -> np.ndarray:
    return np.full(len(motion.t), np.nan)


def _noun(kind: str, limb: Limb) -> str:
    return "force" if kind == "torque" and limb.unit == "m" else kind


def _unit(kind: str, limb: Limb) -> str:
    units = {
        "position": limb.unit,
        "velocity": f"{limb.unit.replace(', ', '/s, ')}/s",
        "torque": {"rad": "N m", "m": "N"}.get(limb.unit, "N m, N"),
    }
    return units[kind]


def _limb(axes: Axes, tracks: Tracks, limb: Limb, kind: str) -> None:
    shown = [(i, axis) for i, axis in enumerate(limb.axes) if kind != "torque" or axis.torque is not None]
    drawn = [Curve(label=limb.short[i], values=partial(value, kind, axis), number=i) for i, axis in shown]
    draw.curves(axes, tracks, drawn)
    _draw_limits(axes, tracks, kind, shown)


def _draw_limits(axes: Axes, tracks: Tracks, kind: str, shown: Sequence[tuple[int, JointAxis]]) -> None:
    """Fit the vertical axis, with the limits that values come near; those all curves share are hatched."""
    low, high = draw.fit(axes, least=LEAST_SPAN)
    limits = [limit_of(kind, axis) for _, axis in shown]
    values = [np.concatenate([value(kind, axis, track.dense) for track in tracks]) for _, axis in shown]
    near = [_near(*limit, reached) for limit, reached in zip(limits, values, strict=True)]
    every = [line for lines in near for line in lines]
    draw.set_range(axes, min([low, *every]), max([high, *every]), LEAST_SPAN)
    if len(limits) < 2 or len(set(limits)) > 1:
        for (number, _), lines in zip(shown, near, strict=True):
            for line in lines:
                axes.axhline(line, **{**draw.LIMIT, "color": style.COLOURS[number]}, zorder=2)
        return
    bottom, top = axes.get_ylim()
    for line in set(every):
        axes.axhline(line, **draw.LIMIT, zorder=2)
        side = bottom if line == limits[0][0] else top
        axes.axhspan(*sorted((line, side)), facecolor="none", edgecolor=style.GREY, hatch="////", lw=0)


def _near(lower: float, upper: float, values: np.ndarray) -> list[float]:
    """The limits that values come near: `NEAR` of the way from the middle of what is allowed, or zero."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return []
    middle = (lower + upper) / 2 if np.isfinite(lower) and np.isfinite(upper) else 0.0
    reached = {lower: middle - finite.min(), upper: finite.max() - middle}
    return [
        limit for limit, way in reached.items() if np.isfinite(limit) and way >= NEAR * abs(limit - middle)
    ]
