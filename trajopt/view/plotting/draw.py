"""Drawing into one pair of axes, and a page as data: rows of panels."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from trajopt.view.plotting import style
from trajopt.view.plotting.joints import FAR
from trajopt.view.plotting.track import MotionQuantity, Track

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Tracks = Sequence[Track]
Draw = Callable[["Axes", Tracks], None]
_Item = TypeVar("_Item")
# Number of markers on a curve along the time axis.
MARKS = 6
# With more collocation points than this in one panel, none are drawn.
MOST_DOTS = 400
# Least upper end of an axis for shares of a limit, so that the limit is visible.
SHOWN = 1.05
# Height of an axis over that of its curves, with room for the remark that the limit is beyond the axis.
HEADROOM = 1.25
# Difference in width between curves that overlap, points.
THICKER = 0.4
LIMIT: dict[str, Any] = {"color": style.BLACK, "linewidth": 0.8, "linestyle": (0, (6, 2))}
# Look of the range beyond a limit.
HATCHED: dict[str, Any] = {"facecolor": "none", "edgecolor": style.GREY, "hatch": "////", "lw": 0}
# Margin of a vertical axis above and below the curves.
MARGIN = 0.06


@dataclass(frozen=True, kw_only=True)
class PlotPanel:
    """One pair of axes: the label of its vertical axis, with unit, and its draw function.

    ``title`` is the heading, ``remark`` a line of small print below it.
    """

    name: str
    ylabel: str
    draw: Draw
    title: str = ""
    remark: str = ""


@dataclass(frozen=True, kw_only=True)
class PlotRow:
    """A row of panels side by side.

    Args:
        panels: from left to right.
        timed: whether the horizontal axis is time.
        legend: whether the labelled curves are listed on the right.
        height: of the axes, in units of a normal row.
        rigid: whether the height is fixed; other rows are scaled to the page.
    """

    panels: Sequence[PlotPanel]
    timed: bool = True
    legend: bool = True
    height: float = 1.0
    rigid: bool = False


@dataclass(frozen=True, kw_only=True)
class PlotPage:
    """A page: its ``name`` and ``title``, its rows, and a ``note`` at the foot."""

    name: str
    title: str
    rows: Sequence[PlotRow]
    note: str = ""


def panel_row(name: str, title: str, ylabel: str, draw: Draw, remark: str = "", **row: Any) -> PlotRow:
    """Return a row with one panel; ``row`` holds further fields of the row."""
    panel = PlotPanel(name=name, ylabel=ylabel, draw=draw, title=title, remark=remark)
    return PlotRow(panels=(panel,), **row)


def page_of(name: str, title: str, *parts: Iterable[PlotRow | None], note: str = "") -> list[PlotPage]:
    """Return a page for each part, with its rows that are not None; parts without rows are left out."""
    present = [[row for row in part if row is not None] for part in parts]
    return [PlotPage(name=name, title=title, rows=rows, note=note) for rows in present if rows]


def batches(items: Sequence[_Item], size: int) -> list[Sequence[_Item]]:
    """Return the items in order, ``size`` at a time."""
    return [items[start : start + size] for start in range(0, len(items), size)]


@dataclass(frozen=True, kw_only=True)
class Curve:
    """One curve: its name in the legend, its values (K,) of a motion, and the number of its colour.

    A ``marked`` curve has markers; ``dots`` shows its collocation points if there are few. ``line`` is an
    index of `style.OVERLAID`, for plots of one solution.
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
        """The curve's own shade, or else the colour of its number."""
        return self.shade or style.colour(self.number)

    def look(self, tracks: Tracks, solution: int, *, marked: bool = True) -> dict[str, Any]:
        """Return Matplotlib's keywords for the line; each of several solutions has its own line style."""
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
    """Return a curve for each label and quantity, numbered in order; ``look``: further fields of all."""
    return [Curve(label=label, values=values, number=i, **look) for i, (label, values) in enumerate(named)]


def told_apart(tracks: Tracks, drawn: Sequence[Curve]) -> list[Curve]:
    """Return curves that stay visible where they overlap, as those of left and right feet may.

    With one solution each curve has its own line style; with several, later curves are thinner.
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
    """Return the indices of samples with a marker: evenly spaced in time, interleaved between curves."""
    wanted = t[0] + (t[-1] - t[0]) * (np.arange(MARKS) + (number % count + 0.5) / count) / MARKS
    samples = np.unique(np.clip(np.searchsorted(t, wanted), 0, len(t) - 1))
    return [int(i) for i in samples if np.isfinite(y[i])]


def fit(axes: Axes, *, zero: bool = False, least: float = 0.0) -> tuple[float, float]:
    """Fit the vertical axis to the lines; returns their smallest and largest value.

    ``zero`` includes zero. ``least`` is the smallest span, so that rounding does not look like a curve.
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
    """Fit the vertical axis so that it includes zero, and mark zero by a line."""
    fit(axes, zero=True)
    axes.axhline(0.0, **look)


def share_axis(axes: Axes, edge: str | None = None) -> None:
    """Fit the axis to shares of a limit: the limit is marked, and the range beyond it hatched.

    If only a small part of the limit is used, the axis ends above that part and says so. ``edge`` is the name
    of the limit in the legend.
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
    """Write a remark in small print into the upper right corner of the axes."""
    look: dict[str, Any] = {"fontsize": style.TINY, "color": style.GREY, "ha": "right", "va": "top"}
    axes.text(0.995, 0.96, style.literal(text), transform=axes.transAxes, **look)


def set_range(axes: Axes, bottom: float, top: float, least: float = 0.0) -> None:
    """Set the vertical axis to a range with a margin; the span is at least ``least``."""
    span = max(top - bottom, least, 1e-9 * max(abs(top), abs(bottom)), 1e-12)
    grown = (span - (top - bottom)) / 2 + MARGIN * span
    axes.set_ylim(bottom - grown, top + grown)


def drawn_values(axes: Axes) -> np.ndarray:
    """Return the finite ordinates (n,) of the curves, i.e. of the labelled lines."""
    lines = [line for line in axes.get_lines() if not str(line.get_label()).startswith("_")]
    values = np.concatenate([np.zeros(0), *[np.asarray(line.get_ydata(), dtype=float) for line in lines]])
    return values[np.isfinite(values)]
