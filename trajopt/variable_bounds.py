"""Bounds of the unknowns: limits that hold at nodes, and the fixed start."""

from __future__ import annotations

import numpy as np

from trajopt.layout import Layout
from trajopt.problem import Problem


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
        for k in range(1, layout.n_intervals + 1):
            lower[layout.node(k)] = np.maximum(lower[layout.node(k)], low)
            upper[layout.node(k)] = np.minimum(upper[layout.node(k)], high)
    start = coordinates.node_from_pinocchio(problem.initial_q, problem.initial_v) / node_scale
    lower[layout.node(0)] = upper[layout.node(0)] = start
    return lower, upper
