"""Figures of the check for contacts: friction, pressure, soles, positions and motion on their surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajopt.certify.contact.friction import sole_margins
from trajopt.certify.sliding import sliding_error
from trajopt.motion.quantities import MotionQuantities
from trajopt.motion.traces import Trace, Traces


def force_traces(motion: MotionQuantities) -> Traces:
    """Return the margins of contact forces over the weight; bilateral contacts have none."""
    plan, surfaces = motion.solution, motion.surfaces
    force, frames = plan.f[..., :3] / motion.weight, plan.contact_frames
    normal = surfaces.along_normal(force)
    tangential = np.linalg.norm(force - normal[..., None] * surfaces.normal, axis=-1)
    pressed = plan.active & ~surfaces.bilateral
    return {
        "friction_margin": Trace.of(surfaces.friction * normal - tangential, pressed, frames, margin=True),
        "unilateral_margin": Trace.of(normal, pressed, frames, margin=True),
        "sole_margin": _sole_margin(motion),
        "sliding_friction": sliding_error(motion),
    }


def inactive_force(motion: MotionQuantities) -> Trace:
    """Return the largest wrench component, over the weight (times 1 m), that a contact cannot transmit.

    For an inactive contact this is the whole wrench, for a rolling ball the moment about its contact point.
    """
    plan, wrench, rolling = motion.solution, motion.solution.f.copy(), motion.solution.description.rolling
    held = plan.active & rolling
    wrench[held, 3:] -= np.cross(wrench[held, :3], motion.surfaces.lever[held])
    wrench[held, :3] = 0.0
    size = np.abs(wrench).max(axis=-1, initial=0.0) / motion.weight
    return Trace.of(size, ~plan.active | rolling, plan.contact_frames)


def _sole_margin(motion: MotionQuantities) -> Trace:
    """Return the least distance from the limits of pressure and yaw moment of a sole, weight times metre.

    The limit of the yaw moment is that of friction with the whole coefficient along each of the sole's axes:
    beyond it no distribution of forces in Coulomb's cones exists.
    """
    plan, surfaces = motion.solution, motion.surfaces
    sizes = [contact.half_size for contact in plan.description.contacts]
    margin, counts = np.zeros(plan.active.shape), np.zeros(plan.active.shape, dtype=bool)
    for index in np.flatnonzero(plan.description.soles):
        rows = plan.active[:, index] & ~surfaces.bilateral[:, index]
        size = sizes[index]
        if size is None or not rows.any():
            continue
        to_sole = np.swapaxes(motion.places.rotation[rows, index], -1, -2)
        force, moment = (
            np.einsum("kij,kj->ik", to_sole, part) / motion.weight
            for part in (plan.f[rows, index, :3], plan.f[rows, index, 3:])
        )
        counts[rows, index] = True
        margin[rows, index] = sole_margins(force, moment, size, surfaces.friction[rows, index])
    return Trace.of(margin, counts, plan.contact_frames, margin=True)


@dataclass(frozen=True, kw_only=True)
class ContactStarts:
    """Poses at which contacts begin.

    ``phase`` and ``stance`` (n_phases, nc, 3) m are positions at the start of each phase and at the touchdown
    before it, ``rotation`` (n_phases, nc, 3, 3) is at the start, and ``rows`` (n_phases,) are its samples.
    """

    phase: np.ndarray
    stance: np.ndarray
    rotation: np.ndarray
    rows: np.ndarray

    @classmethod
    def of(cls, motion: MotionQuantities) -> ContactStarts:
        """Return the starts in a motion at the samples of its file."""
        active = motion.solution.active
        rows = np.array([phase.start for phase in motion.solution.phases])
        held = motion.held_position[rows]
        stance = held.copy()
        for later in range(1, len(rows)):
            goes_on = active[rows[later]] & active[rows[later - 1]]
            stance[later, goes_on] = stance[later - 1, goes_on]
        return cls(phase=held, stance=stance, rotation=motion.places.rotation[rows], rows=rows)


def place_traces(motion: MotionQuantities, starts: ContactStarts) -> Traces:
    """Return the figures of contact positions and of their motion since the contact began.

    ``stance_drift`` is from touchdown to lift-off, across phases. For sliding contacts only motion along the
    normal counts.
    """
    plan, surfaces, rotation = motion.solution, motion.surfaces, motion.places.rotation
    frames, active, phase, held = plan.contact_frames, plan.active, plan.phase, motion.held_position
    soles = active & plan.description.soles
    return {
        "contact_velocity": Trace.of(np.linalg.norm(motion.held_velocity, axis=-1), active, frames),
        "penetration": Trace.of(np.maximum(-motion.surface_distance, 0.0), surfaces.known, frames),
        "foot_drift": Trace.of(np.linalg.norm(held - starts.phase[phase], axis=-1), active, frames),
        "stance_drift": Trace.of(np.linalg.norm(held - starts.stance[phase], axis=-1), active, frames),
        "foot_turn": Trace.of(_angle(rotation - starts.rotation[phase], np.sqrt(8)), soles, frames),
        "sole_tilt": Trace.of(
            _angle(rotation[..., 2] - surfaces.normal, 2.0), soles & surfaces.known, frames
        ),
        "patch_margin": _patch_margin(motion),
    }


def landing_height(motion: MotionQuantities, starts: ContactStarts) -> Trace:
    """Return the unsigned distance (K, nc) of active contacts from their surface at their phase's start."""
    plan, begins = motion.solution, np.zeros((motion.solution.n_samples, 1), dtype=bool)
    begins[starts.rows] = True
    counts = begins & plan.active & motion.surfaces.known
    return Trace.of(np.abs(motion.surface_distance), counts, plan.contact_frames)


def _patch_margin(motion: MotionQuantities) -> Trace:
    """Return the least distance (m) of active contacts (soles: corners) inside the edges of their patches."""
    plan, places = motion.solution, motion.places
    frames, sizes = list(plan.contact_frames), [contact.half_size for contact in plan.description.contacts]
    margin, counts = np.zeros(plan.active.shape), np.zeros(plan.active.shape, dtype=bool)
    for phase, patches in enumerate(plan.description.patches):
        for frame, patch in patches.items():
            index = frames.index(frame)
            rows = plan.active[:, index] & (plan.phase == phase)
            if not rows.any():
                continue
            position = places.position[rows, index][:, None]
            if (size := sizes[index]) is not None:
                corners = np.array([[x, y, 0] for x in (-1, 1) for y in (-1, 1)]) * [*size, 0.0]
                position = position + np.einsum("kij,cj->kci", places.rotation[rows, index], corners)
            inside = patch.inside(position).reshape(len(position), -1)
            counts[rows, index], margin[rows, index] = True, inside.min(axis=1)
    return Trace.of(margin, counts, plan.contact_frames, margin=True)


def _angle(apart: np.ndarray, scale: float) -> np.ndarray:
    """Return angles (K, nc), rad, from differences of rotations or unit vectors; exact for small angles."""
    chord = np.sqrt(np.sum(apart**2, axis=tuple(range(2, apart.ndim)))) / scale
    return np.asarray(2 * np.arcsin(np.minimum(chord, 1.0)))
