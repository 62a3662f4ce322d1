"""A series of positive figures over iterations as one line of characters."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

BLOCKS = "▁▂▃▄▅▆▇█"
ASCII = ".:-=+*#@"
# The character for a figure that is not finite.
MISSING = "?"
# Decades that a line spans at least: a series that hardly changes is a flat line.
LEAST_DECADES = 1.0
# On a linear scale, the least span of a line, as a fraction of the largest value.
FLAT = 1e-3


def sparkline(values: Sequence[float], width: int, *, linear: bool = False, blocks: str = BLOCKS) -> str:
    """log10 of ``values`` (n,), or if ``linear`` themselves, in at most ``width`` characters.

    More values than characters: each stands for a run of them and shows the largest. On the logarithmic scale
    zero is the lowest; values without a logarithm are shown as ``MISSING``.
    """
    if width < 1 or not values:
        return ""
    levels = [value if linear else _level(value) for value in _binned(values, width)]
    known = [level for level in levels if math.isfinite(level)]
    high = max(known, default=0.0)
    least = FLAT * abs(high) if linear else LEAST_DECADES
    low = min(min(known, default=0.0), high - least)
    return "".join(_block(level, low, high, blocks) for level in levels)


def _binned(values: Sequence[float], width: int) -> list[float]:
    """At most ``width`` values, each the largest of its run; one that is not a number stays."""
    count = min(width, len(values))
    edges = [round(i * len(values) / count) for i in range(count + 1)]
    runs = [values[low:high] for low, high in itertools.pairwise(edges)]
    return [math.nan if any(math.isnan(value) for value in run) else max(run) for run in runs]


def _level(value: float) -> float:
    return math.log10(value) if value > 0 else -math.inf if value == 0 else math.nan


def _block(level: float, low: float, high: float, blocks: str) -> str:
    if math.isnan(level) or level == math.inf:
        return MISSING
    if level == -math.inf:
        return blocks[0]
    part = (level - low) / (high - low) if high > low else 0.0
    return blocks[min(len(blocks) - 1, int(part * len(blocks)))]
