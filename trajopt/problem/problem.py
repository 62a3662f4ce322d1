"""A problem as data: robot, schedule, terrain, start, terms and a guess."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from trajopt.arguments import check_fields, checked
from trajopt.errors import InputError
from trajopt.inspection.standing import standing_feet
from trajopt.problem.guessing import default_guess
from trajopt.problem.periodicity import Periodicity, UnitRotation, closing_map, landing_at_start
from trajopt.problem.places import Stances, require_places
from trajopt.problem.validation import (
    require_acting,
    require_actuation,
    require_duration_bounds,
    require_following,
    require_modes,
    require_no_impacts,
    require_payloads,
    require_phases,
    require_start,
    require_wrenches,
)
from trajopt.robot.joint_checks import require_inertia
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.link_wrench import LinkWrench
from trajopt.robot.payload import Payload, loaded
from trajopt.robot.robot import Robot
from trajopt.robot.stance.minimal_coordinates import StanceMode
from trajopt.robot.validation import require_configuration
from trajopt.schedule.moment import Target, start_of
from trajopt.schedule.placing import footholds_at, require_standing
from trajopt.schedule.schedule import Motion, Phase, Schedule
from trajopt.terms.context_symbols import Actuation
from trajopt.terms.costs import AccelerationCost, NodeCost, WrenchCost
from trajopt.terms.dynamics import (
    BaseDynamics,
    ContactAcceleration,
    ContactVelocity,
    FollowingJoints,
    SlidingFriction,
    require_rolling,
    require_sliding,
    sliding_surfaces,
)
from trajopt.terms.friction import contact_cones
from trajopt.terms.interfaces import Cost, NodeConstraint, PointConstraint, Term
from trajopt.terms.landing import ContactLanding
from trajopt.terms.limits import AccelerationLimits, LimitsAtNodes
from trajopt.terms.moments import MomentConstraint
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.terrain import Ground, Terrain

# Duration, s, intervals and friction (rubber on a dry floor) of the problem at rest. The weight of wrenches,
# relative to accelerations, distributes forces without changing the motion.
REST_DURATION, REST_INTERVALS, REST_FRICTION, SPREAD = 1.0, 4, 0.7, 1e-6


@checked
@dataclass(frozen=True, kw_only=True)
class Problem:
    """Everything a transcription needs, independent of how it is transcribed or solved.

    Args:
        name: name in reports and files.
        robot: the robot.
        schedule: its contacts over time.
        terrain: the ground, default level at height 0.
        initial_q: configuration at the start (nq,), default the robot's reference. With a ``periodicity`` the
            start is free, and this is the reference of its rotations and fixes the motion's position in the
            world.
        initial_v: velocity at the start (nv,), default rest.
        terms: costs and constraints.
        guess: motion, time in s -> configuration (nq,), that follows the schedule and is defined a little
            beyond its ends; default from goal to goal, see `default_guess`. Rates follow by differences, and
            contact forces balance the motion.
        parameters: values of the family's parameters.
        default_intervals: number of intervals if the caller gives none.
        default_transcription: transcription if the caller gives none.
        actuation: the control input: "torque"; "jerk", where accelerations and torques are continuous and
            start and end at rest at zero; "acceleration", where no term may depend on torques; or "velocity",
            where configurations are the state, contacts do not slide and a free base is in static balance.
        dynamics: constraints that hold for every motion of this robot; default those of the actuation, while
            a reduced model has its own.
        modes: minimal coordinates of phases, by the phase's name.
        periodicity: makes the final state the image of the start, which is then free.
        duration_bounds: bounds (lower, upper) in s on the total duration, if some phases are free.
        payloads: what the robot carries in phases, by the phase's name.
        wrenches: known wrenches on links over time.

    Raises:
        InputError: for parts that are inconsistent.
    """

    name: str
    robot: Robot
    schedule: Schedule
    terms: tuple[Term, ...]
    guess: Motion = None  # type: ignore[assignment]
    terrain: Terrain = field(default_factory=FlatGround)
    initial_q: np.ndarray = None  # type: ignore[assignment]
    initial_v: np.ndarray = None  # type: ignore[assignment]
    parameters: Mapping[str, object] = field(default_factory=dict)
    default_intervals: int = 50
    default_transcription: str = "legendre:2"
    actuation: Actuation = "torque"
    dynamics: tuple[PointConstraint, ...] | None = None
    modes: Mapping[str, StanceMode] = field(default_factory=dict)
    periodicity: Periodicity | None = None
    duration_bounds: tuple[float, float] | None = None
    payloads: Mapping[str, Payload] = field(default_factory=dict)
    wrenches: tuple[LinkWrench, ...] = ()

    def __post_init__(self) -> None:
        robot, schedule = self.robot, self.schedule
        for label, usual in (("initial_q", robot.reference), ("initial_v", np.zeros(robot.nv))):
            given = getattr(self, label)
            array = np.array(usual if given is None else given, dtype=float)
            if array.shape != usual.shape:
                what = f"{label} of problem '{self.name}' has shape {array.shape}"
                raise InputError(what, f"allowed: ({len(usual)},), finite")
            array.setflags(write=False)
            object.__setattr__(self, label, array)
        for label in ("parameters", "modes", "payloads"):
            object.__setattr__(self, label, MappingProxyType(dict(getattr(self, label))))
        for term in self.terms:
            check_fields(term)
        require_actuation(robot, schedule, self.actuation, self.initial_v, tuple(self.modes))
        if self.actuation in ("torque", "jerk"):
            require_inertia(robot)
        require_phases(self.name, robot, schedule)
        if robot.mimics:
            require_following(self.name, robot, schedule, self.initial_q, self.initial_v)
        start = self.initial_q, self.initial_v
        require_modes(self.name, robot, schedule, self.modes, start, self.contact_place)
        if not self.holds_contacts:
            require_no_impacts(schedule)
        schedule.require_steady_surfaces(self.terrain, self._starts)
        require_sliding(robot, schedule, self.actuation, tuple(self.modes))
        require_standing(robot, schedule, self.terrain, self._starts)
        if any(contact.rolling for contact in robot.contacts):
            phases = range(len(schedule.phases))
            grounds = [self.surfaces_of(i) if self.holds_contacts else {} for i in phases]
            require_rolling(robot, schedule, grounds, tuple(self.modes))
        if self.periodicity is not None:
            if self.modes or self.actuation == "velocity":
                what = "modes" if self.modes else "a velocity source"
                raise InputError(f"the periodic problem '{self.name}' has {what}", "allowed: neither")
            closing_map(robot, self.periodicity, self.initial_q)
            if self.holds_contacts:
                landing_at_start(robot, schedule, self.periodicity)
        whole = () if self.dynamics is not None else schedule.names
        require_payloads(robot, schedule, self.payloads, [name for name in whole if name not in self.modes])
        require_wrenches(robot, schedule, self.wrenches, self.periodicity)
        if self.wrenches and (self.modes or self.dynamics is not None):
            what = f"problem '{self.name}' has wrenches, and minimal coordinates or dynamics of its own"
            raise InputError(what, "allowed: the whole robot's dynamics")
        if self.duration_bounds is not None:
            require_duration_bounds(self.name, schedule, self.duration_bounds)
        require_acting(robot, schedule, self.terms)
        if self.guess is None:
            where = {"terrain": self.terrain, "start": self.initial_q, "periodicity": self.periodicity}
            object.__setattr__(self, "guess", default_guess(robot, schedule, self.terms, **where))
        first = schedule.names[0]
        limits = [rows for rows in self.point_constraints if rows.acts_in(first) and self.periodicity is None]
        require_start(self.name, robot, *start, limits)
        fixed = self.initial_q if self.holds_contacts and self.periodicity is None else None
        require_places(self._stances(), fixed, self.terms, self.point_constraints)

    def guess_at(self, t: float) -> np.ndarray:
        """The guess (nq,) at ``t`` s. Raises InputError with the time if it is not a configuration."""
        what, given = f"guess of problem '{self.name}' at t = {t:.6g} s", self.guess(t)
        try:
            q = np.array(given, dtype=float)
        except (TypeError, ValueError):
            raise InputError(f"{what} is not numeric", f"allowed: ({self.robot.nq},), finite") from None
        require_configuration(self.robot.model, q, what)
        return q

    def contact_place(self, contact: str, phase: int) -> np.ndarray | None:
        """World position (3,) in m of an active contact's frame in a phase, None if it may land anywhere."""
        begins = self.schedule.beginning(contact, phase)
        if begins:
            return self.schedule.phases[begins].centre(self.robot.contact(contact), self.terrain)
        place: np.ndarray = contact_positions(self.robot, self.initial_q)[contact]
        return place

    def _stances(self) -> Stances:
        """Where contacts stand, as far as it is known before solving."""
        phases = range(len(self.schedule.phases))
        grounds = tuple(self.surfaces_of(index) if self.holds_contacts else {} for index in phases)
        places = tuple(self._standing(index) for index in phases)
        return Stances(robot=self.robot, schedule=self.schedule, grounds=grounds, places=places)

    def _standing(self, phase: int) -> dict[str, np.ndarray]:
        """Known positions (3,) in m of a phase's contacts, without those that slide or may land anywhere."""
        phases, places = self.schedule.phases, {}
        for name in phases[phase].contacts:
            begins = self.schedule.beginning(name, phase)
            if begins == 0 and self.periodicity is not None:
                continue
            grounds = [phases[index].surfaces.get(name) for index in range(begins, phase + 1)]
            place = self.contact_place(name, phase)
            if place is not None and all(ground is None or ground.slip_speed is None for ground in grounds):
                places[name] = place
        return places

    def robot_in(self, phase: str) -> Robot:
        """The robot in a phase, with the payload it carries there."""
        return self._loaded.get(phase, self.robot)

    @cached_property
    def _loaded(self) -> dict[str, Robot]:
        """The robot with its payload, by phase: a model that every node and point of the phase shares."""
        return {phase: loaded(self.robot, payload) for phase, payload in self.payloads.items()}

    @property
    def holds_contacts(self) -> bool:
        """Whether the dynamics hold contacts in place; a reduced model without legs does not."""
        return any(isinstance(rows, ContactAcceleration | ContactVelocity) for rows in self.motion_rows)

    @property
    def dynamics_kind(self) -> Literal["held", "forced", "own"]:
        """What a check may assume of the dynamics, see `PlanDescription`."""
        if self.holds_contacts:
            return "held"
        return "forced" if any(isinstance(rows, BaseDynamics) for rows in self.motion_rows) else "own"

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
        """The dynamics: constraints that hold for every motion of the robot."""
        if self.dynamics is not None:
            return self.dynamics
        still = ContactVelocity() if self.actuation == "velocity" else ContactAcceleration()
        slides = any(sliding_surfaces(phase) for phase in self.schedule.phases)
        follow = (FollowingJoints(),) if self.robot.mimics else ()
        return (BaseDynamics(), still, *follow, *([SlidingFriction()] if slides else []))

    def surfaces_of(self, phase: int) -> dict[str, Ground]:
        """Surfaces on which the frames of a phase's contacts lie, by the contact's name.

        Each is the surface that the contact touches, or the parallel one at the contact's radius. A contact
        that stands from the start, and for which nothing is stated, touches the terrain there.
        """
        return self._surfaces[phase]

    @cached_property
    def _surfaces(self) -> tuple[dict[str, Ground], ...]:
        on, terrain, starts = self.schedule.surface, self.terrain, self._starts
        return tuple(
            {name: on(k, name, terrain, starts, self.robot.contact(name).radius) for name in phase.contacts}
            for k, phase in enumerate(self.schedule.phases)
        )

    @cached_property
    def levers(self) -> tuple[dict[str, np.ndarray], ...]:
        """Levers (3,) in m of each phase's rolling contacts, by the contact's name, see `Contact.lever`."""
        phases = range(len(self.schedule.phases))
        if not any(contact.rolling for contact in self.robot.contacts):
            return tuple({} for _ in phases)
        grounds = (self.surfaces_of(phase).items() for phase in phases)
        every = ({name: self.robot.contact(name).lever(on) for name, on in each} for each in grounds)
        return tuple({name: arm for name, arm in arms.items() if arm is not None} for arms in every)

    @cached_property
    def _starts(self) -> dict[str, np.ndarray]:
        """Ground points under contacts at the start, m; empty on flat ground and for a free start."""
        if isinstance(self.terrain, FlatGround) or self.periodicity is not None:
            return {}
        return footholds_at(self.robot, self.initial_q, self.terrain)

    @property
    def point_constraints(self) -> tuple[PointConstraint, ...]:
        """Constraints at collocation points, the dynamics first."""
        return (*self.motion_rows, *(term for term in self.terms if isinstance(term, PointConstraint)))

    @property
    def node_constraints(self) -> tuple[NodeConstraint, ...]:
        """Constraints at nodes, with those that follow from the schedule: landings of new contacts.

        If the dynamics hold no contacts (a reduced model without legs), there are no landings.
        """
        landings = self._start_rows() + tuple(
            ContactLanding(
                at=start_of(phase.name),
                contacts=self.schedule.new_contacts(i),
                terrain=self.terrain,
                held=self.schedule.kept_contacts(i) if phase.impact else (),
            )
            for i, phase in enumerate(self.schedule.phases)
            if self.holds_contacts and self.schedule.new_contacts(i)
        )
        limits = [term for term in self.terms if isinstance(term, AccelerationLimits)]
        at_nodes = tuple(LimitsAtNodes(limits=term) for term in limits if self.actuation == "jerk")
        return landings + tuple(term for term in self.terms if isinstance(term, NodeConstraint)) + at_nodes

    @property
    def moment_constraints(self) -> tuple[MomentConstraint, ...]:
        """Constraints at chosen moments of phases."""
        return tuple(t for t in self.terms if isinstance(t, MomentConstraint) and len(t.fractions))

    @property
    def goals(self) -> list[Target]:
        """Goals as solutions record them: the terms' targets, then footholds as places of contact frames."""
        targets = [target for term in self.terms for target in term.targets()]
        for phase in self.schedule.phases:
            for name in phase.footholds:
                contact = self.robot.contact(name)
                place = phase.centre(contact, self.terrain)
                targets.append(Target(frame=contact.frame, position=place, at=start_of(phase.name)))
        return targets

    @property
    def free_directions(self) -> tuple[int, ...]:
        """Horizontal coordinates of the base along which a periodic motion may be shifted: 0 is x, 1 is y.

        Empty if footholds, patches, ground that is not flat or a fixed base determine the motion's position.
        """
        placed = any(phase.footholds or phase.patches for phase in self.schedule.phases)
        if self.periodicity is None or placed or not isinstance(self.terrain, FlatGround):
            return ()
        if self.robot.base == "fixed":
            return ()
        return (0,) if self.robot.base == "planar" or self.periodicity.mirror else (0, 1)

    def _start_rows(self) -> tuple[NodeConstraint, ...]:
        """Rows of a free start: unit rotations, and contacts that land there."""
        if self.periodicity is None:
            return ()
        first = self.schedule.phases[0].name
        rows: tuple[NodeConstraint, ...] = ()
        if self.robot.base == "freeflyer":
            rows = (UnitRotation(at=start_of(first)),)
        landing = landing_at_start(self.robot, self.schedule, self.periodicity) if self.holds_contacts else ()
        if landing:
            rows += (ContactLanding(at=start_of(first), contacts=landing, terrain=self.terrain),)
        return rows


@checked
@dataclass(frozen=True)
class PublishedOptimum:
    """A problem with a published optimum.

    ``build`` returns the problem and ``value`` computes the published ``quantity`` from a solution. The
    ``published`` value is from ``source`` and holds to a relative ``tolerance``. ``name`` is for tables.
    """

    name: str
    build: Callable[[], Problem]
    value: Callable[[Any], float]
    quantity: str
    published: float
    tolerance: float
    source: str


def rest(robot: Robot, duration: float = REST_DURATION) -> Problem:
    """Return the problem of staying in the reference posture for ``duration`` s, on the feet if any.

    The cost is on accelerations, with a small weight on wrenches to distribute them. Torques are not limited,
    and the robot starts at rest: a posture that is not balanced falls over.
    """
    feet = standing_feet(robot)
    spread = (WrenchCost(weight=SPREAD),) if feet else ()
    return Problem(
        name="rest",
        robot=robot,
        schedule=Schedule((Phase(name="rest", duration=duration, contacts=tuple(c.name for c in feet)),)),
        terrain=FlatGround(friction=REST_FRICTION),
        initial_q=robot.reference,
        initial_v=np.zeros(robot.nv),
        terms=(AccelerationCost(weight=1.0), *spread, *contact_cones(feet)),
        guess=lambda _: robot.reference,
        default_intervals=REST_INTERVALS,
    )
