"""Constraints at nodes: their interface, and the place of a node in its phase."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from typing_extensions import override

from trajopt.arguments import checked
from trajopt.robot.units import Units
from trajopt.schedule.moment import END, Moment, as_moment
from trajopt.schedule.schedule import Phase
from trajopt.terms.context import Context
from trajopt.terms.interfaces import Rows, Term

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
        before: the same node as the last of the phase before; None at an impact, and elsewhere.
    """

    phase: Phase
    index: int
    fractions: tuple[float, ...]
    last: bool
    before: NodePlace | None = None

    @property
    def fraction(self) -> float:
        """Fraction of the phase's duration at this node, 0 to 1."""
        return self.fractions[self.index]

    @property
    def count(self) -> int:
        """Number of the phase's intervals."""
        return len(self.fractions) - 1

    def nearest(self, fraction: float) -> int:
        """Index of the phase's node nearest to a fraction of it."""
        distances = np.abs(np.array(self.fractions) - fraction)
        return int(np.flatnonzero(distances <= distances.min() + SAME_FRACTION)[0])

    def is_at(self, moment: Moment) -> bool:
        """Whether this is the node nearest to a moment."""
        if moment.phase is None:
            return self.last
        here = self.phase.name == moment.phase and self.index == self.nearest(moment.fraction)
        return here or (self.before is not None and self.before.is_at(moment))

    @property
    def step(self) -> float:
        """Width of the wider interval at this node, as a fraction of the phase's duration."""
        here = slice(max(self.index - 1, 0), self.index + 2)
        return float(np.diff(self.fractions[here]).max())


def nodes_of(phases: Sequence[Phase], index: int, fractions: tuple[float, ...]) -> Iterator[NodePlace]:
    """Nodes of a phase that are its own: its last one belongs to the next phase, unless that has an impact.

    Args:
        phases: of the schedule.
        index: of the phase among them.
        fractions: of the duration of each phase, of all its nodes.
    """
    phase, count = phases[index], len(fractions) - 1
    ends = index == len(phases) - 1
    before = None
    if index > 0 and not phase.impact:
        before = NodePlace(phases[index - 1], count, fractions, False)
    for k in range(count):
        yield NodePlace(phase, k, fractions, False, None if k else before)
    if ends or phases[index + 1].impact:
        yield NodePlace(phase, count, fractions, ends)


@dataclass(frozen=True, kw_only=True)
class NodeConstraint(Term, ABC):
    """A constraint at some nodes; nodes of one phase at which the same constraints act share a function."""

    def acts_at(self, place: NodePlace) -> bool:
        """Whether the constraint acts at this node; default: at the end of the schedule."""
        return place.last

    @abstractmethod
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        """Rows at the node; only bounds and parameter values may depend on ``place``."""


@checked
@dataclass(frozen=True, kw_only=True)
class AtMoment(Term):
    """A term at one moment: at the node that is nearest to it.

    Args:
        at: the moment, default the end of the motion; see `start_of`, `middle_of` and `end_of`.

    Raises:
        InputError: for anything else.
    """

    at: Moment = END

    def __post_init__(self) -> None:
        as_moment(f"at of {self.name}", self.at)

    @property
    @override
    def phases(self) -> tuple[str, ...] | None:
        return None if self.at.phase is None else (self.at.phase,)

    def acts_at(self, place: NodePlace) -> bool:
        """Whether this is that node."""
        return place.is_at(self.at)
