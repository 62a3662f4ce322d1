"""Success rates of a batch by region of its parameters."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pyarrow as pa

# A number with more values than this is split into this many ranges of equal width.
MOST_VALUES, RANGES = 8, 5


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
