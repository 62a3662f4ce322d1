"""Distances of a robot from obstacles and from itself, by Coal, at the samples of a solution and between."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import pinocchio as pin

from trajopt.solution.descriptions import scene_of_meta
from trajopt.solution.solution import Solution

# Number of configurations tested between two samples.
FINER = 4


def clearance_figures(plan: Solution) -> dict[str, float | None]:
    """Least distances of a motion from obstacles and of its links, at the samples and between."""
    if plan.meta.get("collision") is None:
        return distance_figures(plan, ())
    return distance_figures(plan, refined_configurations(plan))


def distance_figures(plan: Solution, configurations: Iterable[np.ndarray]) -> dict[str, float | None]:
    """Least signed distances, m, of the capsules in ``meta["collision"]`` from obstacles and between them."""
    scene = scene_of_meta(plan.model, plan.meta.get("collision"))
    least = np.zeros(0) if scene is None else scene.least_distances(configurations)
    outer = 0 if scene is None else scene.n_outer
    parts = {"obstacle_distance": least[:outer], "self_distance": least[outer:]}
    return {name: float(part.min()) if part.size else None for name, part in parts.items()}


def refined_configurations(
    solution: Solution, rows: Sequence[int] | None = None, between: int = FINER
) -> list[np.ndarray]:
    """Configurations (nq,) at consecutive samples and ``between`` times in each gap: cubics through q and v.

    Exact where the motion is a cubic in time between samples, as collocation with two points makes it.
    """
    rows = range(solution.n_samples) if rows is None else rows
    found = [solution.q[rows[0]]]
    for row in rows[:-1]:
        found += _bridge(solution, row, between)
    return found


def _bridge(solution: Solution, row: int, between: int) -> list[np.ndarray]:
    """Configurations after sample ``row`` up to the next one."""
    span, model = solution.t[row + 1] - solution.t[row], solution.model
    q, following = solution.q[row], solution.q[row + 1]
    if not span > 0:
        return [following]
    way = pin.difference(model, q, following)
    to_way = np.linalg.inv(pin.dIntegrate(model, q, way, pin.ArgumentPosition.ARG1))
    first, last = span * solution.v[row], span * to_way @ solution.v[row + 1]
    found = []
    for s in np.arange(1, between + 1) / (between + 1):
        step = s * (1 - s) ** 2 * first + s * s * (3 - 2 * s) * way + s * s * (s - 1) * last
        found.append(pin.integrate(model, q, step))
    return [*found, following]
