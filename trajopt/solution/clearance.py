"""Distances of a robot from obstacles and from itself, by Coal, at the samples of a solution and between."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import pinocchio as pin

from trajopt.robot.collision.near import CollisionScene
from trajopt.solution.descriptions import bodies_of, body_scene_of, scene_of_meta
from trajopt.solution.solution import Solution

# Number of configurations tested between two samples.
FINER = 4
# Links are looked for within these distances, m, one after the other: most motions come within the first.
RANGES = (0.05, 0.2, 1.0, np.inf)


def clearance_figures(plan: Solution) -> dict[str, float | None]:
    """Depth of the links in the ground, and their least distances, at the samples and between."""
    return distance_figures(plan, refined_configurations(plan), RANGES)


def distance_figures(
    plan: Solution, configurations: Iterable[np.ndarray], ranges: Sequence[float] = (0.0,)
) -> dict[str, float | None]:
    """``link_depth``, ``obstacle_distance`` and ``self_distance``, m, over configurations (nq,).

    Of the shapes in ``meta["bodies"]``, and of the capsules in ``meta["collision"]``, which are wider, or are
    all that an older file has. None where there is no such pair. ``ranges``: rising; figures up to the last
    of them are exact, beyond it they are lower bounds.
    """
    q = np.array(list(configurations), dtype=float)
    body = body_scene_of(plan.model, plan.meta)
    found: dict[str, list[float]] = {name: [] for name in ("ground", "obstacle", "self")}
    for scene in (body, scene_of_meta(plan.model, plan.meta.get("collision"))):
        if scene is not None and scene.pairs:
            for name, least in _least(scene, q, ranges).items():
                found[name].append(least)
    nearest = {name: min(values, default=None) for name, values in found.items()}
    return {
        "link_depth": None if nearest["ground"] is None else -nearest["ground"],
        "obstacle_distance": nearest["obstacle"],
        "self_distance": nearest["self"],
    }


def missing_shapes(plan: Solution) -> tuple[str, ...]:
    """What is not known of a motion because shapes of links are not in its file."""
    bodies = bodies_of(plan.meta.get("bodies"))
    if bodies is None or not bodies.shapes:
        return ("no shapes of links are in the file: their depth in the ground and distances are not known",)
    if bodies.missing:
        return (f"without shapes of links that could not be read: {'; '.join(bodies.missing)}",)
    return ()


def _least(scene: CollisionScene, q: np.ndarray, ranges: Sequence[float]) -> dict[str, float]:
    """Least distance of each kind of pair that there is."""
    parts = {
        "ground": slice(0, scene.n_ground),
        "obstacle": slice(scene.n_ground, scene.n_outer),
        "self": slice(scene.n_outer, len(scene.pairs)),
    }
    for within in ranges:
        distances = scene.distances(q, within)
        least = {
            name: float(distances[:, part].min()) for name, part in parts.items() if distances[:, part].size
        }
        if all(value <= within for value in least.values()):
            break
    return least


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
