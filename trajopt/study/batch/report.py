"""Where a batch fails: success rates by region of its parameters, and a plot of its cases by outcome."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trajopt.motion.output import replacing

if TYPE_CHECKING:
    import pyarrow as pa
    from matplotlib.axes import Axes

# A number with more values than this is split into this many ranges of equal width.
MOST_VALUES, RANGES = 8, 5
FILE = "failures.png"
# Most pairs of parameters in the plot.
MOST_PAIRS = 6
SIDE, DOTS = 4.6, 130
SOLVED = "#0b5394"
# Colours of failure statuses, most frequent first.
FAILED = ("#cc0000", "#e69138", "#6a329f", "#38761d", "#7f6000", "#444444")


@dataclass(frozen=True, kw_only=True)
class Region:
    """Cases with one value or range of a parameter: their number, and how many are solved."""

    parameter: str
    text: str
    cases: int
    solved: int


def varied(table: pa.Table, parameters: list[str]) -> list[str]:
    """The parameters that have more than one value."""
    return [name for name in parameters if len(table[name].unique()) > 1]


def regions(table: pa.Table, parameters: list[str]) -> list[Region]:
    """The regions of all parameters that vary, in order."""
    solved = np.array(table["success"].to_pylist(), dtype=bool)
    parts = []
    for name in varied(table, parameters):
        values = table[name].to_pylist()
        for text, inside in _parts(values):
            parts.append(
                Region(parameter=name, text=text, cases=int(inside.sum()), solved=int(solved[inside].sum()))
            )
    return parts


def outcomes(table: pa.Table) -> Counter[str]:
    """Number of cases per status; solved ones count as ``solved``."""
    pairs = zip(table["success"].to_pylist(), table["status"].to_pylist(), strict=True)
    return Counter("solved" if success else str(status) for success, status in pairs)


def _parts(values: list[Any]) -> list[tuple[str, np.ndarray]]:
    """Values or ranges in words, with masks (n,) of their rows; a case without the parameter is in none."""
    known = sorted({value for value in values if value is not None})
    if len(known) <= MOST_VALUES or isinstance(known[0], str):
        return [
            (value if isinstance(value, str) else f"{value:.4g}", np.array([one == value for one in values]))
            for value in known
        ]
    numbers = np.array([np.nan if value is None else value for value in values], dtype=float)
    edges = np.linspace(known[0], known[-1], RANGES + 1)
    place = np.clip(np.searchsorted(edges, numbers, side="right") - 1, 0, RANGES - 1)
    return [
        (f"{edges[i]:.3g} to {edges[i + 1]:.3g}", (place == i) & ~np.isnan(numbers)) for i in range(RANGES)
    ]


def plot_failures(table: pa.Table, parameters: list[str], title: str, folder: Path) -> Path | None:
    """Write the plot; None if no parameter varies. Raises `InputError` if it cannot be written."""
    names = varied(table, parameters)
    if not names:
        return None
    from matplotlib.figure import Figure

    pairs = list(combinations(names, 2))[:MOST_PAIRS] or [(names[0], "objective")]
    columns = min(3, len(pairs))
    rows = -(-len(pairs) // columns)
    figure = Figure(figsize=(SIDE * columns + 1.2, SIDE * rows), dpi=DOTS, layout="constrained")
    for number, (x, y) in enumerate(pairs):
        _points(figure.add_subplot(rows, columns, number + 1), table, x, y)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", fontsize=8)
    figure.suptitle(title, fontsize=10)
    with replacing(folder / FILE) as unfinished:
        figure.savefig(unfinished)
    return folder / FILE


def _points(axes: Axes, table: pa.Table, x: str, y: str) -> None:
    success = np.array(table["success"].to_pylist(), dtype=bool)
    status = np.where(success, "solved", np.array(table["status"].to_pylist(), dtype=object))
    words, counts = np.unique(status[~success].astype(str), return_counts=True)
    failed = [str(words[i]) for i in np.argsort(-counts, kind="stable")]
    places = [_numbers(axes, table, name, axis) for name, axis in ((x, "x"), (y, "y"))]
    for word, color, marker in [
        ("solved", SOLVED, "o"),
        *((word, FAILED[min(i, len(FAILED) - 1)], "X") for i, word in enumerate(failed)),
    ]:
        mask = status == word
        label = f"{word.replace('_', ' ')}: {mask.sum()}"
        axes.scatter(
            places[0][mask], places[1][mask], s=18, color=color, marker=marker, label=label, alpha=0.8
        )
    axes.set(xlabel=x, ylabel=y)
    axes.grid(alpha=0.25, linewidth=0.5)


def _numbers(axes: Axes, table: pa.Table, name: str, axis: str) -> np.ndarray:
    """Values of a column; words become whole numbers, with the words as ticks of the axis."""
    values = table[name].to_pylist()
    if not any(isinstance(value, str) for value in values):
        return np.array([np.nan if value is None else value for value in values], dtype=float)
    words = sorted({value for value in values if value is not None})
    (axes.set_xticks if axis == "x" else axes.set_yticks)(range(len(words)), words)
    return np.array([np.nan if value is None else words.index(value) for value in values], dtype=float)
