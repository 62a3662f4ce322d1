"""A problem as data: robot, schedule, terrain, start, terms and a guess."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from trajopt.errors import InputError
from trajopt.node_terms import ContactLanding, NodeConstraint
from trajopt.point_terms import BaseDynamics, ContactAcceleration
from trajopt.robot import Robot
from trajopt.schedule import FlatGround, Schedule
from trajopt.term_interfaces import Cost, PointConstraint, Term

Motion = Callable[[float], np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Everything a transcription needs, and nothing of how it is transcribed or solved.

    ``initial_q`` (nq,) and ``initial_v`` (nv,) are the fixed start. ``guess`` maps a time in s to a
    configuration (nq,): a motion made from the schedule, defined a little beyond its ends too;
    rates follow by differences, and forces are distributed over the active contacts to carry it.
    ``default_intervals`` and ``default_transcription`` are used when the caller names none. ``dynamics``
    are the rows that make it a motion of this robot: base rows and contact rows; a reduced model
    brings its own. Raises InputError where parts do not fit each other.
    """

    name: str
    robot: Robot
    schedule: Schedule
    terrain: FlatGround
    initial_q: np.ndarray
    initial_v: np.ndarray
    terms: tuple[Term, ...]
    guess: Motion
    parameters: Mapping[str, object] = field(default_factory=dict)
    default_intervals: int = 50
    default_transcription: str = "legendre:2"
    dynamics: tuple[PointConstraint, ...] = (BaseDynamics(), ContactAcceleration())

    def __post_init__(self) -> None:
        for label, size in (("initial_q", self.robot.nq), ("initial_v", self.robot.nv)):
            array = np.array(getattr(self, label), dtype=float)
            if array.shape != (size,) or not np.all(np.isfinite(array)):
                raise InputError(
                    f"{label} of problem '{self.name}' has shape {array.shape}", f"allowed: ({size},), finite"
                )
            array.setflags(write=False)
            object.__setattr__(self, label, array)
        object.__setattr__(self, "parameters", MappingProxyType(dict(self.parameters)))
        object.__setattr__(self, "terms", tuple(self.terms))
        names = [phase.name for phase in self.schedule.phases]
        if len(set(names)) != len(names):
            raise InputError(f"problem '{self.name}' has two phases of one name: {', '.join(names)}")
        for phase in self.schedule.phases:
            for contact in phase.contacts:
                self.robot.contact(contact)
        self.schedule.require_steady_surfaces(self.terrain)
        for term in self.terms:
            for name in term.phases or ():
                if name not in names:
                    raise InputError(f"{term.name} acts in phase '{name}'", f"allowed: {', '.join(names)}")

    @property
    def costs(self) -> tuple[Cost, ...]:
        """Running costs."""
        return tuple(term for term in self.terms if isinstance(term, Cost))

    @property
    def point_constraints(self) -> tuple[PointConstraint, ...]:
        """Constraints at collocation points, the dynamics first."""
        return (*self.dynamics, *(term for term in self.terms if isinstance(term, PointConstraint)))

    @property
    def node_constraints(self) -> tuple[NodeConstraint, ...]:
        """Constraints at nodes, with those that follow from the schedule: landings of new contacts."""
        landings = tuple(
            ContactLanding(phase=phase.name, contacts=self.schedule.new_contacts(i), terrain=self.terrain)
            for i, phase in enumerate(self.schedule.phases)
            if self.schedule.new_contacts(i)
        )
        return landings + tuple(term for term in self.terms if isinstance(term, NodeConstraint))
