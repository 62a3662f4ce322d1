"""The page about shares of limits: maps over time of all joints, curves of the most used."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from trajopt.view.plotting import draw, style
from trajopt.view.plotting.draw import Curve
from trajopt.view.plotting.joints import JointAxis
from trajopt.view.plotting.motion import MotionQuantities
from trajopt.view.plotting.page import PlotPage, PlotPanel, PlotRow, Tracks, page_of
from trajopt.view.plotting.share_map import share_map
from trajopt.view.plotting.topics_joints import KINDS, limbs, share

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# A row of a map of shares in units of a row's height, and the least height of a map.
MAP_ROW, LEAST_MAP = 0.105, 0.75
# Inches of a letter in the names of a map's rows; rows of maps on a page, and beside curves.
NAME_LETTER, MAP_ROWS_A_PAGE, MAP_ROWS_WITH_CURVES = 0.058, 56, 26
# Joints whose shares are drawn as curves: those that come nearest to their limits.
MOST_USED = 5


def limit_pages(tracks: Tracks) -> list[PlotPage]:
    """Maps of the shares of all limits over time, for each solution."""
    found = limbs(tracks)
    rows = [axis for limb in found for axis in limb.axes]
    names = [name for limb in found for name in limb.long]
    if not rows:
        return []
    height = max(LEAST_MAP, MAP_ROW * len(rows))
    parts: list[list[PlotRow | None]]
    maps = [
        map_row(tracks, number, [[axis] for axis in rows], names, height) for number in range(len(tracks))
    ]
    note = (
        "Share of the limit that each joint uses, and on the right its largest in per cent, bold from 98 %. "
        "Of a position: its distance from the middle of its range over half of it. White: no limit. "
        "Each column of the picture shows the largest value within its time."
    )
    used = [used_row(tracks, kind, rows, names) for kind in KINDS]
    scale = scale_row(maps[0].left)
    step = max(1, MAP_ROWS_A_PAGE // len(rows))
    parts = [[*maps[start : start + step], scale] for start in range(0, len(maps), step)]
    parts.append(used)
    if len(maps) == 1 and len(rows) <= MAP_ROWS_WITH_CURVES:
        parts = [[maps[0], scale, *used]]
    return [page for part in parts for page in page_of("limits", "shares of the limits", part, note)]


def used_row(tracks: Tracks, kind: str, axes: Sequence[JointAxis], names: Sequence[str]) -> PlotRow | None:
    """Shares of the joints that come nearest to their limits, over time; None where none is limited."""
    peaks = []
    for axis, name in zip(axes, names, strict=True):
        found = np.concatenate([share(kind, axis, track.dense) for track in tracks])
        if np.isfinite(found).any():
            peaks.append((float(np.nanmax(found)), name, axis))
    chosen = sorted(peaks, key=lambda entry: -entry[0])[:MOST_USED]
    if not chosen:
        return None
    drawn = [
        Curve(label=name, values=partial(share, kind, axis), number=i)
        for i, (_, name, axis) in enumerate(chosen)
    ]
    return draw.curve_row(f"used:{kind}", f"{kind}: most used", "share [1]", drawn, draw.share_axis)


def map_row(
    tracks: Tracks, number: int, groups: Sequence[Sequence[JointAxis]], names: Sequence[str], height: float
) -> PlotRow:
    """Return maps of one solution, of positions, velocities and torques: of each group its largest share."""

    def draw_map(axes: Axes, tracks: Tracks, kind: str) -> None:
        track = tracks[number]
        shares = np.array([largest_share(kind, group, track.dense) for group in groups]).T
        share_map(axes, track, names, shares, named=kind == KINDS[0])

    which = "" if len(tracks) == 1 else f", {tracks[number].label}"
    panels = tuple(
        PlotPanel(
            name=f"share:{kind}:{number}",
            ylabel="",
            draw=partial(draw_map, kind=kind),
            gap=0.36,
            title=f"{kind}{which}",
        )
        for kind in KINDS
    )
    left = 0.25 + NAME_LETTER * max(len(name) for name in names)
    return PlotRow(title="", panels=panels, height=height, left=left, right=0.45, rigid=True)


def largest_share(kind: str, group: Sequence[JointAxis], motion: MotionQuantities) -> np.ndarray:
    """The largest share (K,) of some axes; NaN where none has a limit."""
    return np.asarray(np.fmax.reduce([share(kind, axis, motion) for axis in group]))


def largest_row(tracks: Tracks) -> PlotRow | None:
    """The largest share over all joints of positions, velocities and torques; None where none is limited."""
    rows = [axis for limb in limbs(tracks) for axis in limb.axes]
    drawn = [
        Curve(label=kind, values=partial(largest_share, kind, rows), number=i, dots=False)
        for i, kind in enumerate(KINDS)
        if rows and any(np.isfinite(largest_share(kind, rows, track.dense)).any() for track in tracks)
    ]
    if not drawn:
        return None
    title = "largest share of the limits"
    return draw.curve_row("largest share", title, "share [1]", drawn, draw.share_axis)


def scale_row(left: float) -> PlotRow:
    """The scale of colours of the maps."""
    panel = PlotPanel(name="scale", ylabel="", draw=_scale, timed=False)
    return PlotRow(title="", panels=(panel,), height=0.07, left=left, right=0.45, rigid=True)


def _scale(axes: Axes, tracks: Tracks) -> None:
    import matplotlib as mpl

    ramp = np.linspace(0, 1, 256)[None]
    axes.imshow(ramp, extent=(0, 100, 0, 1), aspect="auto", cmap=mpl.colormaps[style.SHARES])
    axes.axvspan(100, 104, color=style.BEYOND, linewidth=0)
    axes.set(
        xlim=(0, 104), xticks=[0, 20, 40, 60, 80, 100], yticks=[], xlabel="share of the limit [%]; beyond it"
    )
    axes.grid(False)
