"""Mechanical power of the joints: of all of them, and of each limb, or of each joint of a single limb."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from trajopt.view.plotting import draw, style
from trajopt.view.plotting.draw import Curve
from trajopt.view.plotting.joints import Axis
from trajopt.view.plotting.motion import Motion
from trajopt.view.plotting.page import Panel, Row, Tracks
from trajopt.view.plotting.topics_joints import limbs

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def power_row(tracks: Tracks) -> Row | None:
    """Torque of the drives times rate; None where nothing is actuated."""
    found = [(limb, [axis for axis in limb.axes if axis.torque is not None]) for limb in limbs(tracks)]
    groups = {limb.name: axes for limb, axes in found if axes}
    if not groups:
        return None
    if len(groups) == 1:
        limb, axes = next((limb, axes) for limb, axes in found if axes)
        shorts = dict(zip(limb.axes, limb.short, strict=True))
        groups = {shorts[axis]: [axis] for axis in axes}
    if not 1 < len(groups) <= len(style.COLOURS):
        groups = {}
    drawn = [
        Curve(label=name, values=partial(_power, axes), number=i)
        for i, (name, axes) in enumerate(groups.items())
    ]
    total = Curve(
        label="all", values=lambda motion: motion.power.sum(axis=1), marked=False, width=2.0, shade=style.GREY
    )
    shown = [total, *drawn]
    whose = "drives" if tracks[0].dense.drives else "joints"
    return Row(
        title=f"mechanical power of the {whose}",
        panels=(Panel(name="power", ylabel="power P [W]", draw=partial(_zero_based, drawn=shown)),),
        legend=tuple(curve.entry for curve in shown),
    )


def _power(axes: Sequence[Axis], motion: Motion) -> np.ndarray:
    rows = [axis.torque for axis in axes if axis.torque is not None]
    return np.asarray(motion.power[:, rows].sum(axis=1))


def _zero_based(axes: Axes, tracks: Tracks, drawn: Sequence[Curve]) -> None:
    draw.curves(axes, tracks, drawn)
    draw.fit(axes, zero=True)
    axes.axhline(0.0, color=style.GREY, linewidth=0.5)
