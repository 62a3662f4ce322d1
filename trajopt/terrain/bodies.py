"""The ground as convex bodies: a half-space, or what lies below plane faces."""

from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np

from trajopt.terrain.flat import FlatGround
from trajopt.terrain.patch import Patch, cut_polygon
from trajopt.terrain.piecewise import PiecewiseTerrain

# Ground below faces reaches this far below the lowest of them, m: deeper than any link.
DEPTH = 5.0
# Heights within this of each other are the same, m: rounding of corners far from the origin.
SAME = 1e-6
# Part of a footprint smaller than this is a crack between faces, m^2.
CRACK_AREA = 1e-4
# Terrains whose bodies are kept.
MOST_TERRAINS = 32
# A half-plane of the (x, y) plane: inward (3,) @ p >= offset, with no part along z.
_HalfPlane = tuple[np.ndarray, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class HalfSpace:
    """All points p with ``normal`` (3,) @ p <= ``offset`` m, world."""

    normal: np.ndarray
    offset: float

    @property
    def planes(self) -> tuple[np.ndarray, np.ndarray]:
        """Its plane as those of `ConvexGround`: normals (1, 3), offsets (1,)."""
        return self.normal[None], np.array([self.offset])


@dataclass(frozen=True, kw_only=True, eq=False)
class ConvexGround:
    """The convex hull of ``points`` (n, 3) m, world: the ground below a face, down to `DEPTH`."""

    points: np.ndarray

    @cached_property
    def planes(self) -> tuple[np.ndarray, np.ndarray]:
        """Outward unit normals (m, 3) and offsets (m,) of its faces: inside, normals @ p <= offsets."""
        from scipy.spatial import ConvexHull  # takes a while to load

        equations = np.unique(np.round(ConvexHull(self.points).equations, 9), axis=0)
        return equations[:, :3], -equations[:, 3]


GroundBody = HalfSpace | ConvexGround


def ground_bodies(terrain: FlatGround | PiecewiseTerrain) -> tuple[GroundBody, ...]:
    """Return the convex bodies whose union is the ground: of a plane the half-space below it.

    Of faces, what lies below each of them, as far as `DEPTH` below the lowest. A body continues under higher
    ground and beyond the edges where the ground goes on convexly, so that it has a side only where there is
    a riser or an end of the ground: steps, the sides of boxes and pits, holes.
    """
    if isinstance(terrain, FlatGround):
        surface = terrain.surface
        return (HalfSpace(normal=surface.normal, offset=surface.height),)
    return _below(_Keyed(b"".join(face.vertices.tobytes() for face in terrain.faces), terrain))


@dataclass(frozen=True)
class _Keyed:
    """A terrain that is equal to another with the same faces."""

    content: bytes
    terrain: PiecewiseTerrain = field(compare=False)


@lru_cache(maxsize=MOST_TERRAINS)
def _below(keyed: _Keyed) -> tuple[ConvexGround, ...]:
    terrain = keyed.terrain
    grown = [_grown(face, terrain) for face in terrain.faces]
    low = min(float(tops[:, 2].min()) for tops in grown) - DEPTH
    bodies: list[ConvexGround] = []
    for tops in grown:
        body = ConvexGround(points=_extruded(tops, low))
        if not any(_contains(other, body) for other in bodies):
            bodies = [other for other in bodies if not _contains(body, other)] + [body]
    return tuple(bodies)


def _extruded(tops: np.ndarray, low: float) -> np.ndarray:
    return np.concatenate([tops, np.column_stack([tops[:, :2], np.full(len(tops), low)])])


def _contains(body: ConvexGround, other: ConvexGround) -> bool:
    normals, offsets = body.planes
    return bool((other.points @ normals.T <= offsets + SAME).all())


def _grown(face: Patch, terrain: PiecewiseTerrain) -> np.ndarray:
    """Top corners (k, 3) of the body of a face: its own, and of its neighbours as far as it stays ground."""
    slope, level = _height_of(face)

    def under(other: Patch) -> np.ndarray:
        corners = other.vertices.copy()
        corners[:, 2] = np.minimum(corners[:, 2], corners @ slope + level)
        return corners

    tops, waiting = face.vertices, [other for other in terrain.faces if other is not face]
    higher = [other for other in waiting if (other.vertices @ [*-slope[:2], 1.0] >= level - SAME).all()]
    # Most often all higher ground at once: stairs from there on. Else one face after the other.
    joined = np.concatenate([tops, *(under(other) for other in higher)])
    touching = any(_touch(tops, other.vertices) for other in higher)
    if touching and _is_ground(joined, terrain):
        tops, waiting = joined, [other for other in waiting if other not in higher]
    grown = True
    while grown:
        grown = False
        for other in [entry for entry in waiting if _touch(tops, entry.vertices)]:
            joined = np.concatenate([tops, under(other)])
            if _is_ground(joined, terrain):
                tops, grown = joined, True
                waiting.remove(other)
    return tops


def _height_of(face: Patch) -> tuple[np.ndarray, float]:
    """Height of a face's plane over p: slope (3,) @ p + level."""
    normal = face.surface.normal
    slope = np.array([-normal[0], -normal[1], 0.0]) / normal[2]
    return slope, face.surface.height / float(normal[2])


def _touch(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether two convex polygons (k, 3), (n, 3) touch or overlap as seen from above."""
    for polygon in (_outline(first), _outline(second)):
        for inward, _ in _edges(polygon):
            one, other = first @ inward, second @ inward
            if one.max() < other.min() - SAME or other.max() < one.min() - SAME:
                return False
    return True


def _outline(points: np.ndarray) -> np.ndarray:
    """Corners (k, 3), counter-clockwise from above, of the convex hull of points as seen from above."""
    from scipy.spatial import ConvexHull

    return np.asarray(points[ConvexHull(points[:, :2]).vertices])


def _edges(polygon: np.ndarray) -> list[_HalfPlane]:
    along = np.roll(polygon, -1, axis=0) - polygon
    inward = np.column_stack([-along[:, 1], along[:, 0], np.zeros(len(along))])
    inward /= np.linalg.norm(inward, axis=1)[:, None]
    return [(normal, float(normal @ corner)) for normal, corner in zip(inward, polygon, strict=True)]


def _is_ground(tops: np.ndarray, terrain: PiecewiseTerrain) -> bool:
    """Whether all that lies below the hull of ``tops`` (k, 3) lies below faces of the terrain."""
    body = ConvexGround(points=_extruded(tops, float(tops[:, 2].min()) - 1.0))
    for normal, offset in zip(*body.planes, strict=True):
        if normal[2] <= SAME:
            continue
        on = body.points[body.points @ normal >= offset - SAME]
        if not _is_covered(_outline(on), -normal / normal[2] * [1, 1, 0], offset / normal[2], terrain):
            return False
    return True


def _is_covered(polygon: np.ndarray, slope: np.ndarray, level: float, terrain: PiecewiseTerrain) -> bool:
    """Whether a polygon (k, 3) in the plane z = slope @ p + level is nowhere above the terrain."""
    low, high = polygon[:, :2].min(axis=0), polygon[:, :2].max(axis=0)
    near = [
        face
        for face in terrain.faces
        if (face.vertices[:, :2].min(axis=0) < high).all() and (face.vertices[:, :2].max(axis=0) > low).all()
    ]
    above, waiting = 0.0, [(polygon, 0)]
    while waiting and above < CRACK_AREA:  # parts one after the other: most often an early one is above
        part, count = waiting.pop()
        if count == len(near):
            x, y = part[:, 0], part[:, 1]
            above += 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
            continue
        its_slope, its_level = _height_of(near[count])
        higher = (its_slope - slope, level - its_level - SAME)
        if (part @ higher[0] <= higher[1]).all():
            waiting.append((part, count + 1))
            continue
        region = [*_edges(near[count].vertices), higher]
        waiting += [(each, count + 1) for each in _outside(part, region)]
    return above < CRACK_AREA


def _outside(polygon: np.ndarray, region: list[_HalfPlane]) -> list[np.ndarray]:
    """Convex parts of a polygon that are not in a region bounded by half-planes."""
    parts = []
    for inward, offset in region:
        part = cut_polygon(polygon, -inward, -offset)
        if len(part) > 2:
            parts.append(part)
        polygon = cut_polygon(polygon, inward, offset)
        if len(polygon) < 3:
            return parts
    return parts
