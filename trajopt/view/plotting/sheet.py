"""The figure of some topics: a heading, rows of axes with legends on the right, and notes at the foot."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from trajopt.view.plotting import style
from trajopt.view.plotting.joints import FAR
from trajopt.view.plotting.track import MotionQuantity, Track, failure_of, state_of, title_of
from trajopt.view.replay.motion import PhaseSpan

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Inches: width of a figure, which is that of A4; height of the axes of a row, and of one among many; and what
# a row and the figure need besides the axes.
WIDTH, ROW, LOW_ROW, ROW_TITLE, FRAME = 8.27, 1.25, 0.7, 0.38, 1.2
# The part of the figure within its margins: left, bottom, width and height as fractions.
PRINTED = (0.04, 0.015, 0.92, 0.97)
# Characters in a line of a note, and at most in each half of the title.
NOTE_LETTERS, TITLE_LETTERS = 150, 48
# Gap between panels over the width of their row, without and with labels of vertical axes.
GAP, LABELLED_GAP = 0.08, 0.125
# Points: gap above the axes, height of a remark there, and distance down to the exponent of tick labels.
PAD, REMARK, OFFSET_PAD = 2.0, 8.0, 2
# Inches: width of a letter in the names of phases, height of their line, and width of a row for them.
PHASE_LETTER, PHASE_LINE, PHASES = 0.05, 0.09, 6.5
# Distance between the markers of a curve over the diagonal of the axes.
EVERY = 0.2
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
# Margin of a vertical axis above and below the curves, and its least span in SI units: less is rounding.
MARGIN, LEAST_SPAN = 0.06, 1e-6


@dataclass(frozen=True, kw_only=True)
class Panel:
    """Labels of one pair of axes.

    Args:
        name: identifies the axes.
        title: heading.
        ylabel: of the vertical axis, with unit.
        remark: a line of small print below the heading.
    """

    name: str
    title: str = ""
    ylabel: str = ""
    remark: str = ""


@dataclass(frozen=True, kw_only=True)
class _Row:
    whole: Axes
    panels: Sequence[Axes]
    columns: int
    height: float
    timed: bool
    legend: bool


class Sheet:
    """A figure that topics fill with rows, from top to bottom.

    Attributes:
        tracks: the solutions.
        topics: titles of the drawn topics by name.
        notes: sentences at the foot.
    """

    def __init__(self, tracks: Sequence[Track], *, row_height: float = ROW) -> None:
        from matplotlib.figure import Figure
        from matplotlib.layout_engine import ConstrainedLayoutEngine

        layout = ConstrainedLayoutEngine(rect=PRINTED, h_pad=0.03, w_pad=0.03, hspace=0.0, wspace=0.0)
        self.figure: Figure = Figure(dpi=style.DOTS, layout=layout)
        self._printed = self.figure.add_subfigure(self.figure.add_gridspec(1, 1)[0, 0])  # within the margins
        self.tracks = tracks
        self.topics: dict[str, str] = {}
        self.notes: list[str] = []
        self._rows: list[_Row] = []
        self._row_height = row_height

    def draw(self, name: str, title: str, topic: Callable[[Sheet], None]) -> None:
        """Add the rows of a topic; it has none if it does not apply to the robot."""
        count = len(self._rows)
        topic(self)
        if len(self._rows) > count:
            self.topics[name] = title

    def panel(self, name: str, title: str, ylabel: str, remark: str = "", **row: Any) -> Axes:
        """Add a row of one panel; ``row`` holds further arguments of `row`."""
        return self.row(Panel(name=name, title=title, ylabel=ylabel, remark=remark), **row)[0]

    def grid(self, panels: Sequence[Panel], columns: int, *, legend: bool = False, **row: Any) -> list[Axes]:
        """Add panels in rows of ``columns``; ``legend``: that of the first row."""
        columns, axes = min(columns, len(panels)), []
        for start in range(0, len(panels), columns):
            part = panels[start : start + columns]
            axes += self.row(*part, columns=columns, legend=legend and not start, **row)
        return axes

    def row(
        self,
        *panels: Panel,
        columns: int | None = None,
        height: float | None = None,
        timed: bool = True,
        legend: bool = True,
    ) -> list[Axes]:
        """Add a row of panels side by side.

        Args:
            *panels: Their labels.
            columns: Number of panels that have room in the row; default all.
            height: Of the axes, inches; default that of the sheet.
            timed: Whether the horizontal axis is time.
            legend: Whether the labelled curves are listed on the right.
        """
        columns, whole = columns or len(panels), self._printed.add_subplot()
        axes = _side_by_side(whole, panels, columns)
        names_phases = timed and not any(row.timed for row in self._rows) and len(self.tracks[0].phases) > 1
        above = PAD + REMARK * any(panel.remark for panel in panels)
        for one, panel in zip(axes, panels, strict=True):
            _label(one, panel, PAD if names_phases else PAD + above)
            if timed:
                _draw_times(one, self.tracks)
            if names_phases:
                _name_phases(one, self.tracks[0].phases, PHASES / columns, above)
        row = _Row(
            whole=whole,
            panels=axes,
            columns=columns,
            height=self._row_height if height is None else height,
            timed=timed,
            legend=legend,
        )
        if self._rows and timed and self._rows[-1].timed and self._rows[-1].columns == columns:
            for one, _ in zip(self._rows[-1].panels, axes, strict=False):  # the times below are the same
                one.tick_params(labelbottom=False)
                one.set_xlabel("")
        self._rows.append(row)
        return axes

    def finish(self, footer: str) -> None:
        """Place the rows and write heading, legends and notes."""
        heights = [row.height for row in self._rows]
        grid = self._printed.add_gridspec(len(heights), 1, height_ratios=heights)
        for number, row in enumerate(self._rows):
            row.whole.set_subplotspec(grid[number, 0])
            entries: dict[str, Any] = {}
            for one in row.panels:
                for line, label in zip(*one.get_legend_handles_labels(), strict=True):
                    entries.setdefault(label, line)  # that of the first solution
            if row.legend and entries:
                row.panels[-1].legend(entries.values(), entries, loc="upper left", bbox_to_anchor=(1.005, 1))
        self.figure.set_size_inches(WIDTH, FRAME + sum(ROW_TITLE + height for height in heights))
        note = "\n".join([*textwrap.wrap(" ".join(dict.fromkeys(self.notes)), NOTE_LETTERS), footer])
        self._printed.supxlabel(note, x=0.0, ha="left", fontsize=style.TINY, color=style.GREY)
        self._draw_heading()

    def _draw_heading(self) -> None:
        """Write the title, and for each solution its line style and state; failed ones are red."""
        from matplotlib.lines import Line2D

        tracks = self.tracks
        lines = [Line2D([], [], color=style.BLACK, linestyle=style.line_style(i)) for i in range(len(tracks))]
        names = [f"{style.short(track.label)}:  " if len(tracks) > 1 else "" for track in tracks]
        words = [failure_of(track) or state_of(track) for track in tracks]
        topics = style.short(", ".join(self.topics.values()), TITLE_LETTERS)
        title = f"{style.short(title_of(tracks), TITLE_LETTERS)}: {topics}"
        legend = self._printed.legend(
            lines, [style.literal(name + state) for name, state in zip(names, words, strict=True)],
            title=style.literal(title),
            loc="outside upper left", alignment="left", handlelength=3.2, handletextpad=1.0, borderpad=0.5,
            title_fontproperties={"weight": "bold", "size": style.TITLE},
        )  # fmt: skip
        for text, track in zip(legend.get_texts(), tracks, strict=True):
            failed = failure_of(track)
            text.set(color=style.RED if failed else style.GREY, weight="bold" if failed else "normal")


def _side_by_side(whole: Axes, panels: Sequence[Panel], columns: int) -> list[Axes]:
    """Return axes for each panel within those of the whole row, so that the edges of all rows are aligned."""
    if columns == 1:
        return [whole]
    whole.set_axis_off()
    gap = LABELLED_GAP if any(panel.ylabel for panel in panels[1:]) else GAP
    width = (1.0 - gap * (columns - 1)) / columns
    return [whole.inset_axes((i * (width + gap), 0.0, width, 1.0)) for i in range(len(panels))]


def _label(axes: Axes, panel: Panel, pad: float) -> None:
    axes.set_label(panel.name)
    axes.set_ylabel(panel.ylabel)
    axes.yaxis.get_offset_text().set(fontsize=style.SMALLEST, va="top")
    axes.yaxis.OFFSETTEXTPAD = -OFFSET_PAD  # inside, below title and remark
    axes.set_title(style.literal(panel.title), loc="left", weight="bold", pad=pad)
    axes.annotate(
        style.literal(panel.remark), (0.0, 1.0), (0.0, PAD), xycoords="axes fraction",
        textcoords="offset points", fontsize=style.TINY, color=style.GREY, in_layout=False,
    )  # fmt: skip


def _draw_times(axes: Axes, tracks: Sequence[Track]) -> None:
    """Set the time axis, shade phases, mark impacts and the other solutions' phase changes."""
    axes.set_xlim(
        min(track.phases[0].start for track in tracks), max(track.phases[-1].end for track in tracks)
    )
    for phase in tracks[0].phases[1::2]:
        axes.axvspan(phase.start, phase.end, color=style.BAND, linewidth=0, zorder=0)
    for phase in (phase for track in tracks[1:] for phase in track.phases[1:]):
        axes.axvline(phase.start, color=style.GREY, linewidth=0.5, linestyle=":", zorder=1)
    for time in (time for track in tracks for time in track.impact_times):
        axes.axvline(time, color=style.RED, linewidth=0.7, linestyle=(0, (1, 1)), zorder=1)
    axes.set_xlabel("time t [s]")


def _name_phases(axes: Axes, spans: Sequence[PhaseSpan], width: float, pad: float) -> None:
    """Write the names of phases above axes ``width`` inches wide: rotated if long, none for slivers."""
    inch = width / (axes.get_xlim()[1] - axes.get_xlim()[0])
    phases = [(phase, inch * (phase.end - phase.start)) for phase in spans]
    upright = any(PHASE_LETTER * len(phase.name) > room for phase, room in phases)
    shown = [phase for phase, room in phases if room > PHASE_LINE]
    axes.xaxis.remove_overlapping_locs = False  # a name may stand above a number
    middles = [(phase.start + phase.end) / 2 for phase in shown]
    axes.set_xticks(middles, [style.literal(phase.name) for phase in shown], minor=True)
    axes.tick_params(
        axis="x", which="minor", bottom=False, labelbottom=False, labeltop=True, pad=pad,
        labelsize=style.SMALLEST, labelcolor=style.GREY, labelrotation=90 if upright else 0,
    )  # fmt: skip


def line_look(
    tracks: Sequence[Track], track: Track, number: int, count: int, *, apart: bool = False
) -> dict[str, Any]:
    """Return Matplotlib's keywords for a line of a solution, one of ``count`` in a panel.

    If the lines may overlap, as those of left and right feet, they are told ``apart``: with one solution each
    has its own line style, with several later ones are thinner. Markers are those of the first solution.
    """
    overlaid = apart and len(tracks) == 1
    thicker = THICKER * (count - 1 - number) if apart and not overlaid else 0.0
    return {
        "color": style.colour(number),
        "linewidth": 1.1 + thicker,
        "linestyle": style.OVERLAID[number % len(style.OVERLAID)] if overlaid else track.line_style,
        "marker": style.MARKERS[number % len(style.MARKERS)] if track is tracks[0] else "",
        "markersize": 3.4,
        "markerfacecolor": "white",
        "markeredgewidth": 0.7,
    }


def curves(
    axes: Axes,
    tracks: Sequence[Track],
    named: Mapping[str, MotionQuantity],
    *,
    apart: bool = False,
    dots: bool = True,
    **look: Any,
) -> None:
    """Draw quantities (K,) of every solution by name, without those that are finite nowhere.

    Args:
        axes: With time as the horizontal axis.
        tracks: The solutions.
        named: The quantities; their numbers give colours and markers.
        apart: See `line_look`.
        dots: Whether collocation points of the first solution are drawn, if they are few.
        **look: Further keywords of Matplotlib.
    """
    shown = [
        (number, label, values)
        for number, (label, values) in enumerate(named.items())
        if any(np.isfinite(values(track.dense)).any() for track in tracks)
    ]
    n_points = sum(int(track.solution.collocation.sum()) for track in tracks) * len(named)
    dots = dots and n_points <= MOST_DOTS and not (apart and len(tracks) == 1)
    for track in tracks:
        for number, label, values in shown:
            t, y = track.curve(values)
            line = line_look(tracks, track, number, len(named), apart=apart) | look
            # Interleaved between curves; Matplotlib fails to place them on a line without finite values.
            marks = ((number + 0.5) / len(named) * EVERY, EVERY) if np.isfinite(y).any() else None
            name = style.literal(label).lstrip("_")  # Matplotlib hides labels with an underscore
            axes.plot(t, y, label=name, markevery=marks, zorder=3 - 0.1 * track.number, **line)
            if dots and track.number == 0:
                axes.plot(*track.at_points(values), color=line["color"], zorder=3.5, **style.DOTTED)


def column(values: MotionQuantity, i: int) -> MotionQuantity:
    """Return column ``i`` (K,) of a quantity (K, n)."""
    return lambda motion: np.asarray(values(motion)[:, i])


def fit(axes: Axes, *, zero: bool = False) -> tuple[float, float]:
    """Fit the vertical axis to the curves, with zero if wanted; returns their smallest and largest value."""
    values = drawn_values(axes)
    if not values.size:
        axes.set_ylim(-1, 1)
        axes.text(0.5, 0.5, "no finite value", transform=axes.transAxes, ha="center", color=style.GREY)
        return 0.0, 0.0
    low, high = float(values.min()), float(values.max())
    set_range(axes, min(low, 0.0) if zero else low, max(high, 0.0) if zero else high)
    return low, high


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


def set_range(axes: Axes, bottom: float, top: float) -> None:
    """Set the vertical axis to a range with a margin; the span is at least `LEAST_SPAN`."""
    span = max(top - bottom, LEAST_SPAN, 1e-9 * max(abs(top), abs(bottom)))
    grown = (span - (top - bottom)) / 2 + MARGIN * span
    axes.set_ylim(bottom - grown, top + grown)


def drawn_values(axes: Axes) -> np.ndarray:
    """Return the finite ordinates (n,) of the curves, i.e. of the labelled lines."""
    lines = [line for line in axes.get_lines() if not str(line.get_label()).startswith("_")]
    values = np.concatenate([np.zeros(0), *[np.asarray(line.get_ydata(), dtype=float) for line in lines]])
    return values[np.isfinite(values)]
