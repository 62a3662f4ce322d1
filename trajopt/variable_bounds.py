"""Bounds of the unknowns: limits that hold at nodes, free durations, and the fixed start.

A scheme with a point at an interval's start or end states a limit there as a row already: the node
gets no bound then, which would repeat the row. Where rates are measured in the clock of a free duration,
a limit of the true rate is no bound but a linear row: |x'| <= s limit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from trajopt.collocation import Collocation
from trajopt.layout import Layout
from trajopt.problem import Problem
from trajopt.term_interfaces import PointConstraint
from trajopt.timeline import NodeForm, StageKind


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
    for term in problem.point_constraints:
        for k in _bounded_nodes(term, layout):
            form = layout.forms[k]
            bounds = term.node_bounds(form.robot)
            if bounds is None:
                continue
            low = _node_values(form, bounds[0], bounds[2], -np.inf)
            high = _node_values(form, bounds[1], bounds[3], np.inf)
            scale = collocation.node_scale(form)
            lower[layout.node(k)] = np.maximum(lower[layout.node(k)], low / scale)
            upper[layout.node(k)] = np.minimum(upper[layout.node(k)], high / scale)
    _fix_start(problem, layout, collocation, lower, upper)
    return lower, upper


def _node_values(form: NodeForm, positions: np.ndarray, rates: np.ndarray, free: float) -> np.ndarray:
    """A node of bounds on local positions and rates (nv,), ``free`` elsewhere; clocked rates have none."""
    values = np.full(form.size, free)
    values[form.additive] = positions[form.coordinates.additive_index]
    if form.order == 2 and form.clock is None:
        values[form.rates] = rates
    return values


def _fix_start(
    problem: Problem, layout: Layout, collocation: Collocation, lower: np.ndarray, upper: np.ndarray
) -> None:
    """The start is fixed, but for moving rates in a free clock; clocks are within their bounds."""
    form = layout.forms[0]
    q, v = start_of(problem, layout)
    start = form.node(form.coordinates.node_from_pinocchio(q, v), np.ones(form.n_clocks))
    start = start / collocation.node_scale(form)
    own_lower, own_upper = lower[layout.node(0)], upper[layout.node(0)]
    own_lower[:], own_upper[:] = start, start
    if form.clock is not None and form.order == 2:
        moving = form.rates[start[form.rates] != 0.0]
        own_lower[moving], own_upper[moving] = -np.inf, np.inf
    for phase, clock in zip(layout.schedule.phases, layout.schedule.clocks, strict=True):
        if clock is not None and phase.duration_bounds is not None:
            own_lower[form.clocks[clock]] = phase.duration_bounds[0] / phase.duration
            own_upper[form.clocks[clock]] = phase.duration_bounds[1] / phase.duration


def start_of(problem: Problem, layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    """Configuration and velocity at the start in the coordinates of the first phase."""
    mode = layout.modes.get(layout.schedule.phases[0].name)
    if mode is None:
        return problem.initial_q, problem.initial_v
    q, v, _ = mode.dropped(problem.initial_q, problem.initial_v, np.zeros(problem.robot.nv))
    return q, v


def clocked_limits(
    problem: Problem, layout: Layout, collocation: Collocation
) -> dict[int, list[ClockedLimit]]:
    """Rows of rates that are measured in a free clock: their limits at nodes, and a start that moves."""
    found: dict[int, list[ClockedLimit]] = {}
    for term in problem.point_constraints:
        for k in _bounded_nodes(term, layout):
            form, bounds = layout.forms[k], term.node_bounds(layout.forms[k].robot)
            if form.clock is not None and form.order == 2 and bounds is not None:
                limit = _clocked(term.name, form, bounds[3], collocation, layout.n_unknowns)
                if len(limit.lower):
                    found.setdefault(k, []).append(limit)
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
    name: str, form: NodeForm, limit: np.ndarray, collocation: Collocation, n_unknowns: int
) -> ClockedLimit:
    """x' - s limit <= 0 and x' + s limit >= 0, over the rates' units."""
    bound = np.flatnonzero(np.isfinite(limit))
    scale = collocation.node_scale(form)[form.rates[bound]]
    n = len(bound)
    rows = np.zeros((2 * n, form.size))
    every = np.arange(n)
    rows[every, form.rates[bound]] = rows[n + every, form.rates[bound]] = 1.0
    rows[:n, form.clocks[form.clock]] = -limit[bound] / scale
    rows[n:, form.clocks[form.clock]] = limit[bound] / scale
    lower = np.concatenate([np.full(n, -np.inf), np.zeros(n)])
    upper = np.concatenate([np.zeros(n), np.full(n, np.inf)])
    return ClockedLimit(name, rows, lower, upper, n_unknowns)


def _bounded_nodes(term: PointConstraint, layout: Layout) -> list[int]:
    """Nodes after the start that the term's phases touch and that no point of theirs coincides with.

    A node that a change of coordinates leads out of repeats the next one.
    """
    acting = [term.acts_in(layout.schedule.phases[stage.phase].name) for stage in layout.stages]
    is_interval = [stage.kind is StageKind.INTERVAL for stage in layout.stages]
    at_start, at_end = 0.0 in layout.scheme.c, 1.0 in layout.scheme.c
    nodes = []
    for k in range(1, layout.n_stages + 1):
        if k < layout.n_stages and layout.stages[k].kind is StageKind.CHANGE:
            continue
        before, after = acting[k - 1], k < layout.n_stages and acting[k]
        covered = (at_end and before and is_interval[k - 1]) or (
            at_start and after and k < layout.n_stages and is_interval[k]
        )
        if (before or after) and not covered:
            nodes.append(k)
    return nodes
