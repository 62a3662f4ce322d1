"""Signed distances of a link's shape from smooth ground, for many placements at once."""

import math
from functools import cached_property

import numpy as np

from trajopt.collision.coal_shapes import Witness, thick
from trajopt.collision.shapes import LinkShape
from trajopt.terrain.bodies import convex_hull
from trajopt.terrain.smooth import SmoothTerrain

# Links high above smooth ground are skipped, assuming slopes of at most 45 degrees.
STEEPEST = math.sqrt(2.0)
# Points of a shape within a cube of this side, m, form a cluster.
CLUSTER = 0.08
# Distance between neighbouring points, m: over ground with a radius of curvature R the hull between them is
# nearer by at most SPACING^2 / (6 R), 0.7 mm at R = 0.1 m.
SPACING = 0.02


# Rotations (K, 3, 3) and origins (K, 3) m, world.
Placements = tuple[np.ndarray, np.ndarray]


class SmoothDistance:
    """Distance of one shape from ground z = h(x, y): the least over its `surface_points`.

    The distance of a point is from the tangent plane under it, (z - h) / sqrt(1 + |grad h|^2).
    """

    def __init__(self, shape: LinkShape, terrain: SmoothTerrain) -> None:
        self._shape, self._terrain = shape, terrain

    def distances(self, places: Placements, within: float) -> np.ndarray:
        """Return distances (K,) m at placements (K, 3, 3), (K, 3); only lower bounds beyond ``within``."""
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
        """Return the least distances (K,) of the points; only lower bounds beyond ``within``.

        Clusters that cannot contain the nearest point are skipped.
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
        """The points (n, 3) grouped by cubes of side `CLUSTER`, in each the one nearest to its centre first.

        Also the start, number of points, and radius about the first point of each cube, all (C,).
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
        """Return the nearest points at one placement (1, 3, 3), (1, 3), with the tangent plane under them."""
        points = place[1] + self._clusters[0] @ place[0][0].T
        surface = self._terrain.surface
        nearest = points[int(np.argmin(surface.distance(points)))]
        plane = surface.plane_at(nearest)
        return _over(nearest, self._shape.radius, plane.normal, plane.height)


def _over(point: np.ndarray, radius: float, normal: np.ndarray, offset: float) -> Witness:
    """Return the witness of a ball around a ``point`` (3,) and a plane."""
    distance = float(normal @ point) - offset - radius
    first = point - radius * normal
    return Witness(
        distance=distance, normal=normal, first_point=first, second_point=first - distance * normal
    )


def surface_points(points: np.ndarray) -> np.ndarray:
    """Return ``points`` (n, 3) m of a hull and others on its edges and faces, at most `SPACING` apart."""
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
