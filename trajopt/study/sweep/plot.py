"""Time against open-loop error of all settings, on logarithmic axes, with the front drawn and labelled."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trajopt.motion.output import replacing
from trajopt.study.sweep.summary import Summary

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.legend import Legend
    from matplotlib.transforms import Bbox

FRONT_COLOR, DOMINATED_COLOR, DEFAULT_COLOR = "#0b5394", "#a0a0a0", "#cc0000"
SIZE, DOTS = (9.0, 6.0), 150
FRONT_FONT, OTHER_FONT = 8.5, 6.5
# Half the size of a marker, pixels.
MARKER = 4.0 * DOTS / 72
# Directions and distances (points of 1/72 inch) of a label from its marker, best first.
DIRECTIONS = ((1, 1), (1, -1), (-1, 1), (-1, -1), (1, 0), (0, 1), (-1, 0), (0, -1))
DISTANCES = (7.0, 16.0, 28.0, 44.0, 64.0, 90.0)
# From this distance on, a line joins label and marker.
LINE_FROM = 16.0


def plot(summaries: Sequence[Summary], title: str, path: Path) -> Path | None:
    """Write the plot as PNG; None if no setting has both figures. Raises InputError if it fails."""
    rows = [row for row in summaries if row.is_measured and row.time > 0 and row.error > 0]
    if not rows:
        return None
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE, dpi=DOTS, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    _points(axes, rows)
    axes.set(xscale="log", yscale="log", xlabel="time of a solve, s (median)", title=title)
    axes.set_ylabel("open-loop error, worst phase, m")
    axes.grid(which="both", alpha=0.25, linewidth=0.5)
    axes.margins(0.12, 0.1)
    legend = axes.legend(loc="upper right", fontsize=8, framealpha=0.9)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    _labels(axes, rows, legend)
    with replacing(path) as unfinished:
        figure.savefig(unfinished)
    return path


def _points(axes: Axes, rows: Sequence[Summary]) -> None:
    best = sorted((row for row in rows if row.on_front), key=lambda row: row.time)
    others = [row for row in rows if not row.on_front]
    style: dict[str, Any] = {"linestyle": "none", "markersize": 5}
    axes.plot(*_xy(others), marker="o", color=DOMINATED_COLOR, label="dominated", **style)
    axes.plot(*_xy(best), marker="o", color=FRONT_COLOR, label="front", **style)
    # Between two settings of the front only a step is known.
    axes.step(*_xy(best), where="post", color=FRONT_COLOR, linewidth=1.0, alpha=0.6)
    default = [row for row in rows if row.is_default]
    axes.plot(
        *_xy(default), marker="*", color=DEFAULT_COLOR, label="base setting", linestyle="none", markersize=13
    )


def _xy(rows: Sequence[Summary]) -> tuple[list[float], list[float]]:
    return [row.time for row in rows], [row.error for row in rows]


def _labels(axes: Axes, rows: Sequence[Summary], legend: Legend) -> None:
    """Label the front and the base setting, then the other settings where there is room.

    Each label takes the first place, near to far, where it covers neither a marker, the line through the
    front nor another label.
    """
    from matplotlib.transforms import Bbox

    def pixels(shown: Sequence[Summary]) -> Any:
        return axes.transData.transform([(row.time, row.error) for row in shown])

    ordered = sorted(rows, key=lambda row: (not row.on_front, row.on_front and row.time, not row.is_default))
    best = [row for row in ordered if row.on_front]
    taken = [Bbox([place - MARKER, place + MARKER]) for place in pixels(rows)]
    taken.append(legend.get_window_extent())
    for (x, y), (right, below) in pairwise(pixels(best)):
        taken += [Bbox([[x, y], [right, y + 1]]), Bbox([[right, below], [right + 1, y]])]
    for row in ordered:
        _label(axes, row, taken, must=row.on_front or row.is_default)


def _label(axes: Axes, row: Summary, taken: list[Bbox], *, must: bool) -> None:
    from matplotlib.text import Text

    color = DEFAULT_COLOR if row.is_default else FRONT_COLOR if row.on_front else DOMINATED_COLOR
    text = f"{row.label} (base)" if row.is_default else row.label
    line = {"arrowstyle": "-", "color": color, "linewidth": 0.5}
    frame = axes.get_window_extent()
    distances = DISTANCES if must else DISTANCES[:2]
    places = [(distance, direction) for distance in distances for direction in DIRECTIONS]
    for last, (distance, direction) in enumerate(places, 1 - len(places)):
        annotation = axes.annotate(
            text, (row.time, row.error), fontsize=FRONT_FONT if must else OTHER_FONT, color=color,
            xytext=(distance * direction[0], distance * direction[1] * 0.8), textcoords="offset points",
            ha=("right", "center", "left")[direction[0] + 1],
            va=("top", "center", "bottom")[direction[1] + 1],
            arrowprops=line if distance >= LINE_FROM else None,
        )  # fmt: skip
        annotation.get_window_extent()  # updates the position of the text
        box = Text.get_window_extent(annotation)  # without the line to its marker
        inside = frame.x0 <= box.x0 and box.x1 <= frame.x1 and frame.y0 <= box.y0 and box.y1 <= frame.y1
        if (inside and not box.count_overlaps(taken)) or (must and last == 0):
            taken.append(box)
            return
        annotation.remove()
