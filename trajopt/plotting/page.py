"""A page as data, rows of panels under headings with their legends, and the figure drawn from it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from trajopt.plotting import style
from trajopt.plotting.track import Track

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Tracks = Sequence[Track]
Draw = Callable[["Axes", Tracks], None]

# Inches: edges of the page, its title, a line of a heading, space under a row, an x axis with its label.
LEFT, RIGHT, TOP, BOTTOM = 0.72, 0.3, 0.35, 0.45
TITLE, LINE, GAP, X_AXIS, BETWEEN = 0.5, 0.17, 0.13, 0.36, 0.62
# Of a row's axes: height by default, and how much it grows on an empty page.
UNIT, GROWTH = 1.3, 1.6
# Widths in inches of a letter and of a legend's handle with its spaces, at the small font.
LETTER, TITLE_LETTER, HANDLE = 0.06, 0.072, 0.48
# Points between the top of the axes and a power of ten that their numbers share.
OFFSET_TEXT = 2
# Letters in a line of a note.
NOTE_LETTERS = 155


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A legend's entry: ``label`` and the keywords of its line."""

    label: str
    style: dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Panel:
    """One pair of axes: its vertical axis' label with unit, and what draws into it. ``timed``: over time.

    ``wide`` is its share of the row's width, ``gap`` the inches to the panel on its left. ``title`` is for
    rows whose panels have headings of their own.
    """

    name: str
    ylabel: str
    draw: Draw
    timed: bool = True
    wide: float = 1.0
    gap: float = BETWEEN
    title: str = ""


@dataclass(frozen=True, kw_only=True)
class Row:
    """Panels side by side under a heading; ``height`` in units of `UNIT`, ``left`` inches for labels.

    ``rigid`` rows keep their height, others shrink where a page is full.
    """

    title: str
    panels: tuple[Panel, ...]
    legend: tuple[Entry, ...] = ()
    height: float = 1.0
    left: float = LEFT
    right: float = RIGHT
    rigid: bool = False

    @property
    def is_timed(self) -> bool:
        """Whether all its panels are over time."""
        return all(panel.timed for panel in self.panels)

    @property
    def legend_columns(self) -> int:
        """Entries in one line of the legend: all, or as many columns as its widest entry allows."""
        free = style.WIDTH - self.left - self.right - TITLE_LETTER * (len(self.title) + 2)
        widths = [HANDLE + LETTER * len(entry.label) for entry in self.legend]
        if sum(widths) <= free:
            return max(1, len(widths))
        return max(1, int(free / max(widths)))

    @property
    def heading(self) -> float:
        """Height of its title and legend in inches."""
        lines = max(1, math.ceil(len(self.legend) / self.legend_columns))
        return LINE * lines + 0.05


@dataclass(frozen=True, kw_only=True)
class Page:
    """A page by ``name`` with a ``title``, and a ``note`` at its foot."""

    name: str
    title: str
    rows: tuple[Row, ...]
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class _Place:
    """Where a row goes: inches from the page's top to its axes and their height, and what is shown."""

    top: float
    height: float
    phases: float
    labelled: bool


def figure_of(page: Page, tracks: Tracks, *, fixed: bool, footer: str = "") -> Figure:
    """The page as a figure of A4's width, and of its height where ``fixed`` or where it fills one."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from trajopt.plotting.heading import draw_heading

    page = aligned(page)
    places, height = _places(page, tracks, fixed)
    look: dict[Any, Any] = {**mpl.rcParamsDefault, **style.RC, "backend": mpl.rcParams["backend"]}
    with mpl.rc_context(look):
        figure = Figure(figsize=(style.WIDTH, height), dpi=style.DOTS)
        draw_heading(figure, page, tracks, footer)
        for row, place in zip(page.rows, places, strict=True):
            _draw_row(figure, row, place, tracks)
    return figure


def aligned(page: Page) -> Page:
    """The page with one left edge for all rows: that of the row with the longest labels."""
    left = max(row.left for row in page.rows)
    return replace(page, rows=tuple(replace(row, left=left) for row in page.rows))


def _places(page: Page, tracks: Tracks, fixed: bool) -> tuple[list[_Place], float]:
    """Places of the rows and the page's height, inches."""
    from trajopt.plotting.time_axis import phase_strip

    named = next((i for i, row in enumerate(page.rows) if row.is_timed), None)
    labelled = [
        not row.is_timed or following is None or not following.is_timed
        for row, following in itertools.zip_longest(page.rows, page.rows[1:])
    ]
    phases = [phase_strip(row, tracks) if i == named else 0.0 for i, row in enumerate(page.rows)]
    fixed_part = TOP + TITLE + BOTTOM + 0.13 * _note_lines(page.note) + LINE * (len(tracks) > 1)
    fixed_part += sum(row.heading + GAP for row in page.rows) + sum(phases) + X_AXIS * sum(labelled)
    rigid = sum(UNIT * row.height for row in page.rows if row.rigid)
    free = sum(UNIT * row.height for row in page.rows if not row.rigid)
    shrink = min(1.0, (style.HEIGHT - fixed_part - rigid) / free) if free else 1.0
    if fixed and free:  # a page of few rows is filled, within reason
        shrink = min(GROWTH, (style.HEIGHT - fixed_part - rigid) / free)
    at, places = TOP + TITLE + LINE * (len(tracks) > 1), []
    for row, strip, shown in zip(page.rows, phases, labelled, strict=True):
        height = UNIT * row.height * (1.0 if row.rigid else shrink)
        at += row.heading + strip
        places.append(_Place(top=at, height=height, phases=strip, labelled=shown))
        at += height + GAP + X_AXIS * shown
    return places, style.HEIGHT if fixed else at + BOTTOM + 0.13 * _note_lines(page.note)


def _note_lines(note: str) -> int:
    return len(wrapped(note))


def wrapped(note: str) -> list[str]:
    """Lines of a note at the foot of a page."""
    import textwrap

    return textwrap.wrap(note, NOTE_LETTERS)


def _draw_row(figure: Figure, row: Row, place: _Place, tracks: Tracks) -> None:
    from trajopt.plotting.time_axis import over_time

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
        if panel.title:
            top = place.top - place.phases - row.heading + 0.02
            figure.text(at / width, 1 - top / height, panel.title, weight="bold", va="top", ha="left")
        at += unit * panel.wide
    _heading(figure, row, place)


def _heading(figure: Figure, row: Row, place: _Place) -> None:
    from matplotlib.lines import Line2D

    width, height = figure.get_size_inches()
    top = place.top - place.phases - row.heading + 0.02
    figure.text(row.left / width, 1 - top / height, row.title, weight="bold", va="top", ha="left")
    if row.legend:
        handles = [Line2D([], [], **entry.style) for entry in row.legend]
        figure.legend(
            handles,
            [entry.label for entry in row.legend],
            loc="upper right",
            bbox_to_anchor=(1 - row.right / width, 1 - (top - 0.03) / height),
            ncols=min(row.legend_columns, len(row.legend)),
            handlelength=2.0,
            handletextpad=0.4,
            columnspacing=1.0,
            labelspacing=0.25,
            borderpad=0.0,
            borderaxespad=0.0,
        )
