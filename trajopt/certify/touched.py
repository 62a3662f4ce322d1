"""What every contact of a solution touches, sample by sample: from its meta to arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from trajopt.errors import InputError, SolutionFileError
from trajopt.solution import Solution
from trajopt.surface import UP, Surface


@dataclass(frozen=True, kw_only=True)
class Touched:
    """Surfaces at K samples of nc contacts: the terrain, or that of the phase where a contact has its own.

    point, normal (K, nc, 3) m; friction (K, nc); bilateral (K, nc): transmits any wrench; known (K, nc):
    there is a plane at all (a file may have no terrain: then normals are up, and heights unknown).
    """

    point: np.ndarray
    normal: np.ndarray
    friction: np.ndarray
    bilateral: np.ndarray
    known: np.ndarray

    def along_normal(self, vectors: np.ndarray) -> np.ndarray:
        """Components (K, nc) of vectors (K, nc, 3) along the normals."""
        return np.asarray(np.sum(self.normal * vectors, axis=-1))

    def distance(self, position: np.ndarray) -> np.ndarray:
        """Signed distance (K, nc) in m of positions (K, nc, 3); NaN where there is no plane."""
        return np.where(self.known, self.along_normal(position - self.point), np.nan)


def touched(plan: Solution) -> Touched:
    """Read terrain, friction and surfaces of a consistent solution. Raises `SolutionFileError`."""
    terrain, frames = terrain_surface(plan.meta["terrain"]), list(plan.contact_frames)
    own = surfaces_of(plan.meta.get("surfaces")) or [{}] * (int(plan.phase[-1]) + 1)
    ground = terrain or Surface(point=np.zeros(3), normal=np.array(UP))
    size = (len(own), len(frames))
    point, normal = np.tile(ground.point, (*size, 1)), np.tile(ground.normal, (*size, 1))
    friction = np.tile(np.array(plan.meta["friction"], dtype=float), (size[0], 1))
    bilateral, known = np.zeros(size, dtype=bool), np.full(size, terrain is not None)
    for phase, surfaces in enumerate(own):
        for frame, surface in surfaces.items():
            at = (phase, frames.index(frame))
            point[at], normal[at], friction[at] = surface.point, surface.normal, surface.friction
            bilateral[at], known[at] = surface.bilateral, True
    rows = plan.phase
    return Touched(
        point=point[rows],
        normal=normal[rows],
        friction=friction[rows],
        bilateral=bilateral[rows],
        known=known[rows],
    )


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


def terrain_surface(terrain: Any) -> Surface | None:
    """Read ``meta["terrain"]``; None where there is none. Raises `SolutionFileError` for another kind."""
    if terrain is None:
        return None
    if not isinstance(terrain, dict) or terrain.get("kind") != "flat":
        kind = terrain.get("kind") if isinstance(terrain, dict) else terrain
        raise SolutionFileError(
            f"terrain of kind {kind!r} in meta is not known to this version", "'flat' or null"
        )
    try:
        height = float(terrain.get("height", 0.0))
        return Surface(point=np.array([0.0, 0.0, height]), normal=terrain.get("normal", UP))
    except (TypeError, ValueError):
        raise SolutionFileError("terrain in meta has no numeric 'height' and 'normal'") from None
    except InputError:
        raise SolutionFileError("terrain in meta has no finite 'height' and 'normal' (3,)") from None
