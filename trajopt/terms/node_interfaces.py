"""Constraints at nodes: their interface, and the place of a node in its phase."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from trajopt.errors import InputError
from trajopt.robot.units import Units
from trajopt.schedule.schedule import Phase
from trajopt.terms.context import Context
from trajopt.terms.interfaces import InPhase, Rows, Term

# Of two nodes equally far from a fraction, up to rounding, the earlier one is the nearest.
SAME_FRACTION = 1e-9


@dataclass(frozen=True)
class NodePlace:
    """A node of a phase.

    Args:
        phase: the phase.
        index: of the node among those of the phase.
        fractions: of the phase's duration, of all its nodes.
        last: whether the node is the last of the schedule.
        ends_schedule: whether the phase is the last.
    """

    phase: Phase
    index: int
    fractions: tuple[float, ...]
    last: bool
    ends_schedule: bool = True

    @property
    def fraction(self) -> float:
        """Fraction of the phase's duration at this node, 0 to 1."""
        return self.fractions[self.index]

    @property
    def count(self) -> int:
        """Number of the phase's intervals."""
        return len(self.fractions) - 1

    def nearest(self, fraction: float) -> int:
        """Index of the phase's node nearest to a fraction of it; the last node belongs to the next phase."""
        distances = np.abs(np.array(self.fractions) - fraction)
        found = int(np.flatnonzero(distances <= distances.min() + SAME_FRACTION)[0])
        return found if self.ends_schedule else min(found, self.count - 1)

    @property
    def step(self) -> float:
        """Width of the wider interval at this node, as a fraction of the phase's duration."""
        here = slice(max(self.index - 1, 0), self.index + 2)
        return float(np.diff(self.fractions[here]).max())


@dataclass(frozen=True, kw_only=True)
class NodeConstraint(Term, ABC):
    """A constraint at some nodes; nodes of one phase at which the same constraints act share a function."""

    def acts_at(self, place: NodePlace) -> bool:
        """Whether the constraint acts at this node; default: at the end of the schedule."""
        return place.last

    @abstractmethod
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        """Rows at the node; only bounds and parameter values may depend on ``place``."""


@dataclass(frozen=True, kw_only=True)
class AtMoment(InPhase):
    """A term at the node of a phase that is nearest to a fraction of its duration.

    The last node of a phase belongs to the next one, except at the end of the schedule.

    Args:
        phase: name of the phase.
        fraction: of the phase's duration.

    Raises:
        InputError: for a fraction outside 0 to 1, and for ``phases``.
    """

    fraction: float = 0.5

    def __post_init__(self) -> None:
        if not 0 <= self.fraction <= 1:
            raise InputError(f"fraction of {self.name} is {self.fraction:g}", "allowed: 0 to 1")
        super().__post_init__()

    def acts_at(self, place: NodePlace) -> bool:
        """Whether this is that node."""
        return place.phase.name == self.phase and place.index == place.nearest(self.fraction)
