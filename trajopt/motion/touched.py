"""Surface that every contact of a solution touches, sample by sample: from its description to arrays."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trajopt.solution.description import GroundShape
from trajopt.solution.solution import Solution
from trajopt.terrain.surface import UP, Surface


@dataclass(frozen=True, kw_only=True)
class TouchedSurfaces:
    """Planes at K samples of nc contacts: the terrain's under it, or the one that its phase states.

    A plane is the one on which the contact's frame lies: of a contact with a radius the plane parallel to
    what it touches, which is `ground`. point, normal (K, nc, 3) m; radius, friction (K, nc); lever (K, nc, 3)
    m: from where a contact that rolls touches to its frame, zero of others; bilateral (K,
    nc): transmits any wrench; known (K, nc): whether there is a plane (in a hole, or without terrain, normals
    are up, and heights unknown). slip (K, nc): slip speed, m/s, of a surface along which the contact slides,
    NaN where it is held.
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
        """The planes that contacts touch, as of contacts without a radius."""
        return replace(self, point=self.touching(self.point), radius=np.zeros_like(self.radius))

    def touching(self, position: np.ndarray) -> np.ndarray:
        """Points (K, nc, 3) m where contacts with frames at ``position`` (K, nc, 3) m touch, or would."""
        return np.asarray(position - self.radius[..., None] * self.normal)

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

    ``position`` (K, nc, 3) m: of the contacts' frames; ground that is not a plane is taken under them.
    ``phases`` (K,): of these positions if they are not those of the samples.
    """
    frames, rows = list(plan.contact_frames), plan.phase if phases is None else phases
    radii = plan.description.radii
    point, normal, known = _ground(plan.description.ground, position, radii)
    friction = np.tile(
        np.array([contact.friction for contact in plan.description.contacts], dtype=float), (len(rows), 1)
    )
    bilateral, slip = np.zeros(friction.shape, dtype=bool), np.full(friction.shape, np.nan)
    for phase, surfaces in enumerate(plan.description.surfaces):
        for frame, surface in surfaces.items():
            at = (rows == phase, frames.index(frame))
            raised = surface.offset(float(radii[at[1]]))
            point[at], normal[at], friction[at] = raised.point, raised.normal, surface.friction
            bilateral[at], known[at] = surface.bilateral, True
            slip[at] = np.nan if surface.slip_speed is None else surface.slip_speed
    return TouchedSurfaces(
        point=point,
        normal=normal,
        radius=np.tile(radii, (len(rows), 1)),
        lever=(radii * plan.description.rolling)[:, None] * normal,
        friction=friction,
        bilateral=bilateral,
        known=known,
        slip=slip,
    )


def _ground(
    terrain: GroundShape | None, position: np.ndarray, radii: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Point, normal (K, nc, 3) of the ground's parallel surface under contacts, and where it is known."""
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


def held_samples(plan: Solution) -> np.ndarray:
    """Where contacts are on bilateral surfaces (K, nc). Raises `SolutionFileError`."""
    held, frames = np.zeros(plan.active.shape, dtype=bool), list(plan.contact_frames)
    for phase, surfaces in enumerate(plan.description.surfaces):
        for frame, surface in surfaces.items():
            held[plan.phase == phase, frames.index(frame)] = surface.bilateral
    return held


def without_rolling(motion: np.ndarray, surfaces: TouchedSurfaces) -> np.ndarray:
    """Linear part (K, nc, 3) of twists or accelerations (K, nc, 6); of contacts that roll without rolling."""
    return np.asarray(motion[..., :3] - np.cross(motion[..., 3:], surfaces.lever))


def held_part(vectors: np.ndarray, surfaces: TouchedSurfaces) -> np.ndarray:
    """Motion vectors (K, nc, 3); of sliding contacts only the normal component."""
    normal = surfaces.along_normal(vectors)[..., None] * surfaces.normal
    return np.where(surfaces.slides[..., None], normal, vectors)
