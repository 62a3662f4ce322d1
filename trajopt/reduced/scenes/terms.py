"""Terms of a whole robot's problem, translated to the small robot by kind.

Limits and goals are restated for the small robot, without duplicate rows. Costs, and constraints of other
kinds, are evaluated on the whole robot's motion (`whole_terms`). A user-defined term may define its own
reduction by a method ``reduced(reduction) -> Term | None``.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial, singledispatch
from types import MappingProxyType
from typing import TypeVar

import numpy as np

from trajopt.problem.problem import Problem
from trajopt.reduced.scenes.reduction import Reduction
from trajopt.reduced.scenes.whole_terms import (
    HalfEnd,
    WholeCost,
    WholeImpactCost,
    WholeNodeCost,
    WholeNodeRows,
    WholePointRows,
)
from trajopt.schedule.schedule import Motion, Phase, Schedule
from trajopt.terms.costs import NodeCost
from trajopt.terms.drives import DriveLimits
from trajopt.terms.dynamics import BaseDynamics, ContactAcceleration, ContactVelocity, ImpactDynamics
from trajopt.terms.frames import FrameHeight, FramePose, FrameVelocity
from trajopt.terms.friction import ContactConstraint, NormalForce
from trajopt.terms.interfaces import Cost, NodeConstraint, PointConstraint, Term
from trajopt.terms.limits import PositionLimits, TorqueLimits, VelocityLimits
from trajopt.terms.swing import SwingClearance
from trajopt.terms.terminal import TerminalRest, TerminalState

_Value = TypeVar("_Value")

UNCHANGED = (
    BaseDynamics, ContactAcceleration, ContactVelocity, ImpactDynamics, VelocityLimits, PositionLimits,
    DriveLimits, SwingClearance,
)  # fmt: skip


def reduced_problem(problem: Problem, reduction: Reduction) -> Problem:
    """Return the problem of the small robot: the same schedule with the small robot's contacts."""
    made = (t.reduced(reduction) if hasattr(t, "reduced") else _reduced(t, reduction) for t in problem.terms)
    return replace(
        problem,
        robot=reduction.small,
        schedule=Schedule(tuple(_phase(phase, reduction) for phase in problem.schedule.phases)),
        initial_q=reduction.drop_q(problem.initial_q),
        initial_v=reduction.drop_v(problem.initial_v),
        terms=tuple(term for term in made if term is not None),
        guess=partial(_dropped, problem.guess, reduction),
    )


def _dropped(guess: Motion, reduction: Reduction, t: float) -> np.ndarray:
    return reduction.drop_q(guess(t))


def _phase(phase: Phase, reduction: Reduction) -> Phase:
    """Return the phase with the small robot's contacts."""
    left = [name for name in phase.contacts if not reduction.contacts[name].mirrored]
    kept = {name: reduction.contacts[name].name for name in left}
    return replace(
        phase,
        contacts=tuple(kept.values()),
        footholds=_renamed(phase.footholds, kept),
        surfaces=_renamed(phase.surfaces, kept),
        patches=_renamed(phase.patches, kept),
    )


def _renamed(given: Mapping[str, _Value], kept: Mapping[str, str]) -> Mapping[str, _Value]:
    return MappingProxyType({kept[name]: value for name, value in given.items() if name in kept})


@singledispatch
def _reduced(term: Term, reduction: Reduction) -> Term | None:
    """Return the reduced term, or None if nothing remains; terms of other kinds act on the whole motion."""
    if isinstance(term, UNCHANGED):
        return term
    if isinstance(term, Cost):
        kind = WholeCost if term.acts_at_points else WholeImpactCost
        return kind(weight=term.weight, during=term.during, term=term, reduction=reduction)
    if isinstance(term, NodeCost):
        return WholeNodeCost(weight=term.weight, term=term, reduction=reduction)
    if isinstance(term, NodeConstraint):
        return WholeNodeRows(term=term, reduction=reduction)
    if isinstance(term, PointConstraint):
        return WholePointRows(during=term.during, term=term, reduction=reduction)
    return term


@_reduced.register
def _(term: TorqueLimits, reduction: Reduction) -> Term:
    return term if term.limit is None else replace(term, limit=reduction.drop_torques(term.limit))


@_reduced.register
def _(term: ContactConstraint, reduction: Reduction) -> Term | None:
    if term.contacts is None:
        return term
    followed = [reduction.contacts[name].name for name in term.contacts if name in reduction.contacts]
    return replace(term, contacts=tuple(dict.fromkeys(followed))) if followed else None


@_reduced.register
def _(term: NormalForce, reduction: Reduction) -> Term | None:
    follower = reduction.contacts.get(term.contact)
    if follower is None or follower.mirrored:
        return None
    members = reduction.contact_members(follower.name)
    bounds = [None if bound is None else members * bound for bound in (term.lower, term.upper)]
    return replace(term, contact=follower.name, lower=bounds[0], upper=bounds[1])


@_reduced.register(FrameHeight)
@_reduced.register(FramePose)
@_reduced.register(FrameVelocity)
def _(term: FrameHeight | FramePose | FrameVelocity, reduction: Reduction) -> Term | None:
    if term.frame in reduction.mirrored_frames:
        return None
    if not reduction.is_half or isinstance(term, FrameHeight):
        return term
    return WholeNodeRows(term=term, reduction=reduction)


@_reduced.register(TerminalState)
@_reduced.register(TerminalRest)
def _(term: TerminalState | TerminalRest, reduction: Reduction) -> Term:
    if reduction.is_half:
        return HalfEnd(term=term, reduction=reduction)
    if term.q is None:
        return term
    return replace(term, q=reduction.drop_q(np.asarray(term.q, dtype=float)))
