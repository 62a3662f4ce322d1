"""Figures along a motion, for every joint or contact at every sample; their worst value and its place."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from trajopt.solution.solution import Solution


@dataclass(frozen=True, kw_only=True)
class Trace:
    """Values (K, n) of a figure at K samples for n joints or contacts ``names``.

    counts: (K, n) where the figure applies. margin: the least value is the worst, otherwise the largest.
    """

    values: np.ndarray
    counts: np.ndarray
    names: tuple[str, ...]
    margin: bool = False

    @classmethod
    def of(
        cls, values: np.ndarray, counts: np.ndarray | bool, names: Sequence[str], *, margin: bool = False
    ) -> Trace:
        """A trace; ``counts`` is spread over all values."""
        where = np.broadcast_to(np.asarray(counts, dtype=bool), values.shape)
        return cls(values=values, counts=where, names=tuple(names), margin=margin)

    def at(self, rows: np.ndarray) -> Trace:
        """The trace where ``rows`` (K,) are true."""
        return Trace.of(self.values, self.counts & rows[:, None], self.names, margin=self.margin)

    @property
    def badness(self) -> np.ndarray:
        """Values (K, n), larger for worse ones, -inf where the figure does not apply."""
        return np.where(self.counts, -self.values if self.margin else self.values, -np.inf)

    def worst(self) -> tuple[float, int, int] | None:
        """The worst value with its row and column, a NaN before all; None where the figure does not apply."""
        if not self.counts.any():
            return None
        row, column = np.unravel_index(int(np.argmax(self.badness)), self.values.shape)
        return float(self.values[row, column]), int(row), int(column)


Traces = dict[str, Trace]


@dataclass(frozen=True, kw_only=True)
class Occurrence:
    """Where a figure is worst: time in s, phase, and joint, contact or frame (empty: the whole robot)."""

    time: float
    phase: str
    name: str = ""

    def to_dict(self) -> dict[str, Any]:
        """JSON-able."""
        return asdict(self)

    def __str__(self) -> str:
        return f"{self.name}{', ' if self.name else ''}{self.phase}, {self.time:.3f} s"


@dataclass(frozen=True, kw_only=True)
class Found:
    """The worst value of a figure and its place."""

    value: float
    place: Occurrence


def place_of(plan: Solution, row: int, name: str = "") -> Occurrence:
    """The place of a sample."""
    return Occurrence(time=float(plan.t[row]), phase=plan.phase_names[int(plan.phase[row])], name=name)


def worst_of(*parts: tuple[Solution, Trace | None]) -> Found | None:
    """The worst value over traces of one figure, each along its own samples; None where it does not apply."""
    best: tuple[float, Found] | None = None
    for plan, trace in parts:
        found = None if trace is None else trace.worst()
        if found is None or trace is None:
            continue
        value, row, column = found
        bad = np.inf if np.isnan(value) else -value if trace.margin else value
        if best is None or bad > best[0]:
            best = (bad, Found(value=value, place=place_of(plan, row, trace.names[column])))
    return None if best is None else best[1]


def merged(traces: Iterable[Traces], along: Callable[[list[np.ndarray]], np.ndarray]) -> Traces:
    """Join traces of one motion at several sets of samples; ``along`` joins their arrays."""
    parts = list(traces)
    return {
        name: Trace(
            values=along([part[name].values for part in parts]),
            counts=along([part[name].counts for part in parts]),
            names=first.names,
            margin=first.margin,
        )
        for name, first in parts[0].items()
    }


def joints_of(plan: Solution) -> list[tuple[Any, str]]:
    """The joints of a plan's model but the universe, with their names."""
    return list(zip(list(plan.model.joints)[1:], list(plan.model.names)[1:], strict=True))


def names_of_rows(plan: Solution) -> list[str]:
    """Joint of every row of v (nv,)."""
    return [name for joint, name in joints_of(plan) for _ in range(joint.nv)]
