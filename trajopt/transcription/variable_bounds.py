"""Bounds on the variables: limits that hold at nodes, free durations, and the fixed start.

A scheme with a point at an interval's start or end already imposes limits there as rows, so the node gets no
bound that would repeat them. Where rates are measured in the time scale s of a free duration, a limit on the
true rate is not a bound but a linear row: |x'| <= s limit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from trajopt.problem.problem import Problem
from trajopt.terms.interfaces import PointConstraint
from trajopt.transcription.collocation import Collocation
from trajopt.transcription.layout import Layout
from trajopt.transcription.row_collection import LinearRows, over_unknowns
from trajopt.transcription.timeline import NodeLayout, StageKind


def variable_bounds(
    problem: Problem, layout: Layout, collocation: Collocation
) -> tuple[np.ndarray, np.ndarray]:
    """Scaled bounds (n_unknowns,): limits of constraints at nodes, time scales, and the fixed start."""
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
    form: NodeLayout, at: _Bounded, positions: np.ndarray, rates: np.ndarray, free: float
) -> np.ndarray:
    """One side of a node's bounds (size,), from those on positions and true rates (nv,), else ``free``."""
    values = np.full(form.size, free)
    if at.positions:
        values[form.additive] = positions[form.coordinates.additive_index]
    if at.rates and form.order >= 2 and form.time_scale is None:
        values[form.rates] = rates
    return values


def _fix_start(
    problem: Problem, layout: Layout, collocation: Collocation, lower: np.ndarray, upper: np.ndarray
) -> None:
    """Fix the start, except nonzero rates in a free time scale, and bound the time scales.

    A periodic start is free, except along `Problem.free_directions`, where the motion could be shifted.
    """
    form = layout.forms[0]
    own_lower, own_upper = lower[layout.node(0)], upper[layout.node(0)]
    for phase, time_scale in zip(layout.schedule.phases, layout.schedule.time_scales, strict=True):
        if time_scale is not None and phase.duration_bounds is not None:
            own_lower[form.time_scales[time_scale]] = phase.duration_bounds[0] / phase.duration
            own_upper[form.time_scales[time_scale]] = phase.duration_bounds[1] / phase.duration
    if problem.periodicity is not None:
        place = form.coordinates.node_from_pinocchio(problem.initial_q, problem.initial_v)
        for row in problem.free_directions:
            entry = form.additive[row]
            fixed_at = place[len(form.rotations) + row] / collocation.node_scale(form)[entry]
            own_lower[entry] = own_upper[entry] = fixed_at
        return
    q, v, _ = initial_state(problem, layout)
    start = form.node(form.coordinates.node_from_pinocchio(q, v), np.ones(form.n_time_scales))
    start = start / collocation.node_scale(form)
    fixed = np.setdiff1d(np.arange(form.size), form.time_scales)
    own_lower[fixed], own_upper[fixed] = start[fixed], start[fixed]
    if form.time_scale is not None and form.order >= 2:
        moving = form.rates[start[form.rates] != 0.0]
        own_lower[moving], own_upper[moving] = -np.inf, np.inf


def initial_state(problem: Problem, layout: Layout) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Configuration, velocity and zero acceleration at the start in the coordinates of the first phase."""
    still = np.zeros(problem.robot.nv)
    return layout.in_coordinates_of(layout.form_of(0), problem.initial_q, problem.initial_v, still)


def scaled_rate_limits(problem: Problem, layout: Layout, collocation: Collocation) -> Iterator[LinearRows]:
    """Linear rows on rates in a free time scale: their limits at nodes, and nonzero rates at the start."""
    for term, at, bounds in _stated_limits(problem, layout):
        form = layout.forms[at.node]
        if at.rates and form.time_scale is not None and form.order >= 2:
            block, lower, upper = _scaled_rate_limit(form, bounds[2:], collocation)
            if len(lower):
                rows = over_unknowns(layout, [(at.node, block)])
                yield LinearRows(term.name, at.node, rows, lower, upper)
    form = layout.forms[0]
    if form.time_scale is not None and form.order >= 2:
        state = form.coordinates.node_from_pinocchio(*initial_state(problem, layout)[:2])
        rates = form.node(state, np.ones(form.n_time_scales))[form.rates]
        moving = np.flatnonzero(rates)
        if len(moving):
            scale = collocation.node_scale(form)
            row = np.zeros((len(moving), form.size))
            row[np.arange(len(moving)), form.rates[moving]] = 1.0
            row[:, form.time_scales[form.time_scale]] = -rates[moving] / scale[form.rates[moving]]
            zero = np.zeros(len(moving))
            yield LinearRows("start", 0, over_unknowns(layout, [(0, row)]), zero, zero)


def _scaled_rate_limit(
    form: NodeLayout, limits: Sequence[np.ndarray], collocation: Collocation
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Scaled rows (n, size) of x' >= s lower and x' <= s upper for finite limits (nv,), and their bounds."""
    rows, lower, upper = [], [], []
    scale = collocation.node_scale(form)[form.rates]
    for limit, (low, high) in zip(limits, ((0.0, np.inf), (-np.inf, 0.0)), strict=True):
        for index in np.flatnonzero(np.isfinite(limit)):
            row = np.zeros(form.size)
            row[form.rates[index]] = 1.0
            row[form.time_scales[form.time_scale]] = -limit[index] / scale[index]
            rows.append(row)
            lower.append(low)
            upper.append(high)
    return np.array(rows).reshape(len(rows), form.size), np.array(lower), np.array(upper)


@dataclass(frozen=True)
class _Bounded:
    """A node at which a limit on positions, on rates, or on both is imposed."""

    node: int
    positions: bool
    rates: bool


def _bounded_nodes(term: PointConstraint, layout: Layout) -> list[_Bounded]:
    """Nodes after the start at which a term's limits are imposed, once for every state of the motion.

    Where intervals meet, with or without a change of coordinates, there is one state. Its last node has the
    limit if the term acts in either phase. An impact has two states with the same configuration: the rates
    before it have the limits of the phase before, the rates after it those of the phase after.
    """
    nodes = []
    for k in range(1, layout.n_stages + 1):
        adjacent = layout.adjacent_intervals(k)
        if adjacent.before is None:  # the free start of a closed motion: its image at the end has the limits
            continue
        before, after = (_acts(term, layout, stage) for stage in (adjacent.before, adjacent.after))
        stated_before = before and _has_point(layout, adjacent.before, 1.0)
        stated_after = after and _has_point(layout, adjacent.after, 0.0)
        if adjacent.impact_ahead:
            if layout.stages[k].kind is StageKind.IMPACT and before and not stated_before:
                nodes.append(_Bounded(k, positions=True, rates=True))
        elif k < layout.n_stages and layout.stages[k].kind is StageKind.CHANGE:
            continue
        elif adjacent.impact_behind:
            if after and not stated_after:
                nodes.append(_Bounded(k, positions=not before, rates=True))
        elif (before or after) and not (stated_before or stated_after):
            nodes.append(_Bounded(k, positions=True, rates=True))
    return nodes


def _stated_limits(
    problem: Problem, layout: Layout
) -> Iterator[tuple[PointConstraint, _Bounded, tuple[np.ndarray, ...]]]:
    """Every term with limits at nodes, the node, and its bounds there, computed once per robot."""
    robots = {id(form.robot): form.robot for form in layout.forms}
    for term in problem.point_constraints:
        bounds = {key: term.node_bounds(robot) for key, robot in robots.items()}
        if all(limits is None for limits in bounds.values()):
            continue
        for at in _bounded_nodes(term, layout):
            limits = bounds[id(layout.forms[at.node].robot)]
            if limits is not None:
                yield term, at, limits


def _has_point(layout: Layout, stage: int | None, fraction: float) -> bool:
    """Whether an interval has a collocation point at that fraction."""
    return stage is not None and fraction in layout.scheme_of(layout.stages[stage].phase).c


def _acts(term: PointConstraint, layout: Layout, stage: int | None) -> bool:
    return stage is not None and term.acts_in(layout.schedule.phases[layout.stages[stage].phase].name)
