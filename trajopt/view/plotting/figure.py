"""The figure drawn from a page: where its rows go, their axes, headings and legends."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from trajopt.view.plotting import style
from trajopt.view.plotting.heading import draw_heading
from trajopt.view.plotting.page import (
    BOTTOM,
    GAP,
    GROWTH,
    LINE,
    NOTE_LINE,
    OFFSET_TEXT,
    TITLE,
    TOP,
    UNIT,
    X_AXIS,
    PlotPage,
    PlotRow,
    Tracks,
)
from trajopt.view.plotting.time_axis import over_time, phase_strip

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True)
class _Place:
    """Where a row goes: inches from the page's top to its axes and their height, and what is shown."""

    top: float
    height: float
    phases: float
    labelled: bool


def figure_of(page: PlotPage, tracks: Tracks, *, fixed: bool, footer: str = "") -> Figure:
    """Draw the page as a figure of A4's width, and of its height where ``fixed`` or where it fills one."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    left = max(row.left for row in page.rows)  # one edge for all: that of the longest labels
    page = replace(page, rows=tuple(replace(row, left=left) for row in page.rows))
    places, height = _places(page, tracks, fixed)
    look: dict[Any, Any] = {**mpl.rcParamsDefault, **style.RC, "backend": mpl.rcParams["backend"]}
    with mpl.rc_context(look):
        figure = Figure(figsize=(style.WIDTH, height), dpi=style.DOTS)
        draw_heading(figure, page, tracks, footer)
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
    shrink = min(1.0, (style.HEIGHT - fixed_part - rigid) / free) if free else 1.0
    if fixed and free:  # a page of few rows is filled, within reason
        shrink = min(GROWTH, (style.HEIGHT - fixed_part - rigid) / free)
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
        _heading(figure, row, place, panel.title, at)
        at += unit * panel.wide
    _heading(figure, row, place, row.title, row.left, legend=True)


def _heading(
    figure: Figure, row: PlotRow, place: _Place, title: str, at: float, legend: bool = False
) -> None:
    """Write a title ``at`` inches from the left, and the row's legend on the right."""
    from matplotlib.lines import Line2D

    width, height = figure.get_size_inches()
    top = place.top - place.phases - row.heading + 0.02
    if title:
        figure.text(at / width, 1 - top / height, title, weight="bold", va="top", ha="left")
    if legend and row.legend:
        figure.legend(
            [Line2D([], [], **look) for _, look in row.legend],
            [label for label, _ in row.legend],
            loc="upper right",
            bbox_to_anchor=(1 - row.right / width, 1 - (top - 0.03) / height),
            ncols=min(row.legend_columns, len(row.legend)),
            handlelength=2.0,
            handletextpad=0.4,
            columnspacing=1.0,
            labelspacing=0.25,
        )
