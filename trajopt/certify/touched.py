"""What every contact of a solution touches, sample by sample: from its meta to arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from trajopt.errors import InputError, SolutionFileError
from trajopt.solution import Solution
from trajopt.surface import UP, Surface
from trajopt.terrain import Patch, PiecewiseTerrain, SmoothTerrain

Read = Surface | PiecewiseTerrain | SmoothTerrain


@dataclass(frozen=True, kw_only=True)
class Touched:
    """Planes at K samples of nc contacts: the terrain's under it, or that of the phase where it has its own.

    point, normal (K, nc, 3) m; friction (K, nc); bilateral (K, nc): transmits any wrench; known (K, nc):
    there is one at all (in a hole, or without terrain, normals are up, and heights unknown). slip (K, nc):
    slip speed, m/s, of a surface along which the contact slides, NaN where it is held.
    """

    point: np.ndarray
    normal: np.ndarray
    friction: np.ndarray
    bilateral: np.ndarray
    known: np.ndarray
    slip: np.ndarray

    @property
    def slides(self) -> np.ndarray:
        """Which contacts slide (K, nc)."""
        return np.isfinite(self.slip)

    def along_normal(self, vectors: np.ndarray) -> np.ndarray:
        """Components (K, nc) of vectors (K, nc, 3) along the normals."""
        return np.asarray(np.sum(self.normal * vectors, axis=-1))

    def distance(self, position: np.ndarray) -> np.ndarray:
        """Signed distance (K, nc) in m of positions (K, nc, 3); NaN where there is no plane."""
        return np.where(self.known, self.along_normal(position - self.point), np.nan)


def touched(plan: Solution, position: np.ndarray, phases: np.ndarray | None = None) -> Touched:
    """Read terrain, friction and surfaces of a consistent solution. Raises `SolutionFileError`.

    ``position`` (K, nc, 3) m: of the contacts; ground that is no plane is what lies under them.
    ``phases`` (K,): of the times of these positions where they are not the samples.
    """
    frames, rows = list(plan.contact_frames), plan.phase if phases is None else phases
    point, normal, known = _ground(terrain_of(plan.meta["terrain"]), position)
    friction = np.tile(np.array(plan.meta["friction"], dtype=float), (len(rows), 1))
    bilateral, slip = np.zeros(friction.shape, dtype=bool), np.full(friction.shape, np.nan)
    for phase, surfaces in enumerate(surfaces_of(plan.meta.get("surfaces"))):
        for frame, surface in surfaces.items():
            at = (rows == phase, frames.index(frame))
            point[at], normal[at], friction[at] = surface.point, surface.normal, surface.friction
            bilateral[at], known[at] = surface.bilateral, True
            slip[at] = np.nan if surface.slip_speed is None else surface.slip_speed
    return Touched(point=point, normal=normal, friction=friction, bilateral=bilateral, known=known, slip=slip)


def _ground(terrain: Read | None, position: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Point, normal (K, nc, 3) of the ground under contacts, and where there is any; a hole is none."""
    size = position.shape
    if terrain is None or isinstance(terrain, Surface):
        plane = terrain or Surface(point=np.zeros(3), normal=np.array(UP))
        flat = np.tile(plane.point, (*size[:2], 1)), np.tile(plane.normal, (*size[:2], 1))
        return *flat, np.full(size[:2], terrain is not None)
    x, y = position[..., 0], position[..., 1]
    height = terrain.height(x, y)
    known = np.isfinite(height)
    return np.stack([x, y, np.where(known, height, 0.0)], axis=-1), terrain.normal(x, y).copy(), known


def held_samples(plan: Solution) -> np.ndarray:
    """Where contacts are on bilateral surfaces (K, nc). Raises `SolutionFileError`."""
    held, frames = np.zeros(plan.active.shape, dtype=bool), list(plan.contact_frames)
    for phase, surfaces in enumerate(surfaces_of(plan.meta.get("surfaces"))):
        for frame, surface in surfaces.items():
            held[plan.phase == phase, frames.index(frame)] = surface.bilateral
    return held


def surfaces_of(described: Any) -> list[dict[str, Surface]]:
    """Read ``meta["surfaces"]``: for each phase the surfaces of active contacts, by their frames.

    Empty where all contacts touch the terrain. Raises `SolutionFileError`.
    """
    if described is None:
        return []
    if not isinstance(described, list) or not all(isinstance(phase, dict) for phase in described):
        raise SolutionFileError("surfaces of meta is not null or a list of {contact frame: surface}")
    try:
        return [
            {str(frame): Surface.from_description(entry) for frame, entry in phase.items()}
            for phase in described
        ]
    except InputError as error:
        raise SolutionFileError(f"surfaces of meta: {error.what}", error.allowed) from None


def patches_of(described: Any) -> list[dict[str, Patch]]:
    """Read ``meta["patches"]``: for each phase the patches on which active contacts stand, by their frames.

    Empty where there are none. Raises `SolutionFileError`.
    """
    if described is None:
        return []
    if not isinstance(described, list) or not all(isinstance(phase, dict) for phase in described):
        raise SolutionFileError("patches of meta is not null or a list of {contact frame: patch}")
    try:
        return [
            {str(frame): Patch.from_description(entry) for frame, entry in phase.items()}
            for phase in described
        ]
    except InputError as error:
        raise SolutionFileError(f"patches of meta: {error.what}", error.allowed) from None


def terrain_of(described: Any) -> Read | None:
    """Read ``meta["terrain"]``; None where there is none. Raises `SolutionFileError` for another kind."""
    kind = described.get("kind") if isinstance(described, dict) else described
    if kind not in ("piecewise", "smooth"):
        return terrain_surface(described)
    try:
        return (PiecewiseTerrain if kind == "piecewise" else SmoothTerrain).from_description(described)
    except InputError as error:
        raise SolutionFileError(f"terrain in meta: {error.what}", error.allowed) from None


def terrain_surface(terrain: Any) -> Surface | None:
    """Read flat ground of ``meta["terrain"]``, None where there is none. Raises `SolutionFileError`."""
    if terrain is None:
        return None
    if not isinstance(terrain, dict) or terrain.get("kind") != "flat":
        kind = terrain.get("kind") if isinstance(terrain, dict) else terrain
        raise SolutionFileError(
            f"terrain of kind {kind!r} in meta is not known",
            "'flat', 'piecewise', 'smooth' or null",
        )
    try:
        height = float(terrain.get("height", 0.0))
        return Surface(point=np.array([0.0, 0.0, height]), normal=terrain.get("normal", UP))
    except (TypeError, ValueError):
        raise SolutionFileError("terrain in meta has no numeric 'height' and 'normal'") from None
    except InputError:
        raise SolutionFileError("terrain in meta has no finite 'height' and 'normal' (3,)") from None
