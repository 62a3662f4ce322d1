"""A problem as data: robot, schedule, terrain, start, terms and a guess."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType

import numpy as np

from trajopt.errors import InputError
from trajopt.problem.periodicity import Periodicity, UnitRotation, closing_map, landing_at_start
from trajopt.problem.validation import require_goals, require_reach, require_start
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.payload import Payload, loaded
from trajopt.robot.robot import Robot
from trajopt.robot.stance.minimal_coordinates import StanceMode
from trajopt.robot.validation import require_configuration
from trajopt.schedule.schedule import Motion, Schedule
from trajopt.schedule.standing import require_standing
from trajopt.terms.context_symbols import ACTUATIONS, Actuation
from trajopt.terms.dynamics import BaseDynamics, ContactAcceleration, ContactVelocity
from trajopt.terms.interfaces import Cost, PointConstraint, Term
from trajopt.terms.landing import ContactLanding
from trajopt.terms.node_costs import NodeCost
from trajopt.terms.node_interfaces import NodeConstraint
from trajopt.terms.sliding import SlidingFriction, require_sliding, sliding_surfaces
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.terrain import Ground, Terrain

# Places that a problem and a mode of it name twice agree to rounding, m.
SAME_PLACE = 1e-9


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Everything a transcription needs, and nothing of how it is transcribed or solved.

    ``initial_q`` (nq,) and ``initial_v`` (nv,) are the fixed start. ``guess`` maps a time in s to a
    configuration (nq,): a motion made from the schedule, defined a little beyond its ends too;
    rates follow by differences, and forces are distributed over the active contacts to carry it.
    ``default_intervals`` and ``default_transcription`` are used when the caller names none.

    ``actuation`` is what the actuators are sources of: "torque"; "acceleration", where nothing may ask
    for torques; or "velocity", where configurations are the state, rates the input, contacts do not slide
    and a free base is in static balance. ``dynamics`` are the rows that make it a motion of this robot, by
    default those of the actuation; a reduced model brings its own. ``modes`` are phases, by name, in
    minimal coordinates.

    ``periodicity`` frees the start and asks the final state to be its image: ``initial_q`` is then only the
    reference of rotations, and says where the motion is in the world. ``duration_bounds`` (lower, upper) in s
    are of the sum of all phases, some of which are free. ``payloads`` are carried in phases, by their names.
    Raises InputError where parts do not fit each other.
    """

    name: str
    robot: Robot
    schedule: Schedule
    terrain: Terrain
    initial_q: np.ndarray
    initial_v: np.ndarray
    terms: tuple[Term, ...]
    guess: Motion
    parameters: Mapping[str, object] = field(default_factory=dict)
    default_intervals: int = 50
    default_transcription: str = "legendre:2"
    actuation: Actuation = "torque"
    dynamics: tuple[PointConstraint, ...] | None = None
    modes: Mapping[str, StanceMode] = field(default_factory=dict)
    periodicity: Periodicity | None = None
    duration_bounds: tuple[float, float] | None = None
    payloads: Mapping[str, Payload] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for label, size in (("initial_q", self.robot.nq), ("initial_v", self.robot.nv)):
            array = np.array(getattr(self, label), dtype=float)
            if array.shape != (size,) or not np.all(np.isfinite(array)):
                found = f"has shape {array.shape}" if array.shape != (size,) else "is not finite"
                raise InputError(f"{label} of problem '{self.name}' {found}", f"allowed: ({size},), finite")
            array.setflags(write=False)
            object.__setattr__(self, label, array)
        object.__setattr__(self, "parameters", MappingProxyType(dict(self.parameters)))
        object.__setattr__(self, "terms", tuple(self.terms))
        for term in self.terms:
            if not isinstance(term, Term):
                raise InputError(
                    f"a term of problem '{self.name}' is {term!r}", "allowed: costs and constraints"
                )
        object.__setattr__(self, "modes", MappingProxyType(dict(self.modes)))
        names = [phase.name for phase in self.schedule.phases]
        self._require_actuation()
        if len(set(names)) != len(names):
            raise InputError(
                f"problem '{self.name}' has two phases of one name: {', '.join(names)}",
                "allowed: a name each",
            )
        for phase in self.schedule.phases:
            for contact in phase.contacts:
                self.robot.contact(contact)
        self._require_modes(names)
        self._require_impacts()
        self.schedule.require_steady_surfaces(self.terrain, self._starts)
        require_sliding(self.robot, self.schedule, self.actuation, tuple(self.modes))
        require_standing(self.robot, self.schedule, self.terrain, self._starts)
        self._require_periodicity()
        self._require_payloads(names)
        self._require_duration()
        for term in self.terms:
            for name in term.phases or ():
                if name not in names:
                    raise InputError(f"{term.name} acts in phase '{name}'", f"allowed: {', '.join(names)}")
        first, last = names[0], names[-1]
        limits = [rows for rows in self.point_constraints if rows.acts_in(first) and self.periodicity is None]
        require_start(self.name, self.robot, self.initial_q, self.initial_v, limits)
        standing = {name: self._standing(index) for index, name in enumerate(names)}
        require_goals(self.robot, self.terms, last, standing[last])
        require_reach(self.robot, self.terms, standing)

    def guess_at(self, t: float) -> np.ndarray:
        """The guess (nq,) at ``t`` s. Raises InputError, which names the time, if it is no configuration."""
        what, given = f"guess of problem '{self.name}' at t = {t:.6g} s", self.guess(t)
        try:
            q = np.array(given, dtype=float)
        except (TypeError, ValueError):
            raise InputError(f"{what} is not numeric", f"allowed: ({self.robot.nq},), finite") from None
        require_configuration(self.robot.model, q, what)
        return q

    def _require_modes(self, names: list[str]) -> None:
        """A mode is of this robot and stands where its contact is: where it was at the start, or landed."""
        for name, mode in self.modes.items():
            if name not in names:
                raise InputError(f"a mode is given for phase '{name}'", f"allowed: {', '.join(names)}")
            if mode.floating is not self.robot:
                raise InputError(
                    f"mode of phase '{name}' is of another robot", "allowed: modes of the problem's robot"
                )
            index = names.index(name)
            contact = mode.embedded.name
            if contact not in self.schedule.phases[index].contacts:
                raise InputError(
                    f"mode of phase '{name}' stands on '{contact}'", "allowed: contacts of the phase"
                )
            self._require_place(contact, index, mode)
        first = self.modes.get(names[0])
        if first is not None and first.loss(self.initial_q, self.initial_v) > SAME_PLACE:
            raise InputError(
                f"the start of problem '{self.name}' moves the contact on which its first mode stands",
                "allowed: an initial_q and initial_v with that contact at rest",
            )

    def _require_place(self, contact: str, index: int, mode: StanceMode) -> None:
        place = self.contact_place(contact, index)
        if place is None:
            begins = self.schedule.phases[self.schedule.beginning(contact, index)].name
            raise InputError(
                f"phase '{begins}' has no foothold for '{contact}', on which a mode stands",
                "allowed: a foothold at which the mode stands",
            )
        if np.linalg.norm(place - mode.anchor) > SAME_PLACE:
            name = self.schedule.phases[index].name
            raise InputError(f"mode of phase '{name}' stands at {mode.anchor}", f"allowed: {place}")

    def contact_place(self, contact: str, phase: int) -> np.ndarray | None:
        """World position (3,) in m of an active contact of a phase, None where it may land anywhere."""
        begins = self.schedule.beginning(contact, phase)
        if begins:
            return self.schedule.phases[begins].footholds.get(contact)
        place: np.ndarray = contact_positions(self.robot, self.initial_q)[contact]
        return place

    def _standing(self, phase: int) -> dict[str, np.ndarray]:
        """Where contacts of a phase are known to stand (3,) m: not those that slide or land anywhere."""
        phases, found = self.schedule.phases, {}
        for name in phases[phase].contacts:
            begins = self.schedule.beginning(name, phase)
            if begins == 0 and self.periodicity is not None:
                continue
            grounds = [phases[index].surfaces.get(name) for index in range(begins, phase + 1)]
            place = self.contact_place(name, phase)
            if place is not None and all(ground is None or ground.slip_speed is None for ground in grounds):
                found[name] = place
        return found

    def _require_impacts(self) -> None:
        for phase in self.schedule.phases:
            if phase.impact and not self.holds_contacts:
                raise InputError(
                    f"phase '{phase.name}' begins with an impact, but the dynamics hold no contacts",
                    "allowed: impact=False for a reduced model",
                )

    def _require_periodicity(self) -> None:
        if self.periodicity is None:
            return
        if self.modes or self.actuation == "velocity":
            what = "modes" if self.modes else "a velocity source"
            raise InputError(f"the periodic problem '{self.name}' has {what}", "allowed: neither")
        closing_map(self.robot, self.periodicity, self.initial_q)
        landing_at_start(self.robot, self.schedule, self.periodicity)

    def _require_payloads(self, names: list[str]) -> None:
        object.__setattr__(self, "payloads", MappingProxyType(dict(self.payloads)))
        for name, payload in self.payloads.items():
            if name not in names:
                raise InputError(f"a payload is given for phase '{name}'", f"allowed: {', '.join(names)}")
            contact = self.robot.contact(payload.contact).name
            if contact in self.schedule.phases[names.index(name)].contacts:
                raise InputError(
                    f"'{contact}' carries a payload in phase '{name}' and touches the surroundings",
                    "allowed: one of them",
                )
            if name in self.modes or self.dynamics is not None:
                raise InputError(
                    f"a payload is carried in phase '{name}' in minimal coordinates or by a reduced model",
                    "allowed: the whole robot's dynamics",
                )

    def robot_in(self, phase: str) -> Robot:
        """The robot in a phase: with what it carries there."""
        return self._loaded.get(phase, self.robot)

    @cached_property
    def _loaded(self) -> dict[str, Robot]:
        """The robot with its payload, by phase: a model that every node and point of the phase shares."""
        return {phase: loaded(self.robot, payload) for phase, payload in self.payloads.items()}

    def _require_duration(self) -> None:
        if self.duration_bounds is None:
            return
        lower, upper = self.schedule.duration_range
        try:
            low, high = (float(bound) for bound in self.duration_bounds)
        except (TypeError, ValueError):
            low = high = math.nan
        if not (0 < low <= high and high >= lower and low <= upper):
            raise InputError(
                f"duration_bounds of problem '{self.name}' are {self.duration_bounds} s",
                f"allowed: (lower, upper), meeting what the phases allow, {lower:g} to {upper:g} s",
            )
        object.__setattr__(self, "duration_bounds", (low, high))

    @property
    def holds_contacts(self) -> bool:
        """Whether the dynamics hold contacts in place; a reduced model without legs does not."""
        return any(isinstance(rows, ContactAcceleration | ContactVelocity) for rows in self.motion_rows)

    def _require_actuation(self) -> None:
        if self.actuation not in ACTUATIONS:
            raise InputError(f"actuation {self.actuation!r} is unknown", f"allowed: {', '.join(ACTUATIONS)}")
        if self.actuation != "velocity":
            return
        if self.initial_v.any():
            raise InputError(
                "initial_v of a velocity source is not zero", "allowed: zero, it has no such state"
            )
        for phase in self.schedule.phases:
            what = "has no contact" if self.robot.n_unactuated and not phase.contacts else ""
            if what or phase.impact:
                what = what or "begins with an impact"
                raise InputError(
                    f"phase '{phase.name}' {what}, which a velocity source cannot model",
                    "allowed: phases in static balance, or actuation 'torque' or 'acceleration'",
                )

    @property
    def costs(self) -> tuple[Cost, ...]:
        """Running costs."""
        return tuple(term for term in self.terms if isinstance(term, Cost) and term.acts_at_points)

    @property
    def impact_costs(self) -> tuple[Cost, ...]:
        """Costs of impacts."""
        return tuple(term for term in self.terms if isinstance(term, Cost) and term.acts_at_impacts)

    @property
    def node_costs(self) -> tuple[NodeCost, ...]:
        """Costs at single nodes."""
        return tuple(term for term in self.terms if isinstance(term, NodeCost))

    @property
    def motion_rows(self) -> tuple[PointConstraint, ...]:
        """The dynamics: rows that make it a motion of the robot."""
        if self.dynamics is not None:
            return self.dynamics
        still = ContactVelocity() if self.actuation == "velocity" else ContactAcceleration()
        slides = any(sliding_surfaces(phase) for phase in self.schedule.phases)
        return (BaseDynamics(), still, *([SlidingFriction()] if slides else []))

    def surfaces_of(self, phase: int) -> dict[str, Ground]:
        """What every contact of a phase touches, by the contact's name.

        A contact that stands since the start and for which nothing is named touches the terrain there.
        """
        starts, schedule = self._starts, self.schedule
        names = schedule.phases[phase].contacts
        return {name: schedule.surface(phase, name, self.terrain, starts) for name in names}

    @property
    def _starts(self) -> dict[str, np.ndarray]:
        """Where contacts stand at the start, m; on flat ground and of a free start nobody asks."""
        if isinstance(self.terrain, FlatGround) or self.periodicity is not None:
            return {}
        return contact_positions(self.robot, self.initial_q)

    @property
    def point_constraints(self) -> tuple[PointConstraint, ...]:
        """Constraints at collocation points, the dynamics first."""
        return (*self.motion_rows, *(term for term in self.terms if isinstance(term, PointConstraint)))

    @property
    def node_constraints(self) -> tuple[NodeConstraint, ...]:
        """Constraints at nodes, with those that follow from the schedule: landings of new contacts.

        Where the dynamics hold no contact (a reduced model without legs), nothing lands.
        """
        landings = self._start_rows() + tuple(
            ContactLanding(
                phase=phase.name,
                contacts=self.schedule.new_contacts(i),
                terrain=self.terrain,
                held=self.schedule.kept_contacts(i) if phase.impact else (),
            )
            for i, phase in enumerate(self.schedule.phases)
            if self.holds_contacts and self.schedule.new_contacts(i)
        )
        return landings + tuple(term for term in self.terms if isinstance(term, NodeConstraint))

    @property
    def free_directions(self) -> tuple[int, ...]:
        """Horizontal coordinates of the base along which a periodic motion may be shifted: 0 is x, 1 is y.

        None where something says where in the world the motion is: footholds, or a terrain that is no plane.
        """
        placed = any(phase.footholds or phase.patches for phase in self.schedule.phases)
        if self.periodicity is None or placed or not isinstance(self.terrain, FlatGround):
            return ()
        if self.robot.base == "fixed":
            return ()
        return (0,) if self.robot.base == "planar" or self.periodicity.mirror else (0, 1)

    def _start_rows(self) -> tuple[NodeConstraint, ...]:
        """A free start has unit rotations, and contacts that land with it."""
        if self.periodicity is None:
            return ()
        first = self.schedule.phases[0].name
        landing = landing_at_start(self.robot, self.schedule, self.periodicity)
        rows: tuple[NodeConstraint, ...] = ()
        if self.robot.base == "freeflyer":
            rows = (UnitRotation(phase=first),)
        if landing and self.holds_contacts:
            rows += (ContactLanding(phase=first, contacts=landing, terrain=self.terrain),)
        return rows
