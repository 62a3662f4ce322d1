"""Signed distances of a link's shape from the ground, at many placements at once."""

import math
from functools import cached_property

import numpy as np
import pinocchio as pin

from trajopt.collision.coal_shapes import CoalBody, CoalPairs, Witness, coal_hull, coal_link, thick
from trajopt.collision.planes import PlacedBody
from trajopt.collision.shapes import LinkShape
from trajopt.dynamics.joint_placements import Placements
from trajopt.terrain.bodies import ConvexGround, GroundBody, HalfSpace, convex_hull
from trajopt.terrain.smooth import SmoothTerrain

# A point whose foot is this far outside of a face, m, still projects onto it: rounding.
ON_FACE = 1e-9
# Smooth ground is taken to rise by no more than 45 degrees where links high above it are passed over.
STEEPEST = math.sqrt(2.0)
# Points of a shape within a cube of this side, m, are looked at together.
CLUSTER = 0.08
# Distance between neighbours, m: over ground with a radius of curvature R the hull between them comes nearer
# by at most SPACING^2 / (6 R), 0.7 mm at R = 0.1 m.
SPACING = 0.02


class BodyDistance:
    """Exact distances of one shape from a convex body of the ground."""

    def __init__(self, shape: LinkShape, body: GroundBody) -> None:
        self._shape, self._body = shape, body
        self._normals, self._offsets = body.planes

    def distances(self, places: Placements, within: float) -> np.ndarray:
        """Distances (K,) m at placements (K, 3, 3), (K, 3); lower bounds of those > ``within``."""
        rotation, origin = places
        centre, reach = self._shape.ball
        away = (origin + rotation @ centre) @ self._normals.T
        distances = np.asarray((away - self._offsets).max(axis=1) - reach)
        rows = np.flatnonzero(distances <= within)
        if len(rows):
            distances[rows] = self._beyond_planes((rotation[rows], origin[rows]), within)
        return distances

    def _beyond_planes(self, places: Placements, within: float) -> np.ndarray:
        """By the plane that lies farthest from the shape: exact where its nearest point is over that face."""
        rotation, origin = places
        along = np.ascontiguousarray(np.moveaxis(self._normals @ rotation, 1, 0))
        heights = along @ np.ascontiguousarray(self._shape.points.T)
        lowest = heights.min(axis=2) + (self._normals @ origin.T - self._offsets[:, None])
        distances = np.asarray(lowest.max(axis=0) - self._shape.radius)
        if isinstance(self._body, HalfSpace):
            return distances
        rows = np.flatnonzero(distances <= within)
        face = lowest[:, rows].argmax(axis=0)
        vertex = heights[face, rows].argmin(axis=1)
        point = origin[rows] + np.einsum("kij,kj->ki", rotation[rows], self._shape.points[vertex])
        gap = lowest[face, rows]
        foot = point - gap[:, None] * self._normals[face]
        over = (gap > 0) & (foot @ self._normals.T <= self._offsets + ON_FACE).all(axis=1)
        rest = rows[~over]
        if len(rest):
            distances[rest] = self._coal.distances((0, 1), *self._both((rotation[rest], origin[rest])))
        return distances

    def witness(self, place: Placements) -> Witness:
        """Nearest points at one placement (1, 3, 3), (1, 3); the normal points out of the ground."""
        if not isinstance(self._body, HalfSpace):
            return self._coal.witness((0, 1), *self._both(place))
        normal = self._normals[0]
        points = place[1] + self._shape.points @ place[0][0].T
        heights = points @ normal
        lowest = points[np.abs(heights - heights.min()) <= ON_FACE].mean(axis=0)
        return _over(lowest, self._shape.radius, normal, float(self._offsets[0]))

    def solid(self, witness: Witness) -> PlacedBody:
        """The body of the ground."""
        if isinstance(self._body, HalfSpace):
            return PlacedBody(normal=self._body.normal, height=self._body.offset)
        return PlacedBody(points=self._body.points, sides=self._normals)

    def _both(self, places: Placements) -> tuple[Placements, Placements]:
        count = len(places[1])
        return places, (np.broadcast_to(np.eye(3), (count, 3, 3)), np.zeros((count, 3)))

    @cached_property
    def _coal(self) -> CoalPairs:
        (solid, place), shape = coal_link(self._shape), self._shape
        bodies = [CoalBody(solid=solid, place=place, points=shape.points, radius=shape.radius)]
        if isinstance(self._body, ConvexGround):
            points, still = self._body.points, pin.SE3.Identity()
            bodies.append(CoalBody(solid=coal_hull(points), place=still, points=points, radius=0.0))
        return CoalPairs(bodies)


class SmoothDistance:
    """Distances of one shape from ground z = h(x, y), the least over `surface_points`.

    That of a point is from the tangent plane under it, (z - h) / sqrt(1 + |grad h|^2).
    """

    def __init__(self, shape: LinkShape, terrain: SmoothTerrain) -> None:
        self._shape, self._terrain = shape, terrain

    def distances(self, places: Placements, within: float) -> np.ndarray:
        """Distances (K,) m at placements (K, 3, 3), (K, 3); lower bounds of those > ``within``."""
        rotation, origin = places
        centre, reach = self._shape.ball
        centres = origin + rotation @ centre
        over = centres[:, 2] - self._terrain.height(centres[:, 0], centres[:, 1])
        distances = np.asarray(over / STEEPEST - reach)
        rows = np.flatnonzero(distances <= within)
        if len(rows):
            distances[rows] = self._nearest(rotation[rows], origin[rows], within + self._shape.radius)
            distances[rows] -= self._shape.radius
        return distances

    def _nearest(self, rotation: np.ndarray, origin: np.ndarray, within: float) -> np.ndarray:
        """Least distances (K,) of the points; lower bounds of those > ``within``.

        Clusters that cannot hold the nearest point are passed over.
        """
        points, starts, sizes, radii = self._clusters
        middles = points[starts] @ np.swapaxes(rotation, 1, 2) + origin[:, None]
        height, slopes = self._terrain.height_and_slopes(middles[..., 0], middles[..., 1])
        over = middles[..., 2] - height
        nearest = (over / np.sqrt(1 + (slopes**2).sum(axis=0))).min(axis=1)
        least = over - STEEPEST * radii
        least = np.where(least > 0, least / STEEPEST, least)
        row, cluster = np.nonzero(least <= np.minimum(nearest, within)[:, None])
        least[row, cluster] = np.inf
        counts = sizes[cluster]
        within_cluster = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        looked_at = points[np.repeat(starts[cluster], counts) + within_cluster]
        row = np.repeat(row, counts)
        placed = np.einsum("kij,kj->ki", rotation[row], looked_at) + origin[row]
        np.minimum.at(nearest, row, self._terrain.surface.distance(placed))
        return np.minimum(nearest, np.where(nearest <= within, np.inf, least.min(axis=1)))

    @cached_property
    def _clusters(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The points (n, 3) by cubes of `CLUSTER`, the one nearest to its middle first.

        Beside them where each cube begins, its number of points, and its radius about the first, all (C,).
        """
        points = surface_points(self._shape.points)
        cubes = np.floor(points / CLUSTER)
        away = np.linalg.norm(points - CLUSTER * (cubes + 0.5), axis=1)
        order = np.lexsort((away, *cubes.T))
        points, cubes = points[order], cubes[order]
        starts = np.flatnonzero(np.r_[True, (np.diff(cubes, axis=0) != 0).any(axis=1)])
        sizes = np.diff(np.r_[starts, len(points)])
        radii = np.linalg.norm(points - np.repeat(points[starts], sizes, axis=0), axis=1)
        return points, starts, sizes, np.maximum.reduceat(radii, starts)

    def witness(self, place: Placements) -> Witness:
        """Nearest points at one placement (1, 3, 3), (1, 3), on the tangent plane under the shape's."""
        points = place[1] + self._clusters[0] @ place[0][0].T
        surface = self._terrain.surface
        nearest = points[int(np.argmin(surface.distance(points)))]
        plane = surface.plane_at(nearest)
        return _over(nearest, self._shape.radius, plane.normal, plane.height)

    def solid(self, witness: Witness) -> PlacedBody:
        """What lies below the tangent plane at the nearest point."""
        return PlacedBody(normal=witness.normal, height=float(witness.normal @ witness.second_point))


def _over(point: np.ndarray, radius: float, normal: np.ndarray, offset: float) -> Witness:
    """Of a ball around a ``point`` (3,) and a plane."""
    distance = float(normal @ point) - offset - radius
    first = point - radius * normal
    return Witness(
        distance=distance, normal=normal, first_point=first, second_point=first - distance * normal
    )


def surface_points(points: np.ndarray) -> np.ndarray:
    """The ``points`` (n, 3) m of a hull and others on its edges and faces, at most `SPACING` apart."""
    if len(points) == 1:
        return points
    if len(points) == 2:
        steps = int(np.ceil(np.linalg.norm(points[1] - points[0]) / SPACING))
        share = np.linspace(0.0, 1.0, max(steps, 1) + 1)[:, None]
        return np.asarray(points[0] + share * (points[1] - points[0]))
    hull = convex_hull(thick(points))
    parts = [_on_triangle(corners) for corners in hull.corners[hull.triangles]]
    return np.unique(np.round(np.concatenate(parts), 9), axis=0)


def _on_triangle(corners: np.ndarray) -> np.ndarray:
    longest = float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).max())
    steps = max(int(np.ceil(longest / SPACING)), 1)
    weights = [(i, j, steps - i - j) for i in range(steps + 1) for j in range(steps + 1 - i)]
    return np.asarray(np.array(weights) / steps @ corners)
