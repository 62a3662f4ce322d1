"""Figures along a motion for every joint or contact at every sample, with their worst values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trajopt.dynamics.model_quantities import joints_of_rows
from trajopt.motion.solution import Solution


@dataclass(frozen=True, kw_only=True)
class Trace:
    """Values (K, n) of a figure at K samples for n joints or contacts ``names``.

    counts: (K, n) where the figure applies. margin: whether the smallest value is the worst.
    """

    values: np.ndarray
    counts: np.ndarray
    names: tuple[str, ...]
    margin: bool = False

    @classmethod
    def of(
        cls, values: np.ndarray, counts: np.ndarray | bool, names: Sequence[str], *, margin: bool = False
    ) -> Trace:
        """Return a trace; ``counts`` is broadcast to all values."""
        where = np.broadcast_to(np.asarray(counts, dtype=bool), values.shape)
        return cls(values=values, counts=where, names=tuple(names), margin=margin)

    def at(self, rows: np.ndarray) -> Trace:
        """Return the trace restricted to samples where ``rows`` (K,) is true."""
        return Trace.of(self.values, self.counts & rows[:, None], self.names, margin=self.margin)

    @property
    def badness(self) -> np.ndarray:
        """Values (K, n) that are larger the worse they are; -inf where the figure does not apply."""
        return np.where(self.counts, -self.values if self.margin else self.values, -np.inf)

    def worst(self) -> tuple[float, int, int] | None:
        """Return the worst value (NaN first) with its row and column, or None if the figure never applies."""
        if not self.counts.any():
            return None
        row, column = np.unravel_index(int(np.argmax(self.badness)), self.values.shape)
        return float(self.values[row, column]), int(row), int(column)


Traces = dict[str, Trace]


@dataclass(frozen=True, kw_only=True)
class Occurrence:
    """Place of a figure's worst value: time in s, phase, and joint, contact or frame (empty: whole robot)."""

    time: float
    phase: str
    name: str = ""

    def __str__(self) -> str:
        return f"{self.name}{', ' if self.name else ''}{self.phase}, {self.time:.3f} s"


def joints_of(plan: Solution) -> list[tuple[Any, str]]:
    """Return the joints of a plan's model without the universe, with their names."""
    return list(zip(list(plan.model.joints)[1:], list(plan.model.names)[1:], strict=True))


def names_of_rows(plan: Solution) -> list[str]:
    """Return the joint of every row of v (nv,)."""
    return joints_of_rows(plan.model)


def names_of_inputs(plan: Solution) -> list[str]:
    """Return the joint or thruster of every column of ``tau`` (nu,)."""
    names = names_of_rows(plan)
    return [names[row] for row in plan.actuated_rows] + [one.name for one in plan.description.thrusters]
