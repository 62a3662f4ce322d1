"""A page as data: rows of panels."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from trajopt.view.plotting.track import Track

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Tracks = Sequence[Track]
Draw = Callable[["Axes", Tracks], None]
_Item = TypeVar("_Item")


@dataclass(frozen=True, kw_only=True)
class PlotPanel:
    """One pair of axes: its vertical axis' label with unit, and its draw function.

    ``title`` is its heading, ``remark`` a line of small letters below that.
    """

    name: str
    ylabel: str
    draw: Draw
    title: str = ""
    remark: str = ""


@dataclass(frozen=True, kw_only=True)
class PlotRow:
    """Panels side by side, with the ``legend`` of their labelled curves on the right; ``timed``: over time.

    ``height`` of the axes is in units of a normal row. ``rigid`` rows keep it, others shrink where a page is
    full.
    """

    panels: Sequence[PlotPanel]
    timed: bool = True
    legend: bool = True
    height: float = 1.0
    rigid: bool = False


@dataclass(frozen=True, kw_only=True)
class PlotPage:
    """A page by ``name`` with a ``title``, and a ``note`` at its foot."""

    name: str
    title: str
    rows: Sequence[PlotRow]
    note: str = ""


def panel_row(name: str, title: str, ylabel: str, draw: Draw, remark: str = "", **row: Any) -> PlotRow:
    """Return a row with one panel; ``row`` are more fields of the row."""
    panel = PlotPanel(name=name, ylabel=ylabel, draw=draw, title=title, remark=remark)
    return PlotRow(panels=(panel,), **row)


def page_of(name: str, title: str, *parts: Iterable[PlotRow | None], note: str = "") -> list[PlotPage]:
    """Return a page for each part, of its rows that are not None; none for a part without rows."""
    present = [[row for row in part if row is not None] for part in parts]
    return [PlotPage(name=name, title=title, rows=rows, note=note) for rows in present if rows]


def batches(items: Sequence[_Item], size: int) -> list[Sequence[_Item]]:
    """Return the items in order, ``size`` at a time."""
    return [items[start : start + size] for start in range(0, len(items), size)]
