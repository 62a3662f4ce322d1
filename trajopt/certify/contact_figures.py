"""Figures of a check about contacts: friction, pressure, soles, positions and motion on their surfaces."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from trajopt.certify.samples import SampleQuantities, largest, least
from trajopt.certify.sliding import held_part, sliding_error
from trajopt.dynamics.model_quantities import gravity_of, mass_of
from trajopt.robot.sole import pressure_rows, yaw_rows
from trajopt.solution.descriptions import patches_of
from trajopt.solution.solution import Solution
from trajopt.solution.touched import TouchedSurfaces

_Figures = dict[str, float | None]


def force_figures(plan: Solution, samples: SampleQuantities, surfaces: TouchedSurfaces) -> _Figures:
    """Margins of contact forces over the weight; none on bilateral surfaces."""
    weight = mass_of(plan.model) * gravity_of(plan.model)
    points = plan.collocation[:, None]
    force = plan.f[..., :3] / weight
    normal = surfaces.along_normal(force)
    tangential = np.linalg.norm(force - normal[..., None] * surfaces.normal, axis=-1)
    margin = surfaces.friction * normal - tangential
    pressed = plan.active & ~surfaces.bilateral
    return {
        "friction_margin": least(margin[pressed & points]),
        "friction_margin_between": least(margin[pressed & ~points]),
        "unilateral_margin": least(normal[pressed & points]),
        "sole_margin": _sole_margin(plan, samples, surfaces, weight),
        "sliding_friction": sliding_error(plan, samples, surfaces),
        "inactive_force": largest(np.abs(plan.f[~plan.active]) / weight),
    }


def _sole_margin(
    plan: Solution, samples: SampleQuantities, surfaces: TouchedSurfaces, weight: float
) -> float | None:
    """Least distance from the limits of pressure and yaw moment in the sole's axes, weight times metre.

    Half sizes [half_length, half_width] come from the optional key ``contact_sizes`` of meta (null for a
    point). The yaw moment is held against what friction with the whole coefficient along the sole's
    axes leaves of it: beyond that no distribution of forces in Coulomb's cones exists.
    """
    sizes = plan.meta.get("contact_sizes")
    if not isinstance(sizes, list) or len(sizes) != plan.f.shape[1]:
        return None
    found = []
    for index in np.flatnonzero(is_sole(plan)):
        rows = plan.active[:, index] & ~surfaces.bilateral[:, index] & plan.collocation
        if sizes[index] is None or not rows.any():
            continue
        size = (float(sizes[index][0]), float(sizes[index][1]))
        to_sole = np.swapaxes(samples.rotation[rows, index], -1, -2)
        force, moment = (
            np.einsum("kij,kj->ik", to_sole, part) / weight
            for part in (plan.f[rows, index, :3], plan.f[rows, index, 3:])
        )
        margins = pressure_rows(force, moment, size)
        margins += yaw_rows(force, moment, size, surfaces.friction[rows, index])
        found.append(float(np.min(margins)))
    return min(found) if found else None


def place_figures(plan: Solution, samples: SampleQuantities, surfaces: TouchedSurfaces) -> _Figures:
    """Where contacts are, and whether they stay: over all samples, and from the start of each phase.

    ``stance_drift`` is from a touchdown to the lift-off, whatever phases that spans. Of sliding contacts,
    only motion along the normal counts.
    """
    drift, turn, landing = [], [], []
    distance, moved = surfaces.distance(samples.position), held_part(samples.position, surfaces)
    for phase in plan.phases:
        for index in np.flatnonzero(plan.active[phase.start]):
            rows = slice(phase.start, phase.stop)
            drift.append(_way(moved[rows, index]))
            if surfaces.known[phase.start, index]:
                landing.append(abs(distance[phase.start, index]))
            if is_sole(plan)[index]:
                turn.append(_turn(samples.rotation[rows, index]))
    stances = [_way(moved[first:stop, index]) for index, first, stop in _stances(plan)]
    speed = np.linalg.norm(held_part(samples.velocity[..., :3], surfaces)[plan.active], axis=1)
    return {
        "contact_velocity": largest(speed),
        "penetration": largest(np.maximum(-distance[surfaces.known], 0.0)),
        "landing_height": largest(np.array(landing)),
        "foot_drift": largest(np.array(drift)),
        "stance_drift": largest(np.array(stances)),
        "foot_turn": largest(np.array(turn)),
        "sole_tilt": _sole_tilt(plan, samples, surfaces),
        "patch_margin": _patch_margin(plan, samples),
    }


def _way(places: np.ndarray) -> float:
    """Largest distance (m) of positions (n, 3) from the first."""
    return float(np.linalg.norm(places - places[0], axis=1).max())


def _stances(plan: Solution) -> Iterator[tuple[int, int, int]]:
    """Contact, first sample and the one behind the last, of every stretch of phases with it active."""
    for index in range(plan.active.shape[1]):
        first: int | None = None
        for phase in plan.phases:
            if plan.active[phase.start, index]:
                first = phase.start if first is None else first
            elif first is not None:
                yield index, first, phase.start
                first = None
        if first is not None:
            yield index, first, plan.n_samples


def _patch_margin(plan: Solution, samples: SampleQuantities) -> float | None:
    """Least distance (m) of active contacts (of a sole: its corners) inside the edges of their patches."""
    frames, sizes, found = list(plan.contact_frames), plan.meta.get("contact_sizes") or [], []
    for phase, patches in enumerate(patches_of(plan.meta.get("patches"))):
        for frame, patch in patches.items():
            index = frames.index(frame)
            rows = plan.active[:, index] & (plan.phase == phase)
            places = samples.position[rows, index][:, None]
            if is_sole(plan)[index] and index < len(sizes) and sizes[index]:
                corners = np.array([[x, y, 0] for x in (-1, 1) for y in (-1, 1)]) * [*sizes[index], 0.0]
                places = places + np.einsum("kij,cj->kci", samples.rotation[rows, index], corners)
            found.append(patch.inside(places).ravel())
    return least(np.concatenate([np.zeros(0), *found]))


def is_sole(plan: Solution) -> np.ndarray:
    """Which contacts are soles (nc,)."""
    return np.array([kind == "surface" for kind in plan.meta["contact_kinds"]], dtype=bool)


def _sole_tilt(plan: Solution, samples: SampleQuantities, surfaces: TouchedSurfaces) -> float | None:
    """Largest angle (rad) between an active sole's z axis and its surface's normal, exact for small ones."""
    flat = plan.active & is_sole(plan) & surfaces.known
    chord = np.linalg.norm(samples.rotation[flat][..., 2] - surfaces.normal[flat], axis=-1)
    return largest(2 * np.arcsin(np.minimum(chord / 2, 1.0)))


def _turn(rotation: np.ndarray) -> float:
    """Largest angle (rad) between rotations (n, 3, 3) and the first, exact for small angles."""
    chord = np.linalg.norm(rotation - rotation[0], axis=(1, 2)).max() / np.sqrt(8)
    return float(2 * np.arcsin(min(chord, 1.0)))
