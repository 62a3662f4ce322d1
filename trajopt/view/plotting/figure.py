"""Pages as a figure: a heading, rows of panels with their legends on the right, and a note at the foot."""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from trajopt.view.plotting import style
from trajopt.view.plotting.draw import PlotPage, PlotRow, Tracks
from trajopt.view.plotting.track import failure_of, state_of, title_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

# The printed part of a page: left, bottom, width and height as fractions of the page.
PRINTED = (0.04, 0.025, 0.92, 0.95)
# Approximate height besides the axes, inches: of heading, foot and margins, of the title of a row, and of a
# labelled horizontal axis.
FRAME, ROW_TITLE, X_AXIS = 1.4, 0.25, 0.3
# Height of a normal row's axes, inches; its largest scale on an empty page, and its smallest in a picture,
# which may be taller than A4.
UNIT, GROWTH, LEAST = 1.3, 1.6, 0.5
# Characters in a line of a note, and at most in the title.
NOTE_LETTERS, TITLE_LETTERS = 150, 64
# Gap between panels over the width of their row, without and with labels of vertical axes.
GAP, LABELLED_GAP = 0.08, 0.125
# Points: gap above the axes, height of a remark there, and distance down to the exponent of tick labels.
PAD, REMARK, OFFSET_PAD = 2.0, 8.0, 2
# Inches: width of a letter in the names of phases, height of their line, and width of a page for them.
PHASE_LETTER, PHASE_LINE, PHASES = 0.05, 0.09, 6.5


def figure_of(pages: Sequence[PlotPage], tracks: Tracks, *, fixed: bool = False, footer: str = "") -> Figure:
    """Draw pages below one another in the width of A4; ``fixed`` pages also have its height."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    heights = [_heights(page, fixed=fixed) for page in pages]
    totals = [
        style.HEIGHT if fixed else sum(rows) + _around(page)
        for page, rows in zip(pages, heights, strict=True)
    ]
    with style.look():
        layout = ConstrainedLayoutEngine(rect=PRINTED, h_pad=0.03, w_pad=0.03, hspace=0.0, wspace=0.0)
        figure = Figure(figsize=(style.WIDTH, sum(totals)), dpi=style.DOTS, layout=layout)
        parts = figure.subfigures(len(pages), 1, height_ratios=totals, squeeze=False)[:, 0]
        for part, page, rows in zip(parts, pages, heights, strict=True):
            _draw_page(part, page, tracks, rows, footer)
    return figure


def _around(page: PlotPage) -> float:
    """Approximate height that a page needs besides its axes, inches."""
    return FRAME + sum(ROW_TITLE + X_AXIS * labelled for labelled in _labelled(page.rows))


def _heights(page: PlotPage, *, fixed: bool) -> list[float]:
    """Height of the axes of each row, and of the empty rest of a ``fixed`` page, inches."""
    rigid, free = (UNIT * sum(row.height for row in page.rows if row.rigid is kind) for kind in (True, False))
    room = style.HEIGHT - _around(page) - rigid
    scale = room / free if free else 1.0
    scale = min(GROWTH, scale) if fixed else min(1.0, max(LEAST, scale))
    heights = [UNIT * row.height * (1.0 if row.rigid else scale) for row in page.rows]
    return [*heights, room - scale * free] if fixed and room > scale * free + ROW_TITLE else heights


def _labelled(rows: Sequence[PlotRow]) -> list[bool]:
    """Whether the horizontal axis of each row is labelled: not if the next row repeats its times."""
    return [
        not (after and row.timed and after.timed and len(row.panels) == len(after.panels))
        for row, after in itertools.zip_longest(rows, rows[1:])
    ]


def _draw_page(part: SubFigure, page: PlotPage, tracks: Tracks, heights: list[float], footer: str) -> None:
    _draw_heading(part, page, tracks)
    note = "\n".join([*textwrap.wrap(page.note, NOTE_LETTERS), footer])
    part.supxlabel(note, x=0.0, ha="left", fontsize=style.TINY, color=style.GREY)
    grid = part.add_gridspec(len(heights), 1, height_ratios=heights)
    named = next((row for row in page.rows if row.timed), None)
    for number, (row, labelled) in enumerate(zip(page.rows, _labelled(page.rows), strict=True)):
        axes = _panels(part.add_subplot(grid[number, 0]), row)
        _draw_row(axes, row, tracks, labelled=labelled, named=row is named and len(tracks[0].phases) > 1)


def _panels(whole: Axes, row: PlotRow) -> list[Axes]:
    """Return axes for each panel within those of the whole row, so that the edges of all rows are aligned."""
    count = len(row.panels)
    if count == 1:
        return [whole]
    whole.set_axis_off()
    gap = LABELLED_GAP if any(panel.ylabel for panel in row.panels[1:]) else GAP
    width = (1.0 - gap * (count - 1)) / count
    return [whole.inset_axes((i * (width + gap), 0.0, width, 1.0)) for i in range(count)]


def _draw_heading(part: SubFigure, page: PlotPage, tracks: Tracks) -> None:
    """Write the title, and a line for each solution with its line style and state; failed ones are red."""
    from matplotlib.lines import Line2D

    lines = [Line2D([], [], color=style.BLACK, linestyle=style.line_style(i)) for i in range(len(tracks))]
    names = [f"{style.short(track.label)}:  " if len(tracks) > 1 else "" for track in tracks]
    words = [failure_of(track) or state_of(track) for track in tracks]
    states = [style.literal(name + state) for name, state in zip(names, words, strict=True)]
    title = f"{style.short(title_of(tracks), TITLE_LETTERS)}: {page.title}"
    legend = part.legend(
        lines, states, title=style.literal(title),
        loc="outside upper left", alignment="left", handlelength=3.2, handletextpad=1.0, borderpad=0.5,
        title_fontproperties={"weight": "bold", "size": style.TITLE},
    )  # fmt: skip
    for text, track in zip(legend.get_texts(), tracks, strict=True):
        text.set(**{"color": style.RED, "weight": "bold"} if failure_of(track) else {"color": style.GREY})


def _draw_row(axes: Sequence[Axes], row: PlotRow, tracks: Tracks, *, labelled: bool, named: bool) -> None:
    above = PAD + REMARK * any(panel.remark for panel in row.panels)
    for one, panel in zip(axes, row.panels, strict=True):
        one.set_label(panel.name)
        one.set_ylabel(panel.ylabel)
        one.yaxis.get_offset_text().set(fontsize=style.SMALLEST, va="top")
        one.yaxis.OFFSETTEXTPAD = -OFFSET_PAD  # inside, below title and remark
        one.set_title(style.literal(panel.title), loc="left", weight="bold", pad=PAD + above * (not named))
        look: dict[str, Any] = {"fontsize": style.TINY, "color": style.GREY, "in_layout": False}
        one.annotate(
            style.literal(panel.remark), (0.0, 1.0), (0.0, PAD),
            xycoords="axes fraction", textcoords="offset points", **look,
        )  # fmt: skip
        if row.timed:
            _draw_times(one, tracks, labelled=labelled)
        if named:
            _name_phases(one, tracks, PHASES / len(axes), above)
        panel.draw(one, tracks)
    named_lines = (pair for one in axes for pair in zip(*one.get_legend_handles_labels(), strict=True))
    entries: dict[str, Any] = {}
    for line, label in named_lines:
        entries.setdefault(label, line)  # those of the first solution
    if row.legend and entries:
        axes[-1].legend(entries.values(), entries, loc="upper left", bbox_to_anchor=(1.005, 1.0))


def _draw_times(axes: Axes, tracks: Tracks, *, labelled: bool) -> None:
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
    if labelled:
        axes.set_xlabel("time t [s]")
    else:
        axes.tick_params(labelbottom=False)


def _name_phases(axes: Axes, tracks: Tracks, width: float, pad: float) -> None:
    """Write the names of phases above axes ``width`` inches wide: rotated if long, none for slivers."""
    inch = width / (axes.get_xlim()[1] - axes.get_xlim()[0])
    phases = [(phase, inch * (phase.end - phase.start)) for phase in tracks[0].phases]
    upright = any(PHASE_LETTER * len(phase.name) > room for phase, room in phases)
    shown = [phase for phase, room in phases if room > PHASE_LINE]
    axes.xaxis.remove_overlapping_locs = False  # a name may stand above a number
    middles = [(phase.start + phase.end) / 2 for phase in shown]
    axes.set_xticks(middles, [style.literal(phase.name) for phase in shown], minor=True)
    axes.tick_params(
        axis="x", which="minor", bottom=False, labelbottom=False, labeltop=True, pad=pad,
        labelsize=style.SMALLEST, labelcolor=style.GREY, labelrotation=90 if upright else 0,
    )  # fmt: skip
