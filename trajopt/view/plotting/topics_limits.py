"""The page about shares of limits: maps over time of all joints, curves of the most used."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from trajopt.view.plotting import draw, style
from trajopt.view.plotting.far_limits import BEYOND as BEYOND_AXIS
from trajopt.view.plotting.far_limits import are_far, limit_words, most_used, unit_of
from trajopt.view.plotting.joints import JointAxis
from trajopt.view.plotting.motion import MotionQuantities
from trajopt.view.plotting.page import PlotPage, PlotPanel, PlotRow, Tracks, batches, page_of
from trajopt.view.plotting.quantities import KINDS, share, value
from trajopt.view.plotting.topics_joints import limbs
from trajopt.view.plotting.track import Track

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Row height of a map of shares in units of a row's height, and the least height of a map.
MAP_ROW, LEAST_MAP = 0.105, 0.75
# Inches of a letter in the names of a map's rows; rows of maps on a page, and beside curves.
NAME_LETTER, MAP_ROWS_A_PAGE, MAP_ROWS_WITH_CURVES = 0.058, 56, 26
# A share of the limit from which its number is bold, and how far beyond 1 counts as on the limit.
CLOSE, BEYOND = 0.98, 1e-4
COLUMNS = 400
# The colour bar: width over a map's, inches to the maps and of its labels, and the end of its colour beyond.
BAR, BAR_GAP, BAR_LABELS, BEYOND_SHOWN = 0.04, 0.34, 0.34, 1.08
# Number of joints whose shares are drawn as curves: those that come nearest to their limits.
MOST_USED = 5


def limit_pages(tracks: Tracks) -> list[PlotPage]:
    """Maps of the shares of all limits over time, for each solution."""
    rows, names = axes_and_names(tracks)
    if not rows:
        return []
    height, groups = max(LEAST_MAP, MAP_ROW * len(rows)), [[axis] for axis in rows]
    maps = [map_row(tracks, number, groups, names, height) for number in range(len(tracks))]
    note = (
        "Share of the limit that each joint uses, and on the right its largest in per cent, bold from 98 %. "
        "Of a position: its distance from the middle of its range over half of it. White: no limit. "
        "Where limits are far beyond what is used, the largest value used is 100 %. Orange: beyond a limit. "
        "Each column of the picture shows the largest value within its time."
    )
    used = [used_row(tracks, kind, rows, names) for kind in KINDS]
    title = "shares of the limits"
    if len(maps) == 1 and len(rows) <= MAP_ROWS_WITH_CURVES:
        return page_of("limits", title, [maps[0], *used], note=note)
    parts = batches(maps, max(1, MAP_ROWS_A_PAGE // len(rows)))
    return page_of("limits", title, *parts, used, note=note)


def axes_and_names(tracks: Tracks) -> tuple[list[JointAxis], list[str]]:
    """Return the axes of all limbs, with distinct names."""
    found = limbs(tracks)
    return [axis for limb in found for axis in limb.axes], [name for limb in found for name in limb.long]


def used_row(tracks: Tracks, kind: str, axes: Sequence[JointAxis], names: Sequence[str]) -> PlotRow | None:
    """Shares of the joints that come nearest to their limits, over time; None if none is limited."""
    peaks = []
    for axis, name in zip(axes, names, strict=True):
        found = np.concatenate([share(kind, axis, track.dense) for track in tracks])
        if np.isfinite(found).any():
            peaks.append((float(np.nanmax(found)), name, axis))
    chosen = sorted(peaks, key=lambda entry: -entry[0])[:MOST_USED]
    if not chosen:
        return None
    drawn = draw.told_apart(
        tracks, draw.numbered((name, partial(share, kind, axis)) for _, name, axis in chosen)
    )
    return draw.curve_row(f"used:{kind}", f"{kind}: most used", "share [1]", drawn, draw.share_axis)


def map_row(
    tracks: Tracks, number: int, groups: Sequence[Sequence[JointAxis]], names: Sequence[str], height: float
) -> PlotRow:
    """Return maps of one solution, of positions, velocities and torques: of each group its largest share.

    Where all limits are far beyond what is used, shares are of the largest value instead. On the right
    is the colour bar.
    """
    every = [axis for group in groups for axis in group]
    far = {kind: are_far(kind, every, [tracks[number].dense]) for kind in KINDS}

    def draw_map(axes: Axes, tracks: Tracks, kind: str) -> None:
        track = tracks[number]
        part = partial(largest_part, every) if far[kind] else largest_share
        shares = np.array([part(kind, group, track.dense) for group in groups]).T
        share_map(axes, track, names, shares, named=kind == KINDS[0], limited=not far[kind])

    which = "" if len(tracks) == 1 else f", {tracks[number].label}"
    scales = {kind: _scale_words(kind, every, tracks[number].dense) if far[kind] else "" for kind in KINDS}
    panels: tuple[PlotPanel, ...] = tuple(
        PlotPanel(
            name=f"share:{kind}:{number}",
            ylabel="",
            draw=partial(draw_map, kind=kind),
            gap=0.36,
            title=f"{kind}{which}{scales[kind]}",
            remark=f"{limit_words(kind, every)}, {BEYOND_AXIS}" if far[kind] else "",
        )
        for kind in KINDS
    )
    left = 0.25 + NAME_LETTER * max(len(name) for name in names)
    bar = PlotPanel(name="scale", ylabel="", draw=_scale, timed=False, wide=BAR, gap=BAR_GAP)
    panels = (*panels, bar)
    return PlotRow(title="", panels=panels, height=height, left=left, right=BAR_LABELS, rigid=True)


def largest_share(kind: str, group: Sequence[JointAxis], motion: MotionQuantities) -> np.ndarray:
    """The largest share (K,) of some axes; NaN where none has a limit."""
    return np.asarray(np.fmax.reduce([share(kind, axis, motion) for axis in group]))


def largest_part(
    every: Sequence[JointAxis], kind: str, group: Sequence[JointAxis], motion: MotionQuantities
) -> np.ndarray:
    """The largest magnitude (K,) of some axes over the largest that any of ``every`` axis has."""
    values = np.fmax.reduce([np.abs(value(kind, axis, motion)) for axis in group])
    return np.asarray(values / most_used(kind, every, motion))


def _scale_words(kind: str, every: Sequence[JointAxis], motion: MotionQuantities) -> str:
    units = ", ".join(dict.fromkeys(unit_of(kind, axis) for axis in every))
    return f", 100 % is {most_used(kind, every, motion):.3g} {units}"


def largest_row(tracks: Tracks) -> PlotRow | None:
    """The largest share over all joints of positions, velocities and torques; None where none is limited."""
    rows, _ = axes_and_names(tracks)
    curves = draw.numbered(((kind, partial(largest_share, kind, rows)) for kind in KINDS), dots=False)
    drawn = [
        curve for curve in curves if any(np.isfinite(curve.values(track.dense)).any() for track in tracks)
    ]
    if not drawn:
        return None
    title = "largest share of the limits"
    return draw.curve_row("largest share", title, "share [1]", drawn, draw.share_axis)


def _scale(axes: Axes, tracks: Tracks) -> None:
    """The colour bar of the maps."""
    import matplotlib as mpl

    ramp = np.linspace(0, 1, 256)[:, None]
    top = 100 * BEYOND_SHOWN
    axes.imshow(ramp, extent=(0, 1, 0, 100), aspect="auto", origin="lower", cmap=mpl.colormaps[style.SHARES])
    axes.axhspan(100, top, color=style.BEYOND, linewidth=0)
    axes.set(xlim=(0, 1), xticks=[], ylim=(0, top))
    axes.yaxis.tick_right()
    axes.set_yticks([0, 50, 100], ["0", "50", "100 %"])
    axes.tick_params(axis="y", labelsize=6.0, pad=1.0)
    axes.grid(False)


def share_map(
    axes: Axes, track: Track, names: Sequence[str], shares: np.ndarray, *, named: bool, limited: bool
) -> None:
    """A row for each name and its share (K, n) of a limit over time as a colour, its largest in per cent.

    A column of the picture shows the largest share within its time, so that no peak is lost. Values beyond
    the limit have a separate colour; NaN, where there is no limit, is left white. ``limited``: shares are of
    limits, and those close to them are bold.
    """
    import matplotlib as mpl

    start, end = track.phases[0].start, track.phases[-1].end
    grid = column_maxima(track.dense.t, shares, start, end)
    colours = mpl.colormaps[style.SHARES].with_extremes(over=style.BEYOND, bad="white")
    rows = len(names)
    axes.imshow(
        grid.T,
        extent=(start, end, rows - 0.5, -0.5),
        aspect="auto",
        interpolation="nearest",
        cmap=colours,
        vmin=0.0,
        vmax=1.0 + BEYOND,
    )
    axes.grid(False)
    for phase in track.phases[1:]:
        axes.axvline(phase.start, color=style.GREY, linewidth=0.4)
    axes.set_ylim(rows - 0.5, -0.5)
    axes.set_yticks(range(rows), list(names) if named else [""] * rows)
    axes.tick_params(axis="y", length=0, labelsize=6.5)
    for row in range(rows):
        finite = shares[:, row][np.isfinite(shares[:, row])]
        if finite.size:
            text = f"{100 * finite.max():.0f}"
            weight = "bold" if limited and finite.max() >= CLOSE else "normal"
            axes.text(
                1.015, row, text, transform=axes.get_yaxis_transform(), fontsize=6, va="center", weight=weight
            )


def column_maxima(t: np.ndarray, shares: np.ndarray, start: float, end: float) -> np.ndarray:
    """The largest of ``shares`` (K, n) in each of `COLUMNS` equal times; if it has none, the next sample."""
    edges = np.linspace(start, end, COLUMNS + 1)
    centres = (edges[1:] + edges[:-1]) / 2
    found = shares[np.clip(np.searchsorted(t, centres), 0, len(t) - 1)]
    column = np.clip(((t - start) / (end - start) * COLUMNS).astype(int), 0, COLUMNS - 1)
    np.fmax.at(found, column, shares)
    return found
