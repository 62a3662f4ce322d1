"""Validation of problems: inconsistent parts, invalid starts, and terms that cannot act."""

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from trajopt.dynamics.base_joint import BASE_ROWS
from trajopt.dynamics.manifold import Coordinates
from trajopt.dynamics.virtual_base import LEAST_MARGIN, gimbal_margin
from trajopt.errors import InputError, not_among, shown
from trajopt.problem.periodicity import Periodicity
from trajopt.robot.actuators.mimic import followed
from trajopt.robot.link_wrench import LinkWrench
from trajopt.robot.payload import Payload
from trajopt.robot.robot import Robot
from trajopt.robot.stance.minimal_coordinates import StanceMode
from trajopt.robot.validation import require_configuration
from trajopt.schedule.moment import Moment
from trajopt.schedule.schedule import Schedule
from trajopt.terms.costs import NodeCost
from trajopt.terms.interfaces import DuringPhases, NodeConstraint, NodePlace, PointConstraint, Term, nodes_of
from trajopt.terms.limits import PositionLimits

# A start may exceed a limit by as much as the check allows: this fraction of the limit, and at least this
# much in rad, m, rad/s or m/s.
LIMIT_SLACK = 1e-6
# The foothold of a phase and the anchor of its mode agree to rounding, m.
SAME_PLACE = 1e-9
# Fields of terms that hold names, and what they name.
NAMES = {
    "phase": "phase",
    "at": "phase",
    "during": "phase",
    "contact": "contact",
    "contacts": "contact",
    "over": "contact",
    "frame": "frame",
    "frames": "frame",
}
# Intervals per phase in the search for nodes at which a term acts; more than any useful mesh has.
INTERVALS = 200
# A name that no phase has.
NO_PHASE = "\0"


def require_phase(schedule: Schedule, name: str, what: str) -> None:
    """Raise `InputError`, beginning with ``what``, for a phase that the schedule does not have."""
    if name not in schedule.names:
        raise not_among(schedule.names, name, f"{what} phase '{name}', which does not exist")


def require_phases(problem: str, robot: Robot, schedule: Schedule) -> None:
    """Raise `InputError` for two phases with the same name, and contacts that the robot does not have."""
    names = schedule.names
    if len(set(names)) != len(names):
        raise InputError(
            f"problem '{problem}' has two phases of the same name: {', '.join(names)}",
            "allowed: different names",
        )
    for phase in schedule.phases:
        for contact in phase.contacts:
            robot.contact(contact)


def require_actuation(
    robot: Robot, schedule: Schedule, actuation: str, initial_v: np.ndarray, modes: Sequence[str]
) -> None:
    """Raise `InputError` for a start or a phase that a source of velocities or jerks cannot model."""
    impact = next((phase.name for phase in schedule.phases if phase.impact), None)
    if actuation == "jerk" and (impact or modes):
        what = (
            f"phase '{impact}' begins with an impact"
            if impact
            else f"phase '{modes[0]}' has minimal coordinates"
        )
        raise InputError(f"{what}, and jerks are the input", "allowed: neither impacts nor modes")
    if actuation == "jerk" and initial_v.any() and schedule.phases[0].contacts:
        what = f"phase '{schedule.phases[0].name}' begins on contacts in motion, and jerks are the input"
        raise InputError(what, "allowed: initial_v zero, as the accelerations at the start")
    if actuation != "velocity":
        return
    if initial_v.any():
        raise InputError("initial_v of a velocity source is not zero", "allowed: zero, it has no such state")
    for phase in schedule.phases:
        falls = robot.n_unactuated and not phase.contacts
        if falls or phase.impact:
            what = "has no contact" if falls else "begins with an impact"
            raise InputError(
                f"phase '{phase.name}' {what}, which a velocity source cannot model",
                "allowed: phases in static balance, or actuation 'torque' or 'acceleration'",
            )


def require_following(problem: str, robot: Robot, schedule: Schedule, q: np.ndarray, v: np.ndarray) -> None:
    """Raise `InputError` if mimic joints do not follow their leaders at the start, or for an impact."""
    apart = np.abs(q - followed(robot.model, robot.mimics, q))
    if (
        apart.max(initial=0.0) > LIMIT_SLACK
        or np.abs(robot.actuation.coupling @ v).max(initial=0.0) > LIMIT_SLACK
    ):
        pairs = ", ".join(f"'{mimic.joint}' after '{mimic.mimics}'" for mimic in robot.mimics)
        raise InputError(f"the start of problem '{problem}' has joints apart that follow others", pairs)
    if any(phase.impact for phase in schedule.phases):
        raise InputError(
            f"robot '{robot.name}' has joints that follow others, and a phase begins with an impact",
            "allowed: landings at zero velocity",
        )


def require_modes(
    problem: str,
    robot: Robot,
    schedule: Schedule,
    modes: Mapping[str, StanceMode],
    start: tuple[np.ndarray, np.ndarray],
    contact_place: Callable[[str, int], np.ndarray | None],
) -> None:
    """Raise `InputError` for a mode whose robot or place is not its phase's, or that the start contradicts.

    ``modes`` are given by the phase's name. ``contact_place`` maps a contact and the index of a phase to the
    contact's position (3,) in the world, m, None if unknown.
    """
    for name, mode in modes.items():
        require_phase(schedule, name, "a mode is given for")
        if mode.floating is not robot:
            raise InputError(
                f"mode of phase '{name}' is of another robot", "allowed: modes of the problem's robot"
            )
        index, contact = schedule.names.index(name), mode.contact
        if contact not in schedule.phases[index].contacts:
            raise InputError(
                f"mode of phase '{name}' stands on '{contact}'", "allowed: contacts of the phase"
            )
        place = contact_place(contact, index)
        if place is None:
            begins = schedule.names[schedule.beginning(contact, index)]
            raise InputError(
                f"phase '{begins}' has no foothold for '{contact}', on which a mode stands",
                "allowed: a foothold at which the mode stands",
            )
        if np.linalg.norm(place - mode.anchor) > SAME_PLACE:
            raise InputError(f"mode of phase '{name}' stands at {mode.anchor}", f"allowed: {place}")
    first = modes.get(schedule.names[0])
    if first is not None and first.loss(*start) > SAME_PLACE:
        raise InputError(
            f"the start of problem '{problem}' moves the contact on which its first mode stands",
            "allowed: an initial_q and initial_v with that contact at rest",
        )


def require_no_impacts(schedule: Schedule) -> None:
    """Raise `InputError` for a phase that begins with an impact, if the dynamics hold no contacts."""
    impact = next((phase.name for phase in schedule.phases if phase.impact), None)
    if impact is not None:
        what = f"phase '{impact}' begins with an impact, but the dynamics hold no contacts"
        raise InputError(what, "allowed: impact=False for a reduced model")


def require_payloads(
    robot: Robot, schedule: Schedule, payloads: Mapping[str, Payload], whole: Sequence[str]
) -> None:
    """Raise `InputError` for a payload on a contact in use, or in a phase without the whole robot's dynamics.

    ``whole`` names the phases that have these dynamics.
    """
    for name, payload in payloads.items():
        require_phase(schedule, name, "a payload is given for")
        contact = robot.contact(payload.contact).name
        if contact in schedule.phases[schedule.names.index(name)].contacts:
            raise InputError(
                f"'{contact}' carries a payload in phase '{name}' and touches the surroundings",
                "allowed: one of them",
            )
        if name not in whole:
            raise InputError(
                f"a payload is carried in phase '{name}' in minimal coordinates or by a reduced model",
                "allowed: the whole robot's dynamics",
            )


def require_wrenches(
    robot: Robot, schedule: Schedule, wrenches: Sequence[LinkWrench], periodicity: Periodicity | None
) -> None:
    """Raise `InputError` for a wrench on an unknown or fixed frame, or at times that are not known."""
    free = [index for index, scale in enumerate(schedule.time_scales) if scale is not None]
    known = sum(phase.duration for phase in schedule.phases[: free[0]]) if free else np.inf
    for wrench in wrenches:
        wrench.place(robot.model)
        what, allowed = f"a wrench on '{wrench.frame}'", ""
        if (np.diff(wrench.times) <= 0).any():
            allowed = "times that ascend, in a plan; a jump is a short ramp"
        elif len(wrench.times) > 1 and wrench.times[-1] > known:
            phase, what = schedule.phases[free[0]].name, f"{what} varies until {wrench.times[-1]:g} s"
            allowed = f"constant from {known:g} s on, when phase '{phase}' of free duration begins"
        elif periodicity is not None and (len(wrench.times) > 1 or periodicity.mirror or periodicity.turn):
            allowed = "constant ones in a periodic motion, without mirror and turn"
        if allowed:
            raise InputError(what, f"allowed: {allowed}")


def require_duration_bounds(problem: str, schedule: Schedule, bounds: tuple[float, float]) -> None:
    """Raise `InputError` for bounds on the total duration, s, that the phases cannot meet."""
    (lower, upper), (low, high) = schedule.duration_range, bounds
    if not (0 < low <= high and high >= lower and low <= upper):
        raise InputError(
            f"duration_bounds of problem '{problem}' are {bounds} s",
            f"allowed: (lower, upper), meeting what the phases allow, {lower:g} to {upper:g} s",
        )


def require_start(
    problem: str, robot: Robot, q: np.ndarray, v: np.ndarray, rows: Sequence[PointConstraint]
) -> None:
    """Raise `InputError` for a start that is not a configuration or exceeds limits of the problem.

    ``rows`` are constraints of the first phase; none for a free start, whose limits are rows of the problem.
    """
    require_configuration(robot.model, q, f"initial_q of problem '{problem}'")
    margin = gimbal_margin(robot.model, q)
    if margin is not None and margin < LEAST_MARGIN:
        raise InputError(
            f"problem '{problem}' starts in gimbal lock: margin {margin:.3f} < {LEAST_MARGIN}",
            "another order of the virtual joints, or base='freeflyer'",
        )
    require_limits(f"at the start of problem '{problem}'", robot, q, v, rows)


def require_limits(
    where: str, robot: Robot, q: np.ndarray, v: np.ndarray, rows: Sequence[PointConstraint]
) -> None:
    """Raise `InputError`, beginning with ``where``, for a state beyond the limits of ``rows``."""
    coordinates = Coordinates(robot.model)
    node = coordinates.node_from_pinocchio(q, v)
    positions, n4 = np.zeros(robot.nv), 4 * coordinates.n_rotations
    positions[coordinates.additive_index] = node[n4 : n4 + len(coordinates.additive_index)]
    for term in rows:
        what = where, term.name
        if isinstance(term, PositionLimits):
            # All limits of the robot, including those so wide that no rows impose them.
            given = np.array([q, robot.position_lower, robot.position_upper])
            every = np.full((3, robot.nv), np.nan)
            for joint in coordinates.joints:
                if joint.kind == "plain" and joint.v.start >= BASE_ROWS[robot.base]:
                    every[:, joint.v] = given[:, joint.q]
            _require_within(robot, (*what, "is at"), every[0], (every[1], every[2]))
        bounds = term.node_bounds(robot)
        if bounds is not None:
            _require_within(robot, (*what, "is at"), positions, bounds[:2])
            _require_within(robot, (*what, "moves at"), node[-robot.nv :], bounds[2:])


def _require_within(
    robot: Robot, what: tuple[str, str, str], values: np.ndarray, bounds: tuple[np.ndarray, ...]
) -> None:
    """Require values (nv,) within (lower, upper), up to the slack; ``what`` is the place, term and verb."""
    (where, term, how), (lower, upper) = what, bounds
    room = [LIMIT_SLACK * np.where(np.isfinite(b), np.maximum(np.abs(b), 1.0), 1.0) for b in (lower, upper)]
    for row in np.flatnonzero((values < lower - room[0]) | (values > upper + room[1])):
        joint = next(j for j in Coordinates(robot.model).joints if j.v.start <= row < j.v.stop)
        raise InputError(
            f"{where} joint '{joint.name}' {how} {values[row]:.9g}, beyond its {term}",
            f"allowed: {lower[row]:.9g} to {upper[row]:.9g}",
        )


def require_acting(robot: Robot, schedule: Schedule, terms: Sequence[Term]) -> None:
    """Raise `InputError` for a term that cannot act, or that has an argument it does not use.

    The check needs only fields (``at``, ``during``, ``contacts`` ...), ``acts_at`` and `Term.idle`, so it
    applies to user-defined terms too.
    """
    known = {
        "phase": schedule.names,
        "contact": tuple(contact.name for contact in robot.contacts),
        "frame": tuple(str(frame.name) for frame in robot.model.frames),
    }
    for term in terms:
        _require_names(term, known, schedule)
        if isinstance(term, NodeConstraint | NodeCost):
            _require_nodes(term, schedule)
        reason = term.idle(robot, schedule)
        if reason:
            raise InputError(f"{term.name} cannot act: {reason}", "allowed: terms that act")


def _require_names(term: Term, known: Mapping[str, tuple[str, ...]], schedule: Schedule) -> None:
    """Require the names in a term's fields to be among those ``known`` of their kind."""
    during = getattr(term, "during", None)
    if during is not None and not during:
        what = f"during of {term.name}: {shown(during)}"
        raise InputError(what, "allowed: the name of a phase, names of several, or None for all")
    for field in fields(term):
        kind = NAMES.get(field.name, "")
        for name in _names(getattr(term, field.name)) if kind else ():
            if name not in known[kind]:
                what = f"{term.name} names {kind} '{name}', which does not exist"
                raise not_among(known[kind], name, what)
            if kind == "contact":
                _require_active(term, name, schedule)


def _names(value: object) -> tuple[str, ...]:
    if isinstance(value, Moment):
        value = value.phase
    if isinstance(value, str):
        return (value,)
    return tuple(value) if isinstance(value, list | tuple) else ()


def _require_active(term: Term, contact: str, schedule: Schedule) -> None:
    """Require a term's contact to be active in a phase; for a term on forces, in one where the term acts."""
    where = [phase.name for phase in schedule.phases if contact in phase.contacts]
    if not any(term.acts_in(name) or not term.acts_on_forces for name in where):
        phases = "no phase" if term.phases is None else f"none of the phases {', '.join(term.phases)}"
        active = f"it is active in {', '.join(where)}" if where else "allowed: contacts of the schedule"
        raise InputError(f"{term.name} is about contact '{contact}', which is active in {phases}", active)


def _require_nodes(term: NodeConstraint | NodeCost, schedule: Schedule) -> None:
    """Require a term to act at a node, in each phase that it names, and to depend on its ``during``."""
    if not isinstance(term, DuringPhases) or term.phases is None:
        if not term.made_for_schedule and not any(term.acts_at(place) for place in _places(schedule)):
            raise InputError(f"{term.name} acts at no node of any phase", "allowed: terms that act")
        return
    anywhere: Any = copy.copy(term)
    object.__setattr__(anywhere, "during", None)
    places = (*_places(schedule), *_places(schedule, name=NO_PHASE))
    if all(term.acts_at(place) == anywhere.acts_at(place) for place in places):
        what = f"during of {term.name}: {shown(term.during)}, which this term does not use"
        raise InputError(what, "allowed: leave it out")
    for name in term.phases:
        if not any(term.acts_at(place) for place in _places(schedule) if place.phase.name == name):
            raise InputError(
                f"{term.name} acts at no node of phase '{name}'", "allowed: phases where it acts"
            )


def _places(schedule: Schedule, name: str = "") -> Iterator[NodePlace]:
    """Nodes of a fine mesh; all phases are renamed to a ``name`` that is not empty."""
    fractions = tuple(k / INTERVALS for k in range(INTERVALS + 1))
    phases = [copy.copy(phase) for phase in schedule.phases]
    for phase in phases:
        object.__setattr__(phase, "name", name or phase.name)
    for index in range(len(phases)):
        yield from nodes_of(phases, index, fractions)
