"""The figure of a page: head and foot, positions of rows, their axes, headings and legends."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from trajopt.view.plotting import style
from trajopt.view.plotting.page import (
    BOTTOM,
    GAP,
    GROWTH,
    LEAST_ROWS,
    LEFT,
    LINE,
    NOTE_LINE,
    OFFSET_TEXT,
    RIGHT,
    TITLE,
    TOP,
    UNIT,
    X_AXIS,
    LegendEntry,
    PlotPage,
    PlotRow,
    Tracks,
)
from trajopt.view.plotting.time_axis import over_time, phase_strip
from trajopt.view.plotting.track import Track

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Most letters across a page: in the title beside the page's name, and in the legend.
TITLE_LETTERS, LEGEND_LETTERS = 64, 112


@dataclass(frozen=True, kw_only=True)
class _Place:
    """Position of a row: inches from the page's top to its axes, their height, and the row."""

    top: float
    height: float
    phases: float
    labelled: bool


def figure_of(page: PlotPage, tracks: Tracks, *, fixed: bool, footer: str = "") -> Figure:
    """Draw the page as a figure of A4 width, and of A4 height if ``fixed``."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    left = max(row.left for row in page.rows)  # one left edge for all, by the longest labels
    page = replace(page, rows=tuple(replace(row, left=left) for row in page.rows))
    places, height = _places(page, tracks, fixed)
    look: dict[Any, Any] = {**mpl.rcParamsDefault, **style.RC, "backend": mpl.rcParams["backend"]}
    with mpl.rc_context(look):
        figure = Figure(figsize=(style.WIDTH, height), dpi=style.DOTS)
        _draw_heading(figure, page, tracks, footer)
        for row, place in zip(page.rows, places, strict=True):
            _draw_row(figure, row, place, tracks)
    return figure


def _places(page: PlotPage, tracks: Tracks, fixed: bool) -> tuple[list[_Place], float]:
    """Places of the rows and the page's height, inches."""
    named = next((i for i, row in enumerate(page.rows) if row.is_timed), None)
    labelled = [
        not row.is_timed or following is None or not following.is_timed
        for row, following in itertools.zip_longest(page.rows, page.rows[1:])
    ]
    phases = [phase_strip(row, tracks) if i == named else 0.0 for i, row in enumerate(page.rows)]
    head, foot = TOP + TITLE + LINE * (len(tracks) > 1), BOTTOM + NOTE_LINE * len(page.note_lines)
    fixed_part = head + foot
    fixed_part += sum(row.heading + GAP for row in page.rows) + sum(phases) + X_AXIS * sum(labelled)
    rigid = sum(UNIT * row.height for row in page.rows if row.rigid)
    free = sum(UNIT * row.height for row in page.rows if not row.rigid)
    shrink = (style.HEIGHT - fixed_part - rigid) / free if free else 1.0
    # A page of few rows is stretched, within limits; a picture may be higher than a page.
    shrink = min(GROWTH, shrink) if fixed else min(1.0, max(LEAST_ROWS, shrink))
    at, places = head, []
    for row, strip, shown in zip(page.rows, phases, labelled, strict=True):
        height = UNIT * row.height * (1.0 if row.rigid else shrink)
        at += row.heading + strip
        places.append(_Place(top=at, height=height, phases=strip, labelled=shown))
        at += height + GAP + X_AXIS * shown
    return places, style.HEIGHT if fixed else at + foot


def _draw_row(figure: Figure, row: PlotRow, place: _Place, tracks: Tracks) -> None:
    width, height = figure.get_size_inches()
    gaps = sum(panel.gap for panel in row.panels[1:])
    unit = (width - row.left - row.right - gaps) / sum(panel.wide for panel in row.panels)
    at = row.left
    for number, panel in enumerate(row.panels):
        at += panel.gap if number else 0.0
        box = (
            at / width,
            1 - (place.top + place.height) / height,
            unit * panel.wide / width,
            place.height / height,
        )
        axes = figure.add_axes(box, label=panel.name)
        axes.set_ylabel(panel.ylabel, labelpad=2.0)
        axes.yaxis.get_offset_text().set(fontsize=6.0, va="top")  # inside, below the heading
        axes.yaxis.OFFSETTEXTPAD = -OFFSET_TEXT
        if panel.timed:
            over_time(axes, tracks, labelled=place.labelled, strip=place.phases)
        panel.draw(axes, tracks)
        _draw_row_heading(figure, row, place, panel.title, at)
        if panel.remark:
            above = (place.top - place.phases - 0.03) / height
            look: dict[str, Any] = {"fontsize": 6.5, "color": style.GREY, "va": "bottom"}
            figure.text(at / width, 1 - above, style.literal(panel.remark), **look)
        at += unit * panel.wide
    _draw_row_heading(figure, row, place, row.title, row.left, legend=True)


def _draw_row_heading(
    figure: Figure, row: PlotRow, place: _Place, title: str, left: float, legend: bool = False
) -> None:
    """Write a title ``left`` inches from the left, and the row's legend on the right."""
    width, height = figure.get_size_inches()
    top = place.top - place.phases - row.heading + 0.02
    if title:
        figure.text(left / width, 1 - top / height, title, weight="bold", va="top", ha="left")
    if legend and row.legend:
        columns = min(row.legend_columns, len(row.legend))
        look = {"handlelength": 2.8, "handletextpad": 0.4, "columnspacing": 1.0, "labelspacing": 0.25}
        _draw_legend(figure, row.legend, "upper right", width - row.right, top - 0.03, ncols=columns, **look)


def _draw_heading(figure: Figure, page: PlotPage, tracks: Tracks, footer: str) -> None:
    """Write title, state of the solutions, note and footer."""
    width, height = figure.get_size_inches()

    def text(x: float, y: float, words: str, **options: object) -> None:
        look = {"va": "top", **options}
        figure.text(x / width, 1 - y / height, style.literal(words), **look)  # type: ignore[arg-type]

    text(LEFT, TOP, style.short(title_of(tracks), TITLE_LETTERS), fontsize=style.TITLE, weight="bold")
    text(width - RIGHT, TOP + 0.02, page.title, fontsize=style.TITLE, ha="right", color=style.GREY)
    warning = failures_of(tracks)
    below = TOP + 0.24
    if warning:
        text(LEFT, below, warning, fontsize=style.FONT, weight="bold", color=style.RED)
    elif len(tracks) == 1:
        text(LEFT, below, state_of(tracks[0]), fontsize=style.SMALL, color=style.GREY)
    if len(tracks) > 1:
        _draw_solutions(figure, tracks, TOP + TITLE - 0.08)
    lines = page.note_lines
    for number, line in enumerate(lines):
        below = height - BOTTOM + 0.12 - NOTE_LINE * (len(lines) - number)
        text(LEFT, below, line, fontsize=6.5, color=style.GREY)
    text(LEFT, height - 0.26, footer, fontsize=6.5, color=style.GREY)


def _draw_solutions(figure: Figure, tracks: Tracks, top: float) -> None:
    """Write the legend of solutions by line style, ``top`` inches from the page's top."""
    legend = []
    for number, track in enumerate(tracks):
        name = style.literal(style.short(track.label, LEGEND_LETTERS // len(tracks)))
        look = {"color": style.BLACK, "linestyle": style.line_style(number)}
        legend.append((name + ("" if track.meta["success"] else " (not solved)"), look))
    spaces = {"handlelength": 3.2, "columnspacing": 1.5}
    _draw_legend(figure, legend, "upper left", LEFT, top, ncols=len(tracks), **spaces)


def _draw_legend(
    figure: Figure, legend: Sequence[LegendEntry], corner: Any, left: float, top: float, **look: Any
) -> None:
    """Draw a legend with its ``corner`` at inches from the page's left and top."""
    from matplotlib.lines import Line2D

    width, height = figure.get_size_inches()
    handles, labels = [Line2D([], [], **line) for _, line in legend], [label for label, _ in legend]
    figure.legend(handles, labels, loc=corner, bbox_to_anchor=(left / width, 1 - top / height), **look)


def title_of(tracks: Tracks) -> str:
    """Return problem and robot; of several problems their names."""
    names = list(dict.fromkeys(str(track.meta["problem"]) for track in tracks))
    return f"{', '.join(names)} on {tracks[0].meta['robot']}"


def state_of(track: Track) -> str:
    """Describe a solution in a line: status, solver and grid."""
    meta, plan = track.meta, track.solution
    objective = meta.get("objective")
    parts = [
        "solved" if meta["success"] else f"not solved, {str(meta['status']).replace('_', ' ')}",
        f"{meta['solver']}, {meta['iterations']} iterations",
        f"objective {objective:.6g}" if isinstance(objective, float) else "",
        f"{meta['transcription']}, {plan.n_intervals} interval{'s' * (plan.n_intervals > 1)}",
        f"{plan.t[-1] - plan.t[0]:.3g} s",
    ]
    return "  \u00b7  ".join(part for part in parts if part)


def failures_of(tracks: Tracks) -> str:
    """Warnings for the solutions that failed; empty if none did."""
    found = []
    for track in tracks:
        name = f"{track.label}: " if len(tracks) > 1 else ""
        if not track.meta["success"] and not track.is_simulated:
            found.append(
                f"{name}NOT SOLVED ({str(track.meta['status']).replace('_', ' ')}): the last iterate"
            )
        if not track.is_finite:
            found.append(f"{name}NOT FINITE: what is finite is shown")
    return "; ".join(found)
