"""Drawing into one pair of axes: curves of all solutions, and vertical axes with limits."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from trajopt.view.plotting import style
from trajopt.view.plotting.page import PlotRow, Tracks, panel_row
from trajopt.view.plotting.track import MotionQuantity

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Number of markers on a curve along the time axis.
MARKS = 6
# With more collocation points than this in one panel, none are drawn.
MOST_DOTS = 400
# Least upper end of an axis for shares of a limit, so that the limit is visible.
SHOWN = 1.05
# A limit this many times what is used, as a description's placeholder of 1000 rad/s, is not drawn to scale;
# the axis has this much room above the curves for the line that says so.
FAR, HEADROOM = 20.0, 1.25
# Points by which each of several curves on each other is thicker than the next.
THICKER = 0.4
LIMIT: dict[str, Any] = {"color": style.BLACK, "linewidth": 0.8, "linestyle": (0, (6, 2))}
# What lies beyond a limit.
HATCHED: dict[str, Any] = {"facecolor": "none", "edgecolor": style.GREY, "hatch": "////", "lw": 0}
# Margin of a vertical axis above and below the curves.
MARGIN = 0.06


@dataclass(frozen=True, kw_only=True)
class Curve:
    """One quantity: its name in the legend, its values (K,) of a motion, and the number of its colour.

    ``marked``: with markers; ``dots``: with its collocation points where they are few. ``line``: of
    `style.OVERLAID`, for a plot of one solution.
    """

    label: str
    values: MotionQuantity
    number: int = 0
    marked: bool = True
    dots: bool = True
    width: float = 1.1
    shade: str = ""
    line: int = 0

    @property
    def colour(self) -> str:
        """Its own shade, else the colour of its number."""
        return self.shade or style.colour(self.number)

    def look(self, tracks: Tracks, solution: int, *, marked: bool = True) -> dict[str, Any]:
        """Return the keywords of its line for a solution; of several solutions each has its line style."""
        overlaid = style.OVERLAID[self.line % len(style.OVERLAID)]
        return {
            "label": style.literal(self.label).lstrip("_"),  # Matplotlib hides labels with an underscore
            "color": self.colour,
            "linewidth": self.width,
            "linestyle": style.line_style(solution) if len(tracks) > 1 else overlaid,
            "marker": style.MARKERS[self.number % len(style.MARKERS)] if self.marked and marked else "",
            "markersize": 3.4,
            "markerfacecolor": "white",
            "markeredgewidth": 0.7,
        }


def column(values: MotionQuantity, i: int) -> MotionQuantity:
    """Return column ``i`` (K,) of a quantity (K, n)."""
    return lambda motion: np.asarray(values(motion)[:, i])


def numbered(named: Iterable[tuple[str, MotionQuantity]], **look: Any) -> list[Curve]:
    """Return a curve for each label with its values, numbered in order; ``look``: more fields of all."""
    return [Curve(label=label, values=values, number=i, **look) for i, (label, values) in enumerate(named)]


def told_apart(tracks: Tracks, drawn: Sequence[Curve]) -> list[Curve]:
    """Return curves that may lie on each other, as those of left and right feet, so that each is seen.

    Of one solution each has its own line style; of several, whose line styles differ, later ones are thinner.
    """
    if len(tracks) == 1:
        return [replace(curve, line=number, dots=False) for number, curve in enumerate(drawn)]
    last = len(drawn) - 1
    return [
        replace(curve, width=curve.width + THICKER * (last - number)) for number, curve in enumerate(drawn)
    ]


def curve_row(
    name: str,
    title: str,
    ylabel: str,
    drawn: Sequence[Curve],
    scale: Callable[[Axes], object] | None = None,
    **row: Any,
) -> PlotRow:
    """Return a row with one panel of curves over time.

    Args:
        name: Of the panel.
        title: Of the row.
        ylabel: Label of the vertical axis with its unit.
        drawn: The curves.
        scale: Sets the vertical axis; default `fit`.
        **row: More fields of the row.
    """

    def draw(axes: Axes, tracks: Tracks) -> None:
        curves(axes, tracks, drawn)
        (scale or fit)(axes)

    return panel_row(name, title, ylabel, draw, **row)


def curves(axes: Axes, tracks: Tracks, drawn: Sequence[Curve], *, plans_only: bool = False) -> None:
    """Draw curves of every solution; markers and collocation points are those of the first."""
    few = sum(int(t.solution.collocation.sum()) for t in tracks) * len(drawn) <= MOST_DOTS
    shown = [(number, track) for number, track in enumerate(tracks) if track.is_plan or not plans_only]
    for number, track in shown:
        first = number == shown[0][0]
        for curve in drawn:
            t, y = track.curve(curve.values)
            marks = marker_samples(t, y, curve.number, len(drawn)) if first else None
            look = curve.look(tracks, number, marked=first)
            axes.plot(t, y, markevery=marks, zorder=3 - 0.1 * number, **look)
            if few and curve.dots and number == 0:
                axes.plot(*track.at_points(curve.values), color=curve.colour, zorder=3.5, **style.DOTTED)


def marker_samples(t: np.ndarray, y: np.ndarray, number: int, count: int) -> list[int]:
    """Return the samples with a marker: evenly in time, those of several curves interleaved."""
    wanted = t[0] + (t[-1] - t[0]) * (np.arange(MARKS) + (number % count + 0.5) / count) / MARKS
    samples = np.unique(np.clip(np.searchsorted(t, wanted), 0, len(t) - 1))
    return [int(i) for i in samples if np.isfinite(y[i])]


def fit(axes: Axes, *, zero: bool = False, least: float = 0.0) -> tuple[float, float]:
    """Set the vertical axis to the lines' range; returns their least and largest value.

    ``zero``: include zero. ``least``: span at least that much, so that rounding does not look like a curve.
    """
    values = drawn_values(axes)
    if not values.size:
        axes.set_ylim(-1, 1)
        axes.text(0.5, 0.5, "no finite value", transform=axes.transAxes, ha="center", color=style.GREY)
        return 0.0, 0.0
    low, high = float(values.min()), float(values.max())
    set_range(axes, min(low, 0.0) if zero else low, max(high, 0.0) if zero else high, least)
    return low, high


def fit_with_zero_line(axes: Axes, **look: Any) -> None:
    """Fit the vertical axis with zero in it, and mark zero by a line."""
    fit(axes, zero=True)
    axes.axhline(0.0, **look)


def share_axis(axes: Axes, edge: str | None = None) -> None:
    """Fit shares of a limit: from 0 to the limit, which is marked, and the range beyond it, hatched.

    Where only a small part of the limit is used, the axis ends at that, and says so. ``edge`` is the name of
    the limit in the legend.
    """
    _, high = fit(axes, zero=True)
    if 0 < high < 1 / FAR:
        set_range(axes, 0.0, HEADROOM * high)
        remark_inside(axes, "limit 1, beyond the axis")
        return
    set_range(axes, 0.0, max(SHOWN, high))
    axes.axhline(1.0, label=edge, **LIMIT)
    axes.axhspan(1.0, axes.get_ylim()[1], **HATCHED)
    if high <= SHOWN:
        axes.set_yticks([0.0, 0.5, 1.0])


def remark_inside(axes: Axes, text: str) -> None:
    """Write small letters into the upper right corner of the axes."""
    look: dict[str, Any] = {"fontsize": style.TINY, "color": style.GREY, "ha": "right", "va": "top"}
    axes.text(0.995, 0.96, style.literal(text), transform=axes.transAxes, **look)


def set_range(axes: Axes, bottom: float, top: float, least: float = 0.0) -> None:
    """Set the vertical axis to a range with a margin, and to at least a span of its own size."""
    span = max(top - bottom, least, 1e-9 * max(abs(top), abs(bottom)), 1e-12)
    grown = (span - (top - bottom)) / 2 + MARGIN * span
    axes.set_ylim(bottom - grown, top + grown)


def drawn_values(axes: Axes) -> np.ndarray:
    """Return the finite ordinates (n,) of the curves, i.e. of lines with a curve's name."""
    lines = [line for line in axes.get_lines() if not str(line.get_label()).startswith("_")]
    values = np.concatenate([np.zeros(0), *[np.asarray(line.get_ydata(), dtype=float) for line in lines]])
    return values[np.isfinite(values)]
