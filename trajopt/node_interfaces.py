"""What terms at nodes share: the place of a node within its phase, and the constraint's interface."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from trajopt.context import Context
from trajopt.schedule import Phase
from trajopt.term_interfaces import Rows, Term
from trajopt.units import Units


@dataclass(frozen=True)
class NodePlace:
    """A node within its phase: ``index`` of ``count`` intervals; ``last`` of the whole schedule.

    ``ends_schedule``: the phase is the last one.
    """

    phase: Phase
    index: int
    count: int
    last: bool
    ends_schedule: bool = True

    @property
    def fraction(self) -> float:
        """Fraction of the phase's duration at this node, 0 to 1."""
        return self.index / self.count


@dataclass(frozen=True, kw_only=True)
class NodeConstraint(Term, ABC):
    """A constraint at some nodes; nodes of one phase at which the same constraints act share a function."""

    def acts_at(self, place: NodePlace) -> bool:
        """Whether the constraint acts at this node; default: at the end of the schedule."""
        return place.last

    @abstractmethod
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        """Rows at the node; only bounds and parameter values may depend on ``place``."""


def nearest_node(place: NodePlace, fraction: float) -> int:
    """Index of a phase's own node nearest to ``fraction``: a last node is the next phase's."""
    nearest = round(fraction * place.count)
    return nearest if place.ends_schedule else min(nearest, place.count - 1)
