"""Distances of links from the ground, from obstacles and from each other, and the pairs that are near."""

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
import pinocchio as pin

from trajopt import _numeric
from trajopt.arguments import checked
from trajopt.collision.coal_shapes import Witness, coal_hull, coal_link, coal_obstacle, thicken
from trajopt.collision.planes import Approach, PlacedBody, nearest, nearest_along
from trajopt.collision.shapes import LinkShape, Obstacle, require_different_names
from trajopt.dynamics.model_content import frame_content
from trajopt.errors import InputError
from trajopt.terrain.bodies import GroundBody, HalfSpace, convex_hull, ground_bodies
from trajopt.terrain.smooth import SmoothTerrain
from trajopt.terrain.terrain import Terrain

# Links high above smooth ground are skipped, assuming slopes of at most 45 degrees.
SLOPE_FACTOR = math.sqrt(2.0)
# Points of a shape within a cube of this side, m, form a cluster.
CLUSTER = 0.08
# Distance between neighbouring points, m: over ground with a radius of curvature R the hull between them is
# nearer by at most SPACING^2 / (6 R), 0.7 mm at R = 0.1 m.
SPACING = 0.02


# Rotations (K, 3, 3) and origins (K, 3) m, world.
Placements = tuple[np.ndarray, np.ndarray]
# Names of two shapes; the second may be an obstacle or `GROUND`.
ShapePair = tuple[str, str]
GROUND = "ground"
# Displacements below this fraction of the largest count as zero.
FIXED = 1e-6
# If bodies overlap, their joints can separate them along a normal only if its component in the directions of
# their relative motion is at least this.
LEAST_SINE = 0.1


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
        distances = np.asarray(over / SLOPE_FACTOR - reach)
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
        least = over - SLOPE_FACTOR * radii
        least = np.where(least > 0, least / SLOPE_FACTOR, least)
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
    hull = convex_hull(thicken(points))
    parts = [_on_triangle(corners) for corners in hull.corners[hull.triangles]]
    return np.unique(np.round(np.concatenate(parts), 9), axis=0)


def _on_triangle(corners: np.ndarray) -> np.ndarray:
    longest = float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).max())
    steps = max(int(np.ceil(longest / SPACING)), 1)
    weights = [(i, j, steps - i - j) for i in range(steps + 1) for j in range(steps + 1 - i)]
    return np.asarray(np.array(weights) / steps @ corners)


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class CollisionScene:
    """Shapes on a model's links, obstacles and the ground, and pairs of shapes that must not touch.

    ``pairs`` combine every moving shape with the ground (if there is a ``terrain``) and with every obstacle;
    then follow ``self_pairs``, by name. Raises InputError for an unknown frame or name, or a duplicate name.
    """

    model: pin.Model
    shapes: tuple[LinkShape, ...]
    obstacles: tuple[Obstacle, ...] = ()
    self_pairs: tuple[ShapePair, ...] = ()
    terrain: Terrain | None = None

    def __post_init__(self) -> None:
        names = [shape.name for shape in self.shapes]
        require_different_names("shapes", [GROUND, *names, *(obstacle.name for obstacle in self.obstacles)])
        for shape in self.shapes:
            frame_content(self.model, shape.frame)
        for pair in self.self_pairs:
            unknown = [name for name in pair if name not in names]
            if unknown or pair[0] == pair[1]:
                raise InputError(f"a pair of shapes is {pair}", f"two of: {', '.join(names)}")

    @cached_property
    def pairs(self) -> tuple[ShapePair, ...]:
        """All pairs in the order of ``distances``: with the ground, with obstacles, between links."""
        ground = [] if self.terrain is None else [(shape.name, GROUND) for shape in self.moving]
        outer = [(shape.name, o.name) for shape in self.moving for o in self.obstacles]
        return (*ground, *outer, *self.self_pairs)

    @cached_property
    def moving(self) -> tuple[LinkShape, ...]:
        """The shapes that are not fixed to the world."""
        frames = self.model.frames
        return tuple(s for s in self.shapes if frames[self.model.getFrameId(s.frame)].parentJoint > 0)

    @property
    def n_ground(self) -> int:
        """Number of pairs with the ground, which come first."""
        return 0 if self.terrain is None else len(self.moving)

    @property
    def n_outer(self) -> int:
        """Number of pairs with the ground or an obstacle, which come first."""
        return self.n_ground + len(self.moving) * len(self.obstacles)

    def distances(self, configurations: np.ndarray, within: float | np.ndarray = np.inf) -> np.ndarray:
        """Return signed distances (K, n_pairs) in m at configurations (K, nq); negative in penetration.

        For pairs farther apart than ``within`` m, a number or (n_pairs,), the result may be a lower bound
        that is > ``within``.
        """
        q = np.atleast_2d(np.asarray(configurations, dtype=float))
        limits = np.broadcast_to(np.asarray(within, dtype=float), len(self.pairs))
        distances = np.empty((len(q), len(self.pairs)))
        listed, counts = self._listed
        if listed:
            each = self._bodies.distances(q, listed, np.repeat(limits, counts))
            starts = np.cumsum(counts) - counts
            distances[:, counts > 0] = np.minimum.reduceat(each, starts[counts > 0], axis=1)
        rotation, origin = self._placements(q) if self._smooth else (q, q)
        for column, (index, ground) in enumerate(self._smooth):
            places = rotation[index], origin[index]
            distances[:, column] = ground.distances(places, float(limits[column]))
        return distances

    def distances_at(self, q: np.ndarray) -> np.ndarray:
        """Return signed distances (n_pairs,) in m at one configuration (nq,); results are cached."""
        return self._distances_of(np.asarray(q, dtype=float).tobytes())

    @cached_property
    def _distances_of(self) -> Callable[[bytes], np.ndarray]:
        return cache(lambda numbers: self.distances(np.frombuffer(numbers))[0])

    def witness(self, q: np.ndarray, pair: ShapePair) -> Witness:
        """Return distance, normal and nearest points of a pair at ``q`` (nq,), also in penetration.

        Raises InputError for a pair that is not in the scene.
        """
        if pair not in self.pairs:
            raise InputError(f"the scene has no pair {pair}", "allowed: pairs of the scene")
        number, configurations = self.pairs.index(pair), np.atleast_2d(np.asarray(q, dtype=float))
        if not self._members[number]:
            index, ground = self._smooth[number]
            rotation, origin = self._placements(configurations)
            return ground.witness((rotation[index], origin[index]))
        members = [(0, member) for member in self._members[number]]
        return min(self._witnesses(configurations, members), key=lambda witness: witness.distance)

    def approaches(
        self, configurations: np.ndarray, wanted: Sequence[tuple[int, ShapePair]], within: float
    ) -> list[list[Approach]]:
        """Return the approaches of bodies for each wanted (row of the configurations (K, nq), pair).

        Two bodies have one approach. With piecewise ground there is one for each of its bodies within
        ``within`` m, or for the nearest one.
        """
        q = np.atleast_2d(np.asarray(configurations, dtype=float))
        places, numbers = self._placements(q), {pair: number for number, pair in enumerate(self.pairs)}
        rows = [(row, numbers[pair]) for row, pair in wanted]
        members = [(row, member) for row, number in rows for member in self._members[number]]
        witnesses, by_pair = iter(self._witnesses(q, members)), []
        for row, number in rows:
            here = places[0][:, row], places[1][:, row]
            approaches = [self._approach(*pair, next(witnesses), here) for pair in self._members[number]]
            if not approaches:
                index, ground = self._smooth[number]
                witness = ground.witness((places[0][index, row : row + 1], places[1][index, row : row + 1]))
                tangent = HalfSpace(
                    normal=witness.normal, offset=float(witness.normal @ witness.second_point)
                )
                approaches = [nearest(self._placed(index, here), _of_ground(tangent), witness.normal)]
            reach = max(within, min(approach.distance for approach in approaches))
            by_pair.append([approach for approach in approaches if approach.distance <= reach])
        return by_pair

    def _approach(self, first: int, second: int, witness: Witness, places: Placements) -> Approach:
        """Return the approach of two bodies, given placements (n, 3, 3), (n, 3) of all frames."""
        one, other = self._placed(first, places), self._placed(second, places)
        if witness.distance < 0 and second < len(self.shapes) + len(self.obstacles):
            ways = places[0][first] @ self._ways(first, second)
            if np.linalg.norm(witness.normal @ ways) < LEAST_SINE:
                return nearest_along(one, other, ways)
        return nearest(one, other, witness.normal)

    def _placed(self, index: int, places: Placements) -> PlacedBody:
        every = (*self.shapes, *self.obstacles)
        if index >= len(every):
            return _of_ground(self._grounds[index - len(every)])
        return PlacedBody(
            frame=self.shapes[index].frame if index < len(self.shapes) else None,
            points=every[index].points,
            radius=every[index].radius,
            rotation=places[0][index],
            position=places[1][index],
        )

    def _ways(self, first: int, second: int) -> np.ndarray:
        """Return orthonormal directions (3, r) of the relative motion of two bodies, in the first one's axes.

        If all joints between them turn about parallel axes, they move in a plane and r = 2.
        """
        model, data = self.model, self.model.createData()
        frames = [shape.frame for shape in self.shapes] + ["universe"] * len(self.obstacles)
        axes = pin.computeJointJacobians(model, data, pin.neutral(model)).T
        pin.updateFramePlacements(model, data)
        joints = joints_between(model, frames[first], frames[second])
        moved = [axes[model.idx_vs[joint] :][: model.nvs[joint]] for joint in joints]
        return np.asarray(
            data.oMf[model.getFrameId(frames[first])].rotation.T @ _motion_directions(np.vstack(moved))
        )

    def least_distances(self, configurations: Iterable[np.ndarray], within: float = np.inf) -> np.ndarray:
        """Return the least signed distance (n,) m of each pair over configurations (nq,); inf if none."""
        listed = np.array(list(configurations), dtype=float)
        if not len(listed) or not self.pairs:
            return np.full(len(self.pairs), np.inf)
        return np.asarray(self.distances(listed, within).min(axis=0))

    def near(self, configurations: Iterable[np.ndarray], within: float) -> tuple[ShapePair, ...]:
        """Return the pairs that come closer than ``within`` m at any of the configurations (nq,)."""
        least = self.least_distances(configurations, within)
        return tuple(pair for pair, distance in zip(self.pairs, least, strict=True) if distance < within)

    def _placements(self, q: np.ndarray) -> Placements:
        """Return rotations (n, K, 3, 3) and origins (n, K, 3) m of the frames of all bodies."""
        rows = self._bodies.placements(q).reshape(len(q), -1, 12).swapaxes(0, 1)
        return rows[..., :9].reshape(*rows.shape[:2], 3, 3), rows[..., 9:]

    def _witnesses(self, q: np.ndarray, members: Sequence[tuple[int, tuple[int, int]]]) -> list[Witness]:
        """Return the witnesses of pairs of bodies, each given with a row of the configurations (K, nq)."""
        rows, pairs = [row for row, _ in members], [pair for _, pair in members]
        return [
            Witness(distance=float(each[0]), normal=each[1:4], first_point=each[4:7], second_point=each[7:])
            for each in self._bodies.witnesses(q, rows, pairs)
        ]

    @cached_property
    def _bodies(self) -> _numeric.Bodies:
        """All bodies: shapes, obstacles, and bodies of the ground."""
        bodies, none, still = _numeric.Bodies(self.model), np.zeros((0, 4)), np.eye(3, 4)
        for body in (*self.shapes, *self.obstacles):
            solid, place = coal_link(body) if isinstance(body, LinkShape) else coal_obstacle(body)
            frame = self.model.getFrameId(body.frame) if isinstance(body, LinkShape) else -1
            bodies.add(solid, frame, place.homogeneous[:3], body.points, body.radius, none)
        for ground in self._grounds:
            points = np.zeros((0, 3)) if isinstance(ground, HalfSpace) else ground.points
            solid = coal_hull(points) if len(points) else None
            bodies.add(solid, -1, still, points, 0.0, np.column_stack(ground.planes))
        return bodies

    @cached_property
    def _members(self) -> list[list[tuple[int, int]]]:
        """Indices of the bodies of each pair, with the ground one entry per ground body: none if smooth."""
        names = [*(shape.name for shape in self.shapes), *(obstacle.name for obstacle in self.obstacles)]
        place = {name: index for index, name in enumerate(names)}
        under = range(len(names), len(names) + len(self._grounds))
        members = [[(place[shape], ground) for ground in under] for shape, _ in self.pairs[: self.n_ground]]
        return members + [[(place[one], place[other])] for one, other in self.pairs[self.n_ground :]]

    @cached_property
    def _listed(self) -> tuple[list[tuple[int, int]], np.ndarray]:
        """All of `_members` in one list, and the number (n_pairs,) of each pair's."""
        counts = np.array([len(members) for members in self._members], dtype=int)
        return list(itertools.chain.from_iterable(self._members)), counts

    @cached_property
    def _grounds(self) -> tuple[GroundBody, ...]:
        """Bodies of the ground; none if it is smooth."""
        terrain = self.terrain
        return () if terrain is None or isinstance(terrain, SmoothTerrain) else ground_bodies(terrain)

    @cached_property
    def _smooth(self) -> list[tuple[int, SmoothDistance]]:
        """The shape's index and its distances for each pair with smooth ground."""
        if not isinstance(self.terrain, SmoothTerrain):
            return []
        return [(self.shapes.index(shape), SmoothDistance(shape, self.terrain)) for shape in self.moving]


def _of_ground(body: GroundBody) -> PlacedBody:
    if isinstance(body, HalfSpace):
        return PlacedBody(normal=body.normal, height=body.offset)
    return PlacedBody(points=body.points, sides=body.planes[0])


def separable_pairs(
    model: pin.Model, shapes: Sequence[LinkShape], q: np.ndarray, margin: float
) -> tuple[ShapePair, ...]:
    """Return the pairs of shapes that can be kept apart by ``margin`` m: those farther apart at ``q`` (nq,).

    Pairs on one link or on links connected by a joint are left out, and so are those that are nearer at
    ``q``, because shapes may be wider than what they enclose.
    """

    def joined(first: LinkShape, second: LinkShape) -> bool:
        one, other = (int(model.frames[model.getFrameId(s.frame)].parentJoint) for s in (first, second))
        return one == other or model.parents[one] == other or model.parents[other] == one

    pairs = tuple(
        (first.name, second.name)
        for first, second in itertools.combinations(shapes, 2)
        if not joined(first, second)
    )
    scene = CollisionScene(model=model, shapes=tuple(shapes), self_pairs=pairs)
    distances = scene.distances(q)[0]
    return tuple(pair for pair, distance in zip(pairs, distances, strict=True) if distance > margin)


def _motion_directions(axes: np.ndarray) -> np.ndarray:
    """Return orthonormal directions (3, r) of all displacements by joints with these axes (n, 6).

    A direction is left out if every rotation axis is parallel to it and no joint translates along it.
    """
    rows = np.vstack([axes[:, :3], *(pin.skew(axis) for axis in axes[:, 3:])])
    _, sizes, directions = np.linalg.svd(rows)
    return np.asarray(directions[: int((sizes > FIXED * sizes.max()).sum())].T)


def joints_between(model: pin.Model, first: str, second: str) -> tuple[int, ...]:
    """Return the indices of the joints between the links of two frames."""
    carriers = (model.frames[model.getFrameId(frame)].parentJoint for frame in (first, second))
    one, other = (set(model.supports[joint].tolist()) for joint in carriers)
    return tuple(sorted(one ^ other))
