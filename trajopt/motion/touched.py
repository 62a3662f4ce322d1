"""The surface that every contact of a solution touches, sample by sample, as arrays."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trajopt.motion.description import GroundShape, PlanDescription
from trajopt.terrain.surface import UP, Surface


@dataclass(frozen=True, kw_only=True)
class TouchedSurfaces:
    """Planes on which nc contact frames lie at K samples: parts of the terrain, or surfaces of the phases.

    A contact with a radius has the plane parallel to what it touches, which is `ground`.
    point, normal: (K, nc, 3) m; without a plane the normal is up. radius, friction: (K, nc), radius in m.
    lever: (K, nc, 3) m from the touching point of a rolling contact to its frame; zero for other contacts.
    bilateral: (K, nc) whether the surface transmits any wrench.
    known: (K, nc) whether there is a plane, which is not the case in a hole or without terrain.
    slip: (K, nc) slip speed, m/s, on surfaces along which contacts slide; NaN for contacts that are held.
    """

    point: np.ndarray
    normal: np.ndarray
    radius: np.ndarray
    lever: np.ndarray
    friction: np.ndarray
    bilateral: np.ndarray
    known: np.ndarray
    slip: np.ndarray

    @property
    def ground(self) -> TouchedSurfaces:
        """The touched planes themselves, as for contacts without a radius."""
        return replace(self, point=self.touching(self.point), radius=np.zeros_like(self.radius))

    def touching(self, position: np.ndarray) -> np.ndarray:
        """Return the touching points (K, nc, 3) m of contacts with frames at ``position`` (K, nc, 3) m."""
        return np.asarray(position - self.radius[..., None] * self.normal)

    @property
    def slides(self) -> np.ndarray:
        """Whether contacts slide (K, nc)."""
        return np.isfinite(self.slip)

    def along_normal(self, vectors: np.ndarray) -> np.ndarray:
        """Return the components (K, nc) of vectors (K, nc, 3) along the normals."""
        return np.asarray(np.sum(self.normal * vectors, axis=-1))

    def distance(self, position: np.ndarray) -> np.ndarray:
        """Return the signed distance (K, nc) in m of positions (K, nc, 3); NaN without a plane."""
        return np.where(self.known, self.along_normal(position - self.point), np.nan)


def touched_surfaces(about: PlanDescription, position: np.ndarray, phases: np.ndarray) -> TouchedSurfaces:
    """Return the surfaces that contacts touch in phases (K,) of a plan. Raises `SolutionFileError`.

    ``position`` (K, nc, 3) m: contact frames, under which uneven ground is evaluated.
    """
    frames, radii = list(about.frames), about.radii
    point, normal, known = _ground(about.ground, position, radii)
    friction = np.tile(
        np.array([contact.friction for contact in about.contacts], dtype=float), (len(phases), 1)
    )
    bilateral, slip = np.zeros(friction.shape, dtype=bool), np.full(friction.shape, np.nan)
    for phase, surfaces in enumerate(about.surfaces):
        for frame, surface in surfaces.items():
            at = (phases == phase, frames.index(frame))
            raised = surface.offset(float(radii[at[1]]))
            point[at], normal[at], friction[at] = raised.point, raised.normal, surface.friction
            bilateral[at], known[at] = surface.bilateral, True
            slip[at] = np.nan if surface.slip_speed is None else surface.slip_speed
    return TouchedSurfaces(
        point=point,
        normal=normal,
        radius=np.tile(radii, (len(phases), 1)),
        lever=(radii * about.rolling)[:, None] * normal,
        friction=friction,
        bilateral=bilateral,
        known=known,
        slip=slip,
    )


def _ground(
    terrain: GroundShape | None, position: np.ndarray, radii: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return point and normal (K, nc, 3) of the parallel ground surface under contacts, and where known."""
    point, normal = position.copy(), np.empty_like(position)
    known = np.full(position.shape[:2], terrain is not None)
    if terrain is None or isinstance(terrain, Surface):
        plane = terrain or Surface(point=np.zeros(3), normal=np.array(UP))
        normal[:] = plane.normal
        point[:] = plane.point + radii[:, None] * plane.normal
        return point, normal, known
    for radius in np.unique(radii):
        same_radius, raised = radii == radius, terrain.offset(float(radius))
        x, y = position[:, same_radius, 0], position[:, same_radius, 1]
        height = raised.height(x, y)
        known[:, same_radius] = np.isfinite(height)
        point[:, same_radius, 2] = np.where(known[:, same_radius], height, 0.0)
        normal[:, same_radius] = raised.normal(x, y)
    return point, normal, known


def held_contacts(about: PlanDescription, phases: np.ndarray) -> np.ndarray:
    """Return whether contacts are on bilateral surfaces (K, nc) in phases (K,) of a plan."""
    frames = list(about.frames)
    held = np.zeros((len(phases), len(frames)), dtype=bool)
    for phase, surfaces in enumerate(about.surfaces):
        for frame, surface in surfaces.items():
            held[phases == phase, frames.index(frame)] = surface.bilateral
    return held


def without_rolling(motion: np.ndarray, surfaces: TouchedSurfaces) -> np.ndarray:
    """Return the linear part (K, nc, 3) of twists or accelerations (K, nc, 6) without the rolling motion."""
    return np.asarray(motion[..., :3] - np.cross(motion[..., 3:], surfaces.lever))


def held_part(vectors: np.ndarray, surfaces: TouchedSurfaces) -> np.ndarray:
    """Return motion vectors (K, nc, 3), for sliding contacts only their normal component."""
    normal = surfaces.along_normal(vectors)[..., None] * surfaces.normal
    return np.where(surfaces.slides[..., None], normal, vectors)
