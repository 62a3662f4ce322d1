"""A page as data: rows of panels under headings with their legends."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from trajopt.view.plotting import style
from trajopt.view.plotting.track import Track

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Tracks = Sequence[Track]
Draw = Callable[["Axes", Tracks], None]

# Inches: edges of the page, its title, a line of a heading, space under a row, an x axis with its label.
LEFT, RIGHT, TOP, BOTTOM = 0.72, 0.3, 0.35, 0.45
TITLE, LINE, GAP, X_AXIS, BETWEEN = 0.5, 0.17, 0.13, 0.36, 0.62
# Height of a line of a note.
NOTE_LINE = 0.13
# Of a row's axes: height by default, and how much it grows on an empty page.
UNIT, GROWTH = 1.3, 1.6
# Widths in inches of a letter and of a legend's handle with its spaces, at the small font.
LETTER, TITLE_LETTER, HANDLE = 0.06, 0.072, 0.48
# Points between the top of the axes and a power of ten that their numbers share.
OFFSET_TEXT = 2
# Letters in a line of a note.
NOTE_LETTERS = 155


@dataclass(frozen=True, kw_only=True)
class LegendEntry:
    """A legend's entry: ``label`` and the keywords of its line."""

    label: str
    style: dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class PlotPanel:
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


def page_of(name: str, title: str, rows: Iterable[PlotRow | None], note: str = "") -> list[PlotPage]:
    """Return the page of the rows that there are; no page without any."""
    present = tuple(row for row in rows if row is not None)
    return [PlotPage(name=name, title=title, rows=present, note=note)] if present else []
