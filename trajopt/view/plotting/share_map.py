"""Shares of limits as a map: a row for each joint, time across, dark where a limit is used up."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from trajopt.view.plotting import style
from trajopt.view.plotting.track import Track

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# A share of the limit from which its number is bold, and how far beyond 1 counts as on the limit.
CLOSE, BEYOND = 0.98, 1e-4
COLUMNS = 400


def share_map(axes: Axes, track: Track, names: Sequence[str], shares: np.ndarray, *, named: bool) -> None:
    """A row for each name and its share (K, n) of a limit over time as a colour, its largest in per cent.

    A column of the picture shows the largest share within its time, so that no peak is lost. What is beyond
    the limit has a colour of its own; NaN, where there is no limit, is left white.
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
            weight = "bold" if finite.max() >= CLOSE else "normal"
            axes.text(
                1.015, row, text, transform=axes.get_yaxis_transform(), fontsize=6, va="center", weight=weight
            )


def column_maxima(t: np.ndarray, shares: np.ndarray, start: float, end: float) -> np.ndarray:
    """The largest of ``shares`` (K, n) in each of `COLUMNS` equal times; between samples those around."""
    edges = np.linspace(start, end, COLUMNS + 1)
    found = np.full((COLUMNS, shares.shape[1]), np.nan)
    centres = (edges[1:] + edges[:-1]) / 2
    nearest = np.clip(np.searchsorted(t, centres), 0, len(t) - 1)
    found[:] = shares[nearest]
    column = np.clip(((t - start) / (end - start) * COLUMNS).astype(int), 0, COLUMNS - 1)
    for row, place in enumerate(column):
        found[place] = np.fmax(found[place], shares[row])
    return found
