"""Bounds of the unknowns: limits that hold at nodes, and the fixed start.

A scheme with a point at an interval's start or end states a limit there as a row already: the node
gets no bound then, which would repeat the row.
"""

from __future__ import annotations

import numpy as np

from trajopt.layout import Layout
from trajopt.problem import Problem
from trajopt.term_interfaces import PointConstraint


def variable_bounds(
    problem: Problem, layout: Layout, node_scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Scaled bounds (n_unknowns,) of nodes from the point constraints that have them, and of the start."""
    lower = np.full(layout.n_unknowns, -np.inf)
    upper = np.full(layout.n_unknowns, np.inf)
    coordinates = layout.coordinates
    additive, free = coordinates.additive_index, np.full(4 * coordinates.n_rotations, np.inf)
    for term in problem.point_constraints:
        bounds = term.node_bounds(problem.robot)
        if bounds is None:
            continue
        low = np.concatenate([-free, bounds[0][additive], bounds[2]]) / node_scale
        high = np.concatenate([free, bounds[1][additive], bounds[3]]) / node_scale
        for k in _bounded_nodes(term, layout):
            lower[layout.node(k)] = np.maximum(lower[layout.node(k)], low)
            upper[layout.node(k)] = np.minimum(upper[layout.node(k)], high)
    start = coordinates.node_from_pinocchio(problem.initial_q, problem.initial_v) / node_scale
    lower[layout.node(0)] = upper[layout.node(0)] = start
    return lower, upper


def _bounded_nodes(term: PointConstraint, layout: Layout) -> list[int]:
    """Nodes after the start that the term's phases touch and that no point of theirs coincides with."""
    acting = [term.acts_in(layout.schedule.phases[phase].name) for phase in layout.phase_of]
    at_start, at_end = 0.0 in layout.scheme.c, 1.0 in layout.scheme.c
    nodes = []
    for k in range(1, layout.n_intervals + 1):
        before, after = acting[k - 1], k < layout.n_intervals and acting[k]
        covered = (at_end and before) or (at_start and after)
        if (before or after) and not covered:
            nodes.append(k)
    return nodes
