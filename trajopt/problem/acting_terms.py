"""Every term of a problem can act: its names exist, it acts somewhere, and it uses all its arguments."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from typing import Any

from trajopt.errors import InputError, not_among
from trajopt.robot.robot import Robot
from trajopt.schedule.moment import Moment
from trajopt.schedule.schedule import Schedule
from trajopt.terms.interfaces import DuringPhases, Term
from trajopt.terms.node_costs import NodeCost
from trajopt.terms.node_interfaces import NodeConstraint, NodePlace, nodes_of

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
# Intervals of a phase in which a term at nodes is looked for: more than any mesh that is of use.
INTERVALS = 200
# A name that no phase has.
NO_PHASE = "\0"


def require_acting(robot: Robot, schedule: Schedule, terms: Sequence[Term]) -> None:
    """Raise `InputError` for a term that cannot act, or that has an argument it does not use.

    The check needs only fields (``at``, ``during``, ``contacts`` ...), ``acts_at`` and `Term.idle`, so it
    applies to terms of users too.
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
    """Names in the fields of a term are among those ``known`` of their kind."""
    during = getattr(term, "during", None)
    if during is not None and not during:
        what = f"during of {term.name}: {during!r}"
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
    """A contact of a term is active in some phase; of a term on forces, in a phase in which the term acts."""
    where = [phase.name for phase in schedule.phases if contact in phase.contacts]
    if not any(term.acts_in(name) or not term.acts_on_forces for name in where):
        phases = "no phase" if term.phases is None else f"none of the phases {', '.join(term.phases)}"
        active = f"it is active in {', '.join(where)}" if where else "allowed: contacts of the schedule"
        raise InputError(f"{term.name} is about contact '{contact}', which is active in {phases}", active)


def _require_nodes(term: NodeConstraint | NodeCost, schedule: Schedule) -> None:
    """A term at nodes acts at one at least, in each phase that it names, and ``during`` has an effect."""
    if not isinstance(term, DuringPhases) or term.phases is None:
        if not term.made_for_schedule and not any(term.acts_at(place) for place in _places(schedule)):
            raise InputError(f"{term.name} acts at no node of any phase", "allowed: terms that act")
        return
    anywhere: Any = copy.copy(term)
    object.__setattr__(anywhere, "during", None)
    places = (*_places(schedule), *_places(schedule, name=NO_PHASE))
    if all(term.acts_at(place) == anywhere.acts_at(place) for place in places):
        what = f"during of {term.name}: {term.during!r}, which this term does not use"
        raise InputError(what, "allowed: leave it out")
    for name in term.phases:
        if not any(term.acts_at(place) for place in _places(schedule) if place.phase.name == name):
            raise InputError(
                f"{term.name} acts at no node of phase '{name}'", "allowed: phases where it acts"
            )


def _places(schedule: Schedule, name: str = "") -> Iterator[NodePlace]:
    """Nodes of a fine mesh, in phases renamed to ``name``."""
    fractions = tuple(k / INTERVALS for k in range(INTERVALS + 1))
    phases = [copy.copy(phase) for phase in schedule.phases]
    for phase in phases:
        object.__setattr__(phase, "name", name or phase.name)
    for index in range(len(phases)):
        yield from nodes_of(phases, index, fractions)
