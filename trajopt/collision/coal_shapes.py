"""Shapes as Coal has them: their signed distances and nearest points."""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from trajopt.collision.shapes import BoxObstacle, LinkShape, Obstacle
from trajopt.dynamics.joint_placements import Placements
from trajopt.terrain.surface import frame_of_normal

# Thickness to either side, m, of hulls that have no volume: Coal's depths need one.
THICKNESS = 1e-6
# Hulls that are kept: scenes of one robot are made again and again.
MOST_HULLS = 1024
# Every so many configurations Coal gives a normal that bounds the distances of those around it.
STRIDE = 8


def segment_placement(start: np.ndarray, end: np.ndarray) -> pin.SE3:
    """Placement of a Coal capsule (along z, about its middle) on a segment."""
    along = end - start
    length = float(np.linalg.norm(along))
    turn = frame_of_normal(along / length) if length > 0 else np.eye(3)
    return pin.SE3(turn, (start + end) / 2)


def coal_capsule(start: np.ndarray, end: np.ndarray, radius: float) -> tuple[Any, pin.SE3]:
    """Coal's capsule and its placement; a sphere where the segment has no length."""
    length = float(np.linalg.norm(end - start))
    shape = coal.Capsule(radius, length) if length > 0 else coal.Sphere(radius)
    return shape, segment_placement(start, end)


def coal_obstacle(obstacle: Obstacle) -> tuple[Any, pin.SE3]:
    """Coal's shape of an obstacle and its placement in the world."""
    if isinstance(obstacle, BoxObstacle):
        return coal.Box(*obstacle.sides.tolist()), pin.SE3(obstacle.turn, obstacle.position)
    return coal_capsule(*obstacle.axis, obstacle.radius)


def coal_link(shape: LinkShape) -> tuple[Any, pin.SE3]:
    """Coal's shape of a link and its placement in the link's frame."""
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
    """Coal's convex hull of points (n, 3) m with a ball of ``radius`` m about each of its points.

    Points in a plane or on a line get the thickness `THICKNESS`. Equal hulls are one object.
    """
    return _hull_once(np.asarray(points, dtype=float).tobytes(), float(radius))


@lru_cache(maxsize=MOST_HULLS)
def _hull_once(numbers: bytes, radius: float) -> Any:
    listed = coal.StdVec_Vec3s()
    for point in thick(np.frombuffer(numbers).reshape(-1, 3)):
        listed.append(point)
    hull = coal.Convex.convexHull(listed, True, "Qt")
    if radius > 0:
        hull.setSweptSphereRadius(radius)
    return hull


def thick(points: np.ndarray) -> np.ndarray:
    """Points (n, 3) m of a hull, moved apart by `THICKNESS` where it has no volume."""
    away = points - points.mean(axis=0)
    _, axes = np.linalg.eigh(away.T @ away)
    for axis in axes.T:
        if np.ptp(away @ axis) <= THICKNESS:
            points = np.concatenate([points + THICKNESS * axis, points - THICKNESS * axis])
    return points


@dataclass(frozen=True, kw_only=True, eq=False)
class Witness:
    """Where two bodies are nearest, or the shortest way out of each other.

    normal: (3,) world, unit, from the second body to the first. distance: signed, m: the least height of the
    first body along the normal minus the greatest of the second, exactly: where faces touch, Coal's normal is
    exact to 1e-5 and so is this. first_point, second_point: (3,) m, world, on the surfaces, first_point =
    second_point + distance normal to the same accuracy.
    """

    distance: float
    normal: np.ndarray
    first_point: np.ndarray
    second_point: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class CoalBody:
    """All within ``radius`` m of the hull of ``points`` (n, 3) on a frame: Coal's body, placed in it."""

    solid: Any
    place: pin.SE3
    points: np.ndarray
    radius: float


@dataclass(frozen=True)
class CoalPairs:
    """Bodies on frames; a pair of them is given by two indices."""

    bodies: list[CoalBody]
    _functions: dict[tuple[int, int], Any] = field(default_factory=dict, init=False)

    def distances(
        self, pair: tuple[int, int], first: Placements, second: Placements, within: float = np.inf
    ) -> np.ndarray:
        """Signed distances (k,) m of a pair whose frames are at these placements (k, 3, 3), (k, 3).

        Of bodies farther apart than ``within`` m it may be a lower bound instead, which is > ``within``:
        neighbours in time have almost the same normal, and how far apart the bodies are along it is a bound.
        """
        count = len(first[0])
        distances, leaders = np.empty(count), np.arange(0, count, STRIDE)
        distances[leaders], normals = self._measured(pair, first, second, leaders)
        rest = np.flatnonzero(np.arange(count) % STRIDE)
        if not len(rest):
            return distances
        hint = np.minimum((rest + STRIDE // 2) // STRIDE, len(leaders) - 1)
        held = np.einsum("kji,kj->ki", first[0][leaders], normals)[hint]
        distances[rest] = self._apart(
            pair, (first[0][rest], first[1][rest]), (second[0][rest], second[1][rest]), held
        )
        near = rest[~(distances[rest] > within)]
        if len(near):
            distances[near], _ = self._measured(pair, first, second, near)
        return distances

    def _apart(
        self, pair: tuple[int, int], first: Placements, second: Placements, normals: np.ndarray
    ) -> np.ndarray:
        """How far apart (k,) m bodies are along ``normals`` (k, 3) in the axes of the first's frame."""
        one, other = (self.bodies[index] for index in pair)
        world = np.einsum("kij,kj->ki", first[0], normals)
        back = -np.einsum("kji,kj->ki", second[0], world)
        between = np.sum((first[1] - second[1]) * world, axis=1) - one.radius - other.radius
        return np.asarray(
            between + (normals @ one.points.T).min(axis=1) + (back @ other.points.T).min(axis=1)
        )

    def _measured(
        self, pair: tuple[int, int], first: Placements, second: Placements, rows: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Distances (n,) m and normals (n, 3) from the second to the first, world, of some rows."""
        measure, request, result = self._function(pair), coal.DistanceRequest(), coal.DistanceResult()
        one, other = coal.Transform3s(), coal.Transform3s()
        places = [
            self._placed(index, (frame[0][rows], frame[1][rows]))
            for index, frame in zip(pair, (first, second), strict=True)
        ]
        distances, normals = np.empty(len(rows)), np.empty((len(rows), 3))
        for k, (a, b, c, d) in enumerate(zip(*places[0], *places[1], strict=True)):
            one.setTransform(a, b)
            other.setTransform(c, d)
            result.clear()
            distances[k] = measure(one, other, request, result)
            normals[k] = result.normal
        return distances, -normals

    def witness(self, pair: tuple[int, int], first: Placements, second: Placements) -> Witness:
        """Nearest points of a pair whose frames are at one placement (1, 3, 3), (1, 3) each."""
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        places = [self._placed(index, frame) for index, frame in zip(pair, (first, second), strict=True)]
        one, other = (coal.Transform3s(turn[0], origin[0]) for turn, origin in places)
        self._function(pair)(one, other, request, result)
        normal = -np.array(result.normal)
        held = (first[0][0].T @ normal)[None]
        return Witness(
            distance=float(self._apart(pair, first, second, held)[0]),
            normal=normal,
            first_point=np.array(result.getNearestPoint1()),
            second_point=np.array(result.getNearestPoint2()),
        )

    def _function(self, pair: tuple[int, int]) -> Any:
        """Coal's function of a pair, which finds the algorithm for its kinds once."""
        if pair not in self._functions:
            self._functions[pair] = coal.ComputeDistance(*(self.bodies[index].solid for index in pair))
        return self._functions[pair]

    def _placed(self, index: int, frame: Placements) -> Placements:
        place = self.bodies[index].place
        return frame[0] @ place.rotation, frame[1] + frame[0] @ place.translation
