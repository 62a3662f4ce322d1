"""The page about shares of limits: maps over time of all joints, curves of the most used."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from trajopt.view.plotting import draw, style
from trajopt.view.plotting.draw import PlotPage, PlotPanel, PlotRow, Tracks, batches, page_of
from trajopt.view.plotting.joints import (
    BEYOND,
    KINDS,
    JointAxis,
    are_far,
    limit_words,
    most_used,
    share,
    units_of,
    value,
)
from trajopt.view.plotting.motion import PlottedMotion
from trajopt.view.plotting.topics_joints import limbs
from trajopt.view.plotting.track import Track

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

# Row height of a map of shares in units of a row's height, and the least height of a map.
MAP_ROW, LEAST_MAP = 0.105, 0.6
# Rows of maps on a page, and beside curves.
MAP_ROWS_A_PAGE, MAP_ROWS_WITH_CURVES = 56, 26
# Share from which its number is bold, and tolerance above 1 that still counts as on the limit.
CLOSE, ON_LIMIT = 0.98, 1e-4
COLUMNS = 400
# The colour bar: left edge, lower edge, width and height over those of the map on its left.
BAR = (1.22, 0.0, 0.04, 1.0)
# Number of joints whose shares are drawn as curves: those that come nearest to their limits.
MOST_USED = 5


def limit_pages(tracks: Tracks) -> list[PlotPage]:
    """Maps of the shares of all limits over time, for each solution."""
    rows, names = axes_and_names(tracks)
    if not rows:
        return []
    maps = [map_row(tracks, number, [[axis] for axis in rows], names) for number in range(len(tracks))]
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
    every = limbs(tracks)
    return [axis for limb in every for axis in limb.axes], [name for limb in every for name in limb.long]


def used_row(tracks: Tracks, kind: str, axes: Sequence[JointAxis], names: Sequence[str]) -> PlotRow | None:
    """Shares of the joints that come nearest to their limits, over time; None if none is limited."""
    peaks = []
    for axis, name in zip(axes, names, strict=True):
        shares = np.concatenate([share(kind, axis, track.dense) for track in tracks])
        if np.isfinite(shares).any():
            peaks.append((float(np.nanmax(shares)), name, axis))
    chosen = sorted(peaks, key=lambda entry: -entry[0])[:MOST_USED]
    if not chosen:
        return None
    drawn = draw.numbered((name, partial(share, kind, axis)) for _, name, axis in chosen)
    title, drawn = f"{kind}: most used", draw.told_apart(tracks, drawn)
    return draw.curve_row(f"used:{kind}", title, "share [1]", drawn, draw.share_axis)


def map_row(
    tracks: Tracks, number: int, groups: Sequence[Sequence[JointAxis]], names: Sequence[str]
) -> PlotRow:
    """Return maps of a solution's positions, velocities and torques: the largest share of each group.

    If all limits are far beyond the values, shares are of the largest value instead. The colour bar is on the
    right.
    """
    every, motion = [axis for group in groups for axis in group], tracks[number].dense
    panels = []
    for kind in KINDS:
        far, scale = are_far(kind, every, motion), most_used(kind, every, motion)
        of = partial(largest_part, scale) if far else largest_share
        panels.append(
            PlotPanel(
                name=f"share:{kind}:{number}",
                ylabel="",
                draw=partial(_map, number=number, groups=groups, names=names, kind=kind, of=of),
                title=kind
                + (f", {tracks[number].label}" if len(tracks) > 1 else "")
                + (f", 100 % is {scale:.3g} {units_of(kind, every)}" if far else ""),
                remark=f"{limit_words(kind, every)}, {BEYOND}" if far else "",
            )
        )
    return PlotRow(panels=panels, height=max(LEAST_MAP, MAP_ROW * len(names)), rigid=True)


def largest_share(kind: str, group: Sequence[JointAxis], motion: PlottedMotion) -> np.ndarray:
    """The largest share (K,) of a group of axes; NaN if none has a limit."""
    return np.asarray(np.fmax.reduce([share(kind, axis, motion) for axis in group]))


def largest_part(scale: float, kind: str, group: Sequence[JointAxis], motion: PlottedMotion) -> np.ndarray:
    """The largest magnitude (K,) of a group of axes over ``scale``."""
    return np.asarray(np.fmax.reduce([np.abs(value(kind, axis, motion)) for axis in group]) / scale)


def largest_row(tracks: Tracks) -> PlotRow | None:
    """The largest share over all joints of positions, velocities and torques; None if none is limited."""
    rows, _ = axes_and_names(tracks)
    curves = draw.numbered(((kind, partial(largest_share, kind, rows)) for kind in KINDS), dots=False)
    drawn = [
        curve for curve in curves if any(np.isfinite(curve.values(track.dense)).any() for track in tracks)
    ]
    title = "largest share of the limits"
    return draw.curve_row("largest share", title, "share [1]", drawn, draw.share_axis) if drawn else None


def _map(
    axes: Axes,
    tracks: Tracks,
    number: int,
    groups: Sequence[Sequence[JointAxis]],
    names: Sequence[str],
    kind: str,
    of: Callable[[str, Sequence[JointAxis], PlottedMotion], np.ndarray],
) -> None:
    track = tracks[number]
    shares = np.array([of(kind, group, track.dense) for group in groups]).T
    image = share_map(axes, track, names, shares, limited=of is largest_share)
    if kind != KINDS[0]:
        axes.tick_params(axis="y", labelleft=False)
    if kind == KINDS[-1]:
        bar = axes.figure.colorbar(image, cax=axes.inset_axes(BAR, label="scale"), extend="max")
        bar.set_ticks([0.0, 0.5, 1.0], labels=["0", "50", "100 %"])


def share_map(
    axes: Axes, track: Track, names: Sequence[str], shares: np.ndarray, *, limited: bool
) -> AxesImage:
    """Draw shares (K, n) of limits over time as colours: a row for each name, with its largest in per cent.

    A column of the picture shows the largest share within its time, so that no peak is lost. Values beyond
    the limit have a separate colour; NaN, where there is no limit, is left white. With ``limited``, shares
    are of limits, and those close to 1 are bold.
    """
    import matplotlib as mpl

    start, end, bottom = track.phases[0].start, track.phases[-1].end, len(names) - 0.5
    image = axes.imshow(
        column_maxima(track.dense.t, shares, start, end).T,
        extent=(start, end, bottom, -0.5),
        aspect="auto",
        interpolation="nearest",
        cmap=mpl.colormaps[style.SHARES].with_extremes(over=style.BEYOND, bad="white"),
        vmin=0.0,
        vmax=1.0 + ON_LIMIT,
    )
    axes.grid(False)
    for phase in track.phases[1:]:
        axes.axvline(phase.start, color=style.GREY, linewidth=0.4)
    axes.set_ylim(bottom, -0.5)
    axes.set_yticks(range(len(names)), names)
    axes.tick_params(axis="y", length=0, labelsize=style.TINY)
    for row, peak in enumerate(np.fmax.reduce(np.where(np.isfinite(shares), shares, np.nan))):
        if np.isfinite(peak):
            weight = "bold" if limited and peak >= CLOSE else "normal"
            look: dict[str, Any] = {"fontsize": style.SMALLEST, "va": "center", "weight": weight}
            axes.text(1.015, row, f"{100 * peak:.0f}", transform=axes.get_yaxis_transform(), **look)
    return image


def column_maxima(t: np.ndarray, shares: np.ndarray, start: float, end: float) -> np.ndarray:
    """The largest of ``shares`` (K, n) in each of `COLUMNS` equal spans; the next sample if it has none."""
    edges = np.linspace(start, end, COLUMNS + 1)
    centres = (edges[1:] + edges[:-1]) / 2
    maxima = shares[np.clip(np.searchsorted(t, centres), 0, len(t) - 1)]
    column = np.clip(((t - start) / (end - start) * COLUMNS).astype(int), 0, COLUMNS - 1)
    np.fmax.at(maxima, column, shares)
    return maxima
