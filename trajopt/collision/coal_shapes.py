"""Convert shapes to Coal geometry; the nearest points of two bodies."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from trajopt.collision.shapes import BoxObstacle, LinkShape, Obstacle
from trajopt.terrain.surface import frame_of_normal

# Thickness to either side, m, of hulls without volume, since Coal's penetration depths need one.
THICKNESS = 1e-6
# Size of the cache of hulls, since scenes of one robot are created repeatedly.
MOST_HULLS = 1024


def segment_placement(start: np.ndarray, end: np.ndarray) -> pin.SE3:
    """Return the placement of a Coal capsule (along z, centred) on a segment."""
    along = end - start
    length = float(np.linalg.norm(along))
    turn = frame_of_normal(along / length) if length > 0 else np.eye(3)
    return pin.SE3(turn, (start + end) / 2)


def coal_capsule(start: np.ndarray, end: np.ndarray, radius: float) -> tuple[Any, pin.SE3]:
    """Return a Coal capsule and its placement; a sphere if the segment has no length."""
    length = float(np.linalg.norm(end - start))
    shape = coal.Capsule(radius, length) if length > 0 else coal.Sphere(radius)
    return shape, segment_placement(start, end)


def coal_obstacle(obstacle: Obstacle) -> tuple[Any, pin.SE3]:
    """Return the Coal shape of an obstacle and its placement in the world."""
    if isinstance(obstacle, BoxObstacle):
        return coal.Box(*obstacle.sides.tolist()), pin.SE3(obstacle.turn, obstacle.position)
    return coal_capsule(*obstacle.axis, obstacle.radius)


def coal_link(shape: LinkShape) -> tuple[Any, pin.SE3]:
    """Return the Coal shape of a link and its placement in the link's frame."""
    if len(shape.points) <= 2:
        return coal_capsule(*shape.axis, shape.radius)
    edges = shape.box_axes
    if edges is not None:
        lengths = np.linalg.norm(edges, axis=1)
        turn = (edges / lengths[:, None]).T
        if np.linalg.det(turn) < 0:
            turn[:, 2] *= -1
        return coal.Box(*lengths.tolist()), pin.SE3(turn, shape.points.mean(axis=0))
    return coal_hull(shape.points, shape.radius), pin.SE3.Identity()


def coal_hull(points: np.ndarray, radius: float = 0.0) -> Any:
    """Return the Coal convex hull of points (n, 3) m, swept with a sphere of ``radius`` m.

    Points in a plane or on a line get the thickness `THICKNESS`. Equal hulls are the same object.
    """
    return _hull_once(np.asarray(points, dtype=float).tobytes(), float(radius))


@lru_cache(maxsize=MOST_HULLS)
def _hull_once(numbers: bytes, radius: float) -> Any:
    listed = coal.StdVec_Vec3s()
    for point in thicken(np.frombuffer(numbers).reshape(-1, 3)):
        listed.append(point)
    hull = coal.Convex.convexHull(listed, True, "Qt")
    if radius > 0:
        hull.setSweptSphereRadius(radius)
    return hull


def thicken(points: np.ndarray) -> np.ndarray:
    """Return points (n, 3) m of a hull, moved apart by `THICKNESS` along axes without extent."""
    away = points - points.mean(axis=0)
    _, axes = np.linalg.eigh(away.T @ away)
    for axis in axes.T:
        if np.ptp(away @ axis) <= THICKNESS:
            points = np.concatenate([points + THICKNESS * axis, points - THICKNESS * axis])
    return points


@dataclass(frozen=True, kw_only=True, eq=False)
class Witness:
    """The nearest points of two bodies, or the shortest way out of a penetration.

    Attributes:
        distance: Signed distance, m: the least height of the first body along the normal minus the greatest
            of the second. It is exact for this normal, which Coal gives to 1e-5 where faces touch.
        normal: Unit normal (3,), world, from the second body to the first.
        first_point, second_point: Nearest points (3,) m, world; first_point = second_point + distance normal.
    """

    distance: float
    normal: np.ndarray
    first_point: np.ndarray
    second_point: np.ndarray
