"""Bounds of the unknowns: limits that hold at nodes, free durations, and the fixed start.

A scheme with a point at an interval's start or end states a limit there as a row already: the node
gets no bound then, which would repeat the row. Where rates are measured in the clock of a free duration,
a limit of the true rate is no bound but a linear row: |x'| <= s limit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from trajopt.problem.problem import Problem
from trajopt.terms.interfaces import PointConstraint
from trajopt.transcription.collocation import Collocation
from trajopt.transcription.layout import Layout
from trajopt.transcription.timeline import NodeForm, StageKind


@dataclass(frozen=True)
class ClockedLimit:
    """Linear rows at one node: ``coefficients`` (n, size) over its scaled unknowns, scaled bounds (n,)."""

    name: str
    coefficients: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    n_unknowns: int

    def map(self, offset: int) -> sparse.coo_matrix:
        """Coefficients over all unknowns of the NLP."""
        local = sparse.coo_matrix(self.coefficients)
        shape = (len(self.lower), self.n_unknowns)
        return sparse.coo_matrix((local.data, (local.row, local.col + offset)), shape=shape)


def variable_bounds(
    problem: Problem, layout: Layout, collocation: Collocation
) -> tuple[np.ndarray, np.ndarray]:
    """Scaled bounds (n_unknowns,) of nodes from constraints that have them, of clocks, of the start."""
    lower = np.full(layout.n_unknowns, -np.inf)
    upper = np.full(layout.n_unknowns, np.inf)
    for _, at, bounds in _stated_limits(problem, layout):
        form, node = layout.forms[at.node], layout.node(at.node)
        scale = collocation.node_scale(form)
        low = _node_values(form, at, bounds[0], bounds[2], -np.inf)
        high = _node_values(form, at, bounds[1], bounds[3], np.inf)
        lower[node] = np.maximum(lower[node], low / scale)
        upper[node] = np.minimum(upper[node], high / scale)
    _fix_start(problem, layout, collocation, lower, upper)
    return lower, upper


def _node_values(
    form: NodeForm, at: _Bounded, positions: np.ndarray, rates: np.ndarray, free: float
) -> np.ndarray:
    """A node of bounds on local positions and rates (nv,), ``free`` elsewhere; clocked rates have none."""
    values = np.full(form.size, free)
    if at.positions:
        values[form.additive] = positions[form.coordinates.additive_index]
    if at.rates and form.order == 2 and form.clock is None:
        values[form.rates] = rates
    return values


def _fix_start(
    problem: Problem, layout: Layout, collocation: Collocation, lower: np.ndarray, upper: np.ndarray
) -> None:
    """The start is fixed, but for moving rates in a free clock; clocks are within their bounds."""
    form = layout.forms[0]
    own_lower, own_upper = lower[layout.node(0)], upper[layout.node(0)]
    for phase, clock in zip(layout.schedule.phases, layout.schedule.clocks, strict=True):
        if clock is not None and phase.duration_bounds is not None:
            own_lower[form.clocks[clock]] = phase.duration_bounds[0] / phase.duration
            own_upper[form.clocks[clock]] = phase.duration_bounds[1] / phase.duration
    if problem.periodicity is not None:
        _fix_place(problem, form, collocation.node_scale(form), own_lower, own_upper)
        return
    q, v = start_of(problem, layout)
    start = form.node(form.coordinates.node_from_pinocchio(q, v), np.ones(form.n_clocks))
    start = start / collocation.node_scale(form)
    fixed = np.setdiff1d(np.arange(form.size), form.clocks)
    own_lower[fixed], own_upper[fixed] = start[fixed], start[fixed]
    if form.clock is not None and form.order == 2:
        moving = form.rates[start[form.rates] != 0.0]
        own_lower[moving], own_upper[moving] = -np.inf, np.inf


def _fix_place(
    problem: Problem, form: NodeForm, scale: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> None:
    """A periodic motion may be anywhere unless something says where: its base starts over its place."""
    place = form.coordinates.node_from_pinocchio(problem.initial_q, problem.initial_v)
    for row in problem.free_directions:
        entry = form.additive[row]
        lower[entry] = upper[entry] = place[len(form.rotations) + row] / scale[entry]


def start_of(problem: Problem, layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    """Configuration and velocity at the start in the coordinates of the first phase."""
    mode = layout.modes.get(layout.schedule.phases[0].name)
    if mode is None:
        return problem.initial_q, problem.initial_v
    q, v, *_ = mode.dropped(problem.initial_q, problem.initial_v)
    return q, v


def clocked_limits(
    problem: Problem, layout: Layout, collocation: Collocation
) -> dict[int, list[ClockedLimit]]:
    """Rows of rates that are measured in a free clock: their limits at nodes, and a start that moves."""
    found: dict[int, list[ClockedLimit]] = {}
    for term, at, bounds in _stated_limits(problem, layout):
        form = layout.forms[at.node]
        if at.rates and form.clock is not None and form.order == 2:
            limit = _clocked(term.name, form, bounds[2:], collocation, layout.n_unknowns)
            if len(limit.lower):
                found.setdefault(at.node, []).append(limit)
    form = layout.forms[0]
    if form.clock is not None and form.order == 2:
        state = form.coordinates.node_from_pinocchio(*start_of(problem, layout))
        rates = form.node(state, np.ones(form.n_clocks))[form.rates]
        moving = np.flatnonzero(rates)
        if len(moving):
            scale = collocation.node_scale(form)
            row = np.zeros((len(moving), form.size))
            row[np.arange(len(moving)), form.rates[moving]] = 1.0
            row[:, form.clocks[form.clock]] = -rates[moving] / scale[form.rates[moving]]
            zero = np.zeros(len(moving))
            found.setdefault(0, []).append(ClockedLimit("start", row, zero, zero, layout.n_unknowns))
    return found


def _clocked(
    name: str,
    form: NodeForm,
    limits: Sequence[np.ndarray],
    collocation: Collocation,
    n_unknowns: int,
) -> ClockedLimit:
    """x' - s lower >= 0 and x' - s upper <= 0, over the rates' units, where both limits (nv,) are finite."""
    rows, lower, upper = [], [], []
    scale = collocation.node_scale(form)[form.rates]
    for limit, (low, high) in zip(limits, ((0.0, np.inf), (-np.inf, 0.0)), strict=True):
        for index in np.flatnonzero(np.isfinite(limit)):
            row = np.zeros(form.size)
            row[form.rates[index]] = 1.0
            row[form.clocks[form.clock]] = -limit[index] / scale[index]
            rows.append(row)
            lower.append(low)
            upper.append(high)
    coefficients = np.array(rows).reshape(len(rows), form.size)
    return ClockedLimit(name, coefficients, np.array(lower), np.array(upper), n_unknowns)


@dataclass(frozen=True)
class _Bounded:
    """A node at which a limit of positions, of rates, or of both is stated."""

    node: int
    positions: bool
    rates: bool


def _bounded_nodes(term: PointConstraint, layout: Layout) -> list[_Bounded]:
    """Nodes after the start at which a term's limits are stated, once for every state of the motion.

    Where intervals meet, with changes of coordinates between them or not, there is one state: the last of
    its nodes has the limit, of either phase. An impact has two: rates before it have the limits of the phase
    before, rates after it those of the phase after, and the configuration is the same.
    """
    found = []
    for k in range(1, layout.n_stages + 1):
        meeting = layout.meeting(k)
        if meeting.before is None:  # the free start of a closed motion: its image at the end has the limits
            continue
        before, after = (_acts(term, layout, stage) for stage in (meeting.before, meeting.after))
        stated_before = before and _has_point(layout, meeting.before, 1.0)
        stated_after = after and _has_point(layout, meeting.after, 0.0)
        if meeting.impact_ahead:
            if layout.stages[k].kind is StageKind.IMPACT and before and not stated_before:
                found.append(_Bounded(k, positions=True, rates=True))
        elif k < layout.n_stages and layout.stages[k].kind is StageKind.CHANGE:
            continue
        elif meeting.impact_behind:
            if after and not stated_after:
                found.append(_Bounded(k, positions=not before, rates=True))
        elif (before or after) and not (stated_before or stated_after):
            found.append(_Bounded(k, positions=True, rates=True))
    return found


def _stated_limits(
    problem: Problem, layout: Layout
) -> Iterator[tuple[PointConstraint, _Bounded, tuple[np.ndarray, ...]]]:
    """Every term with limits at nodes, the node, and its bounds there, which each robot has once."""
    robots = {id(form.robot): form.robot for form in layout.forms}
    for term in problem.point_constraints:
        bounds = {key: term.node_bounds(robot) for key, robot in robots.items()}
        if all(found is None for found in bounds.values()):
            continue
        for at in _bounded_nodes(term, layout):
            found = bounds[id(layout.forms[at.node].robot)]
            if found is not None:
                yield term, at, found


def _has_point(layout: Layout, stage: int | None, fraction: float) -> bool:
    """Whether an interval has a collocation point at that fraction of it."""
    return stage is not None and fraction in layout.scheme_of(layout.stages[stage].phase).c


def _acts(term: PointConstraint, layout: Layout, stage: int | None) -> bool:
    return stage is not None and term.acts_in(layout.schedule.phases[layout.stages[stage].phase].name)
