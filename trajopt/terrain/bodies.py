"""Convex hulls, and the ground as convex bodies: a half-space, or the volumes below plane faces."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import coal
import numpy as np

from trajopt.terrain.flat import FlatGround
from trajopt.terrain.patch import Patch, cut_polygon
from trajopt.terrain.piecewise import PiecewiseTerrain

# The ground extends this far below the lowest face, m: deeper than any link.
DEPTH = 5.0
# Heights within this of each other are the same, m: rounding of corners far from the origin.
SAME_HEIGHT = 1e-6
# A part of a footprint smaller than this is a crack between faces, m^2.
CRACK_AREA = 1e-4
# Number of terrains whose bodies are cached.
MOST_TERRAINS = 32
# Three points are collinear if twice the area of their triangle is below this times the extent squared.
LINE_AREA = 1e-12
# A half-plane of the (x, y) plane: inward (3,) @ p >= offset, with no part along z.
_HalfPlane = tuple[np.ndarray, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Hull:
    """Convex hull in space: ``corners`` (k, 3), m, and ``triangles`` (m, 3), indices of their corners.

    The triangles have outward unit ``normals`` (m, 3) and ``offsets`` (m,): inside, normals @ p <= offsets.
    """

    corners: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray
    offsets: np.ndarray


def convex_hull(points: np.ndarray) -> Hull:
    """Hull of points (n, 3) that span a volume, by Qhull in Coal: SciPy takes a while to load."""
    given = coal.StdVec_Vec3s()
    for point in np.asarray(points, dtype=float):
        given.append(point)
    hull = coal.Convex.convexHull(given, True, "Qt")
    faces = [hull.polygons(number) for number in range(hull.num_polygons)]
    return Hull(
        corners=np.array(hull.points()),
        triangles=np.array([[face[0], face[1], face[2]] for face in faces]),
        normals=np.array(hull.normals()),
        offsets=-np.array(hull.offsets()).ravel(),
    )


def outline(points: np.ndarray) -> np.ndarray:
    """Indices (k,) of the corners of the hull of points (n, 2), counter-clockwise; k < 3 without area.

    Andrew's monotone chain: the lower side from left to right, then the upper side back.
    """
    order = np.lexsort((points[:, 1], points[:, 0])).tolist()
    least = LINE_AREA * float(np.ptp(points, axis=0).max(initial=0.0)) ** 2 if len(points) else 0.0
    place = points.tolist()
    corners: list[int] = []
    for way in (order, order[::-1]):
        side: list[int] = []
        for index in way:
            x, y = place[index]
            while len(side) > 1:
                (ax, ay), (bx, by) = place[side[-2]], place[side[-1]]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > least:
                    break
                side.pop()
            side.append(index)
        corners += side[:-1]
    return np.array(corners, dtype=int)


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
        hull = convex_hull(self.points)
        planes = np.unique(np.round(np.column_stack([hull.normals, hull.offsets]), 9), axis=0)
        return planes[:, :3], planes[:, 3]


GroundBody = HalfSpace | ConvexGround


def ground_bodies(terrain: FlatGround | PiecewiseTerrain) -> tuple[GroundBody, ...]:
    """Return the convex bodies whose union is the ground; for a plane, the half-space below it.

    For faces, they are the volumes below each face, down to `DEPTH` below the lowest. A body extends under
    higher ground, and beyond edges where the ground continues convexly. It therefore has sides only at risers
    and where the ground ends: steps, the sides of boxes and pits, holes.
    """
    if isinstance(terrain, FlatGround):
        surface = terrain.surface
        return (HalfSpace(normal=surface.normal, offset=surface.height),)
    return _below(_KeyedTerrain(b"".join(face.vertices.tobytes() for face in terrain.faces), terrain))


@dataclass(frozen=True)
class _KeyedTerrain:
    """A terrain that compares equal to any terrain with the same faces."""

    content: bytes
    terrain: PiecewiseTerrain = field(compare=False)


@lru_cache(maxsize=MOST_TERRAINS)
def _below(keyed: _KeyedTerrain) -> tuple[ConvexGround, ...]:
    terrain = keyed.terrain
    bodies: list[ConvexGround] = []
    for points in _solids([_grown(face, terrain) for face in terrain.faces], DEPTH):
        body = ConvexGround(points=points)
        if not any(_contains(other, body) for other in bodies):
            bodies = [other for other in bodies if not _contains(body, other)] + [body]
    return tuple(bodies)


def solids_within(
    terrain: PiecewiseTerrain, low: np.ndarray, high: np.ndarray, depth: float
) -> list[tuple[Patch, np.ndarray]]:
    """Faces over a rectangle from ``low`` to ``high`` (x, y) m, and the solid below the part of each there.

    A solid has corners (2 k, 3), world, m: those of the part, then those ``depth`` m below the lowest part.
    """
    parts = [(face, top) for face in terrain.faces if len(top := face.within(low, high)) >= 3]
    solids = _solids([top for _, top in parts], depth)
    return [(face, solid) for (face, _), solid in zip(parts, solids, strict=True)]


def _solids(tops: Sequence[np.ndarray], depth: float) -> list[np.ndarray]:
    """Corners (2 k, 3) of the prism below each polygon (k, 3), down to ``depth`` m below the lowest."""
    low = min((float(top[:, 2].min()) for top in tops), default=0.0) - depth
    return [np.concatenate([top, np.column_stack([top[:, :2], np.full(len(top), low)])]) for top in tops]


def _contains(body: ConvexGround, other: ConvexGround) -> bool:
    normals, offsets = body.planes
    return bool((other.points @ normals.T <= offsets + SAME_HEIGHT).all())


def _grown(face: Patch, terrain: PiecewiseTerrain) -> np.ndarray:
    """Top corners (k, 3) of a face's body: its own, and neighbours' as long as the body stays ground."""
    slope, level = _height_of(face)

    def under(other: Patch) -> np.ndarray:
        corners = other.vertices.copy()
        corners[:, 2] = np.minimum(corners[:, 2], corners @ slope + level)
        return corners

    tops, waiting = face.vertices, [other for other in terrain.faces if other is not face]
    higher = [
        other for other in waiting if (other.vertices @ [*-slope[:2], 1.0] >= level - SAME_HEIGHT).all()
    ]
    # Usually all higher ground can be joined at once, as on stairs; otherwise one face after the other.
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
    """Slope (3,) and level of a face's plane, whose height at p is slope @ p + level."""
    normal = face.surface.normal
    slope = np.array([-normal[0], -normal[1], 0.0]) / normal[2]
    return slope, face.surface.height / float(normal[2])


def _touch(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether two convex polygons (k, 3), (n, 3) touch or overlap as seen from above."""
    for polygon in (_from_above(first), _from_above(second)):
        for inward, _ in _edges(polygon):
            one, other = first @ inward, second @ inward
            if one.max() < other.min() - SAME_HEIGHT or other.max() < one.min() - SAME_HEIGHT:
                return False
    return True


def _from_above(points: np.ndarray) -> np.ndarray:
    """Corners (k, 3), counter-clockwise from above, of the convex hull of points as seen from above."""
    return np.asarray(points[outline(points[:, :2])])


def _edges(polygon: np.ndarray) -> list[_HalfPlane]:
    along = np.roll(polygon, -1, axis=0) - polygon
    inward = np.column_stack([-along[:, 1], along[:, 0], np.zeros(len(along))])
    inward /= np.linalg.norm(inward, axis=1)[:, None]
    return [(normal, float(normal @ corner)) for normal, corner in zip(inward, polygon, strict=True)]


def _is_ground(tops: np.ndarray, terrain: PiecewiseTerrain) -> bool:
    """Whether everything below the hull of ``tops`` (k, 3) is below faces of the terrain."""
    body = ConvexGround(points=_solids([tops], 1.0)[0])
    for normal, offset in zip(*body.planes, strict=True):
        if normal[2] <= SAME_HEIGHT:
            continue
        on = body.points[body.points @ normal >= offset - SAME_HEIGHT]
        if not _is_covered(_from_above(on), -normal / normal[2] * [1, 1, 0], offset / normal[2], terrain):
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
    while waiting and above < CRACK_AREA:  # depth first: usually an early part is above the terrain
        part, count = waiting.pop()
        if count == len(near):
            x, y = part[:, 0], part[:, 1]
            above += 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
            continue
        its_slope, its_level = _height_of(near[count])
        higher = (its_slope - slope, level - its_level - SAME_HEIGHT)
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
