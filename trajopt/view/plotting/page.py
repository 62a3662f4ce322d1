"""A page as data: rows of panels with headings and legends."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from trajopt.view.plotting import style
from trajopt.view.plotting.track import Track

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Tracks = Sequence[Track]
Draw = Callable[["Axes", Tracks], None]
# Label and the keywords of its line.
LegendEntry = tuple[str, dict[str, Any]]
_Item = TypeVar("_Item")

# Inches: edges of the page, its title, a line of a heading, space under a row, an x axis with its label.
LEFT, RIGHT, TOP, BOTTOM = 0.72, 0.3, 0.35, 0.45
TITLE, LINE, GAP, X_AXIS, BETWEEN = 0.5, 0.17, 0.13, 0.36, 0.62
# Height of a line of a note, and of the line below a heading that panels may have.
NOTE_LINE = 0.13
REMARK_LINE = 0.14
# Height of a row's axes by default, and how much it may grow on an empty page.
UNIT, GROWTH = 1.3, 1.6
# Rows of a picture, which may be higher than A4, keep this part of their height.
LEAST_ROWS = 0.5
# Widths in inches of a letter and of a legend's handle with its spaces, at the small font.
LETTER, TITLE_LETTER, HANDLE = 0.06, 0.072, 0.56
# Points between the top of the axes and the common power of ten of their numbers.
OFFSET_TEXT = 2
# Letters in a line of a note.
NOTE_LETTERS = 155


@dataclass(frozen=True, kw_only=True)
class PlotPanel:
    """One pair of axes: its vertical axis' label with unit, and its draw function. ``timed``: over time.

    ``wide`` is its share of the row's width, ``gap`` the inches to the panel on its left. ``title`` is for
    rows whose panels have separate headings, ``remark`` for a line of small letters above the axes.
    """

    name: str
    ylabel: str
    draw: Draw
    timed: bool = True
    wide: float = 1.0
    gap: float = BETWEEN
    title: str = ""
    remark: str = ""


@dataclass(frozen=True, kw_only=True)
class PlotRow:
    """Panels side by side under a heading; ``height`` in units of `UNIT`, ``left`` inches for labels.

    ``rigid`` rows keep their height, others shrink where a page is full.
    """

    title: str
    panels: tuple[PlotPanel, ...]
    legend: tuple[LegendEntry, ...] = ()
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
        widths = [HANDLE + LETTER * len(label) for label, _ in self.legend]
        if sum(widths) <= free:
            return max(1, len(widths))
        return max(1, int(free / max(widths)))

    @property
    def heading(self) -> float:
        """Height of its title, legend and remarks in inches."""
        lines = max(1, math.ceil(len(self.legend) / self.legend_columns))
        return LINE * lines + 0.05 + REMARK_LINE * any(panel.remark for panel in self.panels)


@dataclass(frozen=True, kw_only=True)
class PlotPage:
    """A page by ``name`` with a ``title``, and a ``note`` at its foot."""

    name: str
    title: str
    rows: tuple[PlotRow, ...]
    note: str = ""

    @property
    def note_lines(self) -> list[str]:
        """Lines of the note."""
        return textwrap.wrap(self.note, NOTE_LETTERS)


def panel_row(title: str, name: str, ylabel: str, draw: Draw, *, timed: bool = True, **row: Any) -> PlotRow:
    """Return a row with one panel; ``row`` are more fields of the row."""
    panel = PlotPanel(name=name, ylabel=ylabel, draw=draw, timed=timed)
    return PlotRow(title=title, panels=(panel,), **row)


def page_of(name: str, title: str, *parts: Iterable[PlotRow | None], note: str = "") -> list[PlotPage]:
    """Return a page of the rows that are not None; no page without any."""
    present = [tuple(row for row in part if row is not None) for part in parts]
    return [PlotPage(name=name, title=title, rows=rows, note=note) for rows in present if rows]


def batches(items: Sequence[_Item], size: int) -> list[Sequence[_Item]]:
    """Return the items in order, ``size`` at a time."""
    return [items[start : start + size] for start in range(0, len(items), size)]
