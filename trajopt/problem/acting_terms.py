"""Every term of a problem can act: the names it uses exist, and no argument of it is without effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

from trajopt.errors import InputError, not_among
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Schedule
from trajopt.terms.interfaces import Term
from trajopt.terms.node_costs import NodeCost
from trajopt.terms.node_interfaces import NodeConstraint


def require_acting(robot: Robot, schedule: Schedule, terms: Sequence[Term]) -> None:
    """Raise `InputError` for a term that could not act, or only in part.

    Names are found by the fields that hold them (``phase``, ``contacts`` ...), in the library's terms and
    in a user's own.
    """
    known = {
        "phase": schedule.names,
        "contact": tuple(contact.name for contact in robot.contacts),
        "frame": tuple(str(frame.name) for frame in robot.model.frames),
    }
    for term in terms:
        _require_phases_used(term)
        for field in fields(term):
            kind = field.name.removesuffix("s")
            for name in _names(getattr(term, field.name)) if kind in known else ():
                if name not in known[kind]:
                    what = f"{term.name} names {kind} '{name}', which does not exist"
                    raise not_among(known[kind], name, what)
                if kind == "contact":
                    _require_active(term, name, schedule)


def _names(value: object) -> tuple[str, ...]:
    if isinstance(value, str):
        return (value,)
    return tuple(value) if isinstance(value, list | tuple) else ()


def _require_phases_used(term: Term) -> None:
    if term.phases is None:
        return
    what = f"phases of {term.name}: {term.phases!r}"
    if not isinstance(term.phases, tuple | list) or not term.phases:
        raise InputError(what, "allowed: a tuple of names of phases, or None for all")
    fixed = getattr(type(term), "acts_at", None) in (NodeConstraint.acts_at, NodeCost.acts_at)
    if fixed or not term.acts_in_phases:
        own = "phase=" if any(field.name == "phase" for field in fields(term)) else "leave phases out"
        raise InputError(f"{what}, which this term does not use", f"allowed: {own}")


def _require_active(term: Term, contact: str, schedule: Schedule) -> None:
    """A contact that a term names must be active in a phase in which the term acts."""
    where = [phase.name for phase in schedule.phases if contact in phase.contacts]
    if not any(term.acts_in(name) for name in where):
        phases = "no phase" if term.phases is None else f"none of the phases {', '.join(term.phases)}"
        active = f"it is active in {', '.join(where)}" if where else "it is active nowhere"
        raise InputError(f"{term.name} is about contact '{contact}', which is active in {phases}", active)
