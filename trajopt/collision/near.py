"""Distances of links from the ground, from obstacles and from each other, and which pairs are near."""

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
import pinocchio as pin

from trajopt.arguments import checked
from trajopt.collision.coal_shapes import CoalBody, CoalPairs, Witness, coal_link, coal_obstacle
from trajopt.collision.ground_distance import BodyDistance, SmoothDistance
from trajopt.collision.planes import Approach, PlacedBody, nearest, nearest_along
from trajopt.collision.shapes import LinkShape, Obstacle, ball_around, require_different_names
from trajopt.dynamics.joint_placements import Placements, joint_placements
from trajopt.dynamics.model_content import frame_content
from trajopt.errors import InputError
from trajopt.terrain.bodies import ground_bodies
from trajopt.terrain.smooth import SmoothTerrain
from trajopt.terrain.terrain import Terrain

# Two shapes by their names; the second may be an obstacle's, or `GROUND`.
ShapePair = tuple[str, str]
GROUND = "ground"
# Displacements below this part of the largest are none.
FIXED = 1e-6
# Where bodies overlap a normal with less than this of it along the ways in which they pass each other is none
# along which their joints can part them.
STEEP = 0.1


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class CollisionScene:
    """Shapes on a model's links, obstacles and the ground, and pairs of shapes that must not touch.

    ``pairs`` are every shape that moves with the ground (if there is a ``terrain``) and with every obstacle,
    then ``self_pairs``, by name. Raises InputError for an unknown frame or name, or a name used twice.
    """

    model: pin.Model
    shapes: tuple[LinkShape, ...]
    obstacles: tuple[Obstacle, ...] = ()
    self_pairs: tuple[ShapePair, ...] = ()
    terrain: Terrain | None = None

    def __post_init__(self) -> None:
        for name in ("shapes", "obstacles"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        object.__setattr__(self, "self_pairs", tuple((str(a), str(b)) for a, b in self.self_pairs))
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
        """All pairs, in the order of ``distances``: with the ground, with obstacles, of links."""
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
        """Number of leading pairs that are of a shape with the ground."""
        return 0 if self.terrain is None else len(self.moving)

    @property
    def n_outer(self) -> int:
        """Number of leading pairs that are of a shape with the ground or an obstacle."""
        return self.n_ground + len(self.moving) * len(self.obstacles)

    def distances(self, configurations: np.ndarray, within: float | np.ndarray = np.inf) -> np.ndarray:
        """Signed distances (K, n_pairs) in m at configurations (K, nq); negative: how deep they penetrate.

        Of a pair farther apart than ``within`` m, of all pairs or of each (n_pairs,), it may be a lower bound
        instead, which is > ``within``.
        """
        q = np.atleast_2d(np.asarray(configurations, dtype=float))
        limits = np.broadcast_to(np.asarray(within, dtype=float), len(self.pairs))
        rotation, origin = self._placements(q)
        distances = np.empty((len(q), len(self.pairs)))
        for column, (index, bodies) in enumerate(self._grounds):
            places = rotation[index], origin[index]
            limit = float(limits[column])
            distances[:, column] = np.min([body.distances(places, limit) for body in bodies], axis=0)
        if len(self.pairs) > self.n_ground:
            apart, limits = self._apart(rotation, origin), limits[self.n_ground :]
            near = apart <= limits
            for pair in np.flatnonzero(near.any(axis=0)):
                rows = np.flatnonzero(near[:, pair])
                first, second = (int(part[pair]) for part in self._indices)
                one, other = ((rotation[i][rows], origin[i][rows]) for i in (first, second))
                apart[rows, pair] = self._coal.distances((first, second), one, other, float(limits[pair]))
            distances[:, self.n_ground :] = apart
        return distances

    def distances_at(self, q: np.ndarray) -> np.ndarray:
        """Signed distances (n_pairs,) in m at one configuration (nq,), kept for the next time."""
        return self._distances_of(np.asarray(q, dtype=float).tobytes())

    @cached_property
    def _distances_of(self) -> Callable[[bytes], np.ndarray]:
        return cache(lambda numbers: self.distances(np.frombuffer(numbers))[0])

    def witness(self, q: np.ndarray, pair: ShapePair) -> Witness:
        """Distance, normal and nearest points of a pair at ``q`` (nq,), also where they touch or penetrate.

        Raises InputError for a pair that is not in the scene.
        """
        if pair not in self.pairs:
            raise InputError(f"the scene has no pair {pair}", "allowed: pairs of the scene")
        index = self.pairs.index(pair)
        rotation, origin = self._placements(np.atleast_2d(q))
        if index < self.n_ground:
            shape, bodies = self._grounds[index]
            witnesses = [body.witness((rotation[shape], origin[shape])) for body in bodies]
            return min(witnesses, key=lambda witness: witness.distance)
        first, second = (int(part[index - self.n_ground]) for part in self._indices)
        places = ((rotation[i], origin[i]) for i in (first, second))
        return self._coal.witness((first, second), *places)

    def approaches(
        self, configurations: np.ndarray, wanted: Sequence[tuple[int, ShapePair]], within: float
    ) -> list[list[Approach]]:
        """How bodies approach each other, for each wanted (row of the configurations (K, nq), pair).

        Of two bodies one approach; with ground of several faces one for each within ``within`` m, or for the
        nearest one.
        """
        rotation, origin = self._placements(np.atleast_2d(configurations))
        numbers = {pair: number for number, pair in enumerate(self.pairs)}
        by_pair = []
        for row, pair in wanted:
            here = slice(row, row + 1)
            places = [(turn[here], at[here]) for turn, at in zip(rotation, origin, strict=True)]
            approaches = self._approaches(numbers[pair], places)
            reach = max(within, min(approach.distance for approach in approaches))
            by_pair.append([approach for approach in approaches if approach.distance <= reach])
        return by_pair

    def _approaches(self, number: int, places: Sequence[Placements]) -> list[Approach]:
        def placed(index: int) -> PlacedBody:
            body, (rotation, origin) = (*self.shapes, *self.obstacles)[index], places[index]
            return PlacedBody(
                frame=body.frame if isinstance(body, LinkShape) else None,
                points=body.points,
                radius=body.radius,
                rotation=rotation[0],
                position=origin[0],
            )

        if number < self.n_ground:
            shape, bodies = self._grounds[number]
            seen = [(ground, ground.witness(places[shape])) for ground in bodies]
            pairs = [(placed(shape), ground.solid(witness), witness) for ground, witness in seen]
        else:
            first, second = (int(part[number - self.n_ground]) for part in self._indices)
            witness = self._coal.witness((first, second), places[first], places[second])
            if witness.distance < 0:
                ways = places[first][0][0] @ self._ways(first, second)
                if np.linalg.norm(witness.normal @ ways) < STEEP:
                    return [nearest_along(placed(first), placed(second), ways)]
            pairs = [(placed(first), placed(second), witness)]
        return [nearest(first, second, witness.normal) for first, second, witness in pairs]

    def _ways(self, first: int, second: int) -> np.ndarray:
        """Directions (3, r), orthonormal, in which two bodies pass each other, in the axes of the first one.

        They move in a plane, r = 2, where all joints between them turn about parallel axes.
        """
        model, data = self.model, self.model.createData()
        frames = [shape.frame for shape in self.shapes] + ["universe"] * len(self.obstacles)
        axes = pin.computeJointJacobians(model, data, pin.neutral(model)).T
        pin.updateFramePlacements(model, data)
        joints = joints_between(model, frames[first], frames[second])
        moved = [axes[model.idx_vs[joint] :][: model.nvs[joint]] for joint in joints]
        return np.asarray(data.oMf[model.getFrameId(frames[first])].rotation.T @ _passing(np.vstack(moved)))

    def least_distances(self, configurations: Iterable[np.ndarray], within: float = np.inf) -> np.ndarray:
        """Least signed distance in m of each pair (n,) over configurations (nq,); inf without any."""
        listed = np.array(list(configurations), dtype=float)
        if not len(listed) or not self.pairs:
            return np.full(len(self.pairs), np.inf)
        return np.asarray(self.distances(listed, within).min(axis=0))

    def near(self, configurations: Iterable[np.ndarray], within: float) -> tuple[ShapePair, ...]:
        """Pairs that come closer than ``within`` m at one of the configurations (nq,)."""
        least = self.least_distances(configurations, within)
        return tuple(pair for pair, distance in zip(self.pairs, least, strict=True) if distance < within)

    def _placements(self, q: np.ndarray) -> Placements:
        """Rotations (n, K, 3, 3) and origins (n, K, 3) of the shapes' frames, then of the obstacles: zero."""
        joints, origins = joint_placements(self.model, q)
        count = len(self.shapes) + len(self.obstacles)
        rotation, origin = np.empty((count, len(q), 3, 3)), np.zeros((count, len(q), 3))
        rotation[len(self.shapes) :] = np.eye(3)
        for index, shape in enumerate(self.shapes):
            frame = self.model.frames[self.model.getFrameId(shape.frame)]
            joint, place = int(frame.parentJoint), frame.placement
            rotation[index] = joints[joint] @ place.rotation
            origin[index] = origins[joint] + joints[joint] @ place.translation
        return rotation, origin

    def _apart(self, rotation: np.ndarray, origin: np.ndarray) -> np.ndarray:
        """Distances (K, n) m between the bounding balls of every pair that is not with the ground."""
        balls = self._balls
        centres = origin + np.einsum("nkij,nj->nki", rotation, balls[:, :3])
        across = np.moveaxis(centres, 0, 1)
        squares = np.sum(across**2, axis=-1)
        first, second = self._indices
        square = squares[:, first] + squares[:, second]
        square -= 2 * (across @ np.moveaxis(across, 1, 2))[:, first, second]
        return np.asarray(np.sqrt(np.maximum(square, 0.0)) - (balls[first, 3] + balls[second, 3]))

    @cached_property
    def _balls(self) -> np.ndarray:
        """Centre and radius (n, 4) m of a ball around each shape in its frame, and each obstacle."""
        balls = []
        for body in (*self.shapes, *self.obstacles):
            centre, reach = ball_around(body.points)
            balls.append([*centre, reach + body.radius])
        return np.array(balls).reshape(-1, 4)

    @cached_property
    def _indices(self) -> tuple[np.ndarray, np.ndarray]:
        """Of both bodies of every pair that is not with the ground: shapes, then obstacles."""
        names = [*(shape.name for shape in self.shapes), *(obstacle.name for obstacle in self.obstacles)]
        place = {name: index for index, name in enumerate(names)}
        listed = [(place[first], place[second]) for first, second in self.pairs[self.n_ground :]]
        indices = np.array(listed, dtype=int).reshape(-1, 2)
        return indices[:, 0], indices[:, 1]

    @cached_property
    def _coal(self) -> CoalPairs:
        solids = [coal_link(shape) for shape in self.shapes]
        solids += [coal_obstacle(obstacle) for obstacle in self.obstacles]
        bodies = zip(solids, (*self.shapes, *self.obstacles), strict=True)
        return CoalPairs(
            [CoalBody(solid=s, place=p, points=b.points, radius=b.radius) for (s, p), b in bodies]
        )

    @cached_property
    def _grounds(self) -> list[tuple[int, list[BodyDistance] | list[SmoothDistance]]]:
        """Of each pair with the ground, the shape's index and its distances from the bodies of the ground."""
        if self.terrain is None:
            return []
        moving = [(self.shapes.index(shape), shape) for shape in self.moving]
        if isinstance(self.terrain, SmoothTerrain):
            return [(index, [SmoothDistance(shape, self.terrain)]) for index, shape in moving]
        bodies = ground_bodies(self.terrain)
        return [(index, [BodyDistance(shape, body) for body in bodies]) for index, shape in moving]


def separable_pairs(
    model: pin.Model, shapes: Sequence[LinkShape], q: np.ndarray, margin: float
) -> tuple[ShapePair, ...]:
    """Pairs of shapes that can be kept apart by ``margin`` m: those that are that far apart at ``q`` (nq,).

    Left out are two shapes of one link, of links connected by a joint, and those that overlap at ``q``,
    because capsules are wider than what they enclose.
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


def _passing(axes: np.ndarray) -> np.ndarray:
    """Orthonormal directions (3, r) of all displacements that joints with these axes (n, 6) make.

    A direction is left out if every axis is parallel to it and no axis moves along it: a rotation about it
    keeps both so.
    """
    rows = np.vstack([axes[:, :3], *(pin.skew(axis) for axis in axes[:, 3:])])
    _, sizes, directions = np.linalg.svd(rows)
    return np.asarray(directions[: int((sizes > FIXED * sizes.max()).sum())].T)


def joints_between(model: pin.Model, first: str, second: str) -> tuple[int, ...]:
    """Joints between the links of two frames, by index."""
    carriers = (model.frames[model.getFrameId(frame)].parentJoint for frame in (first, second))
    one, other = (set(model.supports[joint].tolist()) for joint in carriers)
    return tuple(sorted(one ^ other))
