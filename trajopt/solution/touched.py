"""Surface that every contact of a solution touches, sample by sample: from its meta to arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajopt.solution.descriptions import GroundShape, surfaces_of, terrain_of
from trajopt.solution.solution import Solution
from trajopt.terrain.surface import UP, Surface


@dataclass(frozen=True, kw_only=True)
class TouchedSurfaces:
    """Planes at K samples of nc contacts: the terrain's under it, or the one that its phase states.

    point, normal (K, nc, 3) m; friction (K, nc); bilateral (K, nc): transmits any wrench; known (K, nc):
    whether there is a plane (in a hole, or without terrain, normals are up, and heights unknown). slip (K,
    nc): slip speed, m/s, of a surface along which the contact slides, NaN where it is held.
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


def touched_surfaces(
    plan: Solution, position: np.ndarray, phases: np.ndarray | None = None
) -> TouchedSurfaces:
    """Read terrain, friction and surfaces of a consistent solution. Raises `SolutionFileError`.

    ``position`` (K, nc, 3) m: of the contacts; ground that is not a plane is taken under them.
    ``phases`` (K,): of these positions if they are not those of the samples.
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
    return TouchedSurfaces(
        point=point, normal=normal, friction=friction, bilateral=bilateral, known=known, slip=slip
    )


def _ground(terrain: GroundShape | None, position: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Point, normal (K, nc, 3) of the ground under contacts, and where there is any; not in a hole."""
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
