"""Coal's distances between capsules and obstacles: which pairs are near, and how near."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.dynamics.model_content import frame_content
from trajopt.errors import InputError
from trajopt.robot.collision.shapes import (
    LinkCapsule,
    Obstacle,
    coal_capsule,
    coal_obstacle,
    require_different_names,
)

# Two capsules, or a capsule and an obstacle, by their names.
ShapePair = tuple[str, str]


@dataclass(frozen=True, kw_only=True, eq=False)
class CollisionScene:
    """Capsules on a model, obstacles in the world, and pairs of capsules that must not touch.

    ``pairs`` are every capsule with every obstacle, then ``self_pairs``, by name. Raises InputError for an
    unknown frame or name, or a name used twice.
    """

    model: pin.Model
    capsules: tuple[LinkCapsule, ...]
    obstacles: tuple[Obstacle, ...] = ()
    self_pairs: tuple[ShapePair, ...] = ()

    def __post_init__(self) -> None:
        for name in ("capsules", "obstacles"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        object.__setattr__(self, "self_pairs", tuple((str(a), str(b)) for a, b in self.self_pairs))
        names = [capsule.name for capsule in self.capsules]
        require_different_names("shapes", names + [obstacle.name for obstacle in self.obstacles])
        for capsule in self.capsules:
            frame_content(self.model, capsule.frame)
        for pair in self.self_pairs:
            unknown = [name for name in pair if name not in names]
            if unknown or pair[0] == pair[1]:
                raise InputError(f"a pair of capsules is {pair}", f"two of: {', '.join(names)}")

    @property
    def pairs(self) -> tuple[ShapePair, ...]:
        """All pairs, in the order of ``distances``."""
        outer = [(c.name, o.name) for c in self.capsules for o in self.obstacles]
        return (*outer, *self.self_pairs)

    @property
    def n_outer(self) -> int:
        """Number of leading pairs that are of a capsule with an obstacle."""
        return len(self.capsules) * len(self.obstacles)

    @cached_property
    def _geometry(self) -> tuple[pin.GeometryModel, pin.GeometryData, pin.Data]:
        geometry, index = pin.GeometryModel(), {}
        for capsule in self.capsules:
            frame = self.model.frames[self.model.getFrameId(capsule.frame)]
            shape, placement = coal_capsule(capsule.start, capsule.end, capsule.radius)
            index[capsule.name] = _added(
                geometry, capsule.name, int(frame.parentJoint), frame.placement * placement, shape
            )
        for obstacle in self.obstacles:
            shape, placement = coal_obstacle(obstacle)
            index[obstacle.name] = _added(geometry, obstacle.name, 0, placement, shape)
        for first, second in self.pairs:
            geometry.addCollisionPair(pin.CollisionPair(index[first], index[second]))
        return geometry, geometry.createData(), self.model.createData()

    def distances(self, q: np.ndarray) -> np.ndarray:
        """Signed distance in m of each pair (n,) at ``q`` (nq,), by Coal; negative where they penetrate."""
        geometry, data, kinematics = self._geometry
        pin.computeDistances(self.model, kinematics, geometry, data, np.asarray(q, dtype=float))
        return np.array([result.min_distance for result in data.distanceResults])

    def least_distances(self, configurations: Iterable[np.ndarray]) -> np.ndarray:
        """Least signed distance in m of each pair (n,) over configurations (nq,); inf without any."""
        least = np.full(len(self.pairs), np.inf)
        for q in configurations:
            least = np.minimum(least, self.distances(q))
        return least

    def near(self, configurations: Iterable[np.ndarray], within: float) -> tuple[ShapePair, ...]:
        """Pairs that come closer than ``within`` m at one of the configurations (nq,)."""
        least = self.least_distances(configurations)
        return tuple(pair for pair, distance in zip(self.pairs, least, strict=True) if distance < within)

    def describe(self) -> dict[str, Any]:
        """JSON-able description for a solution file."""
        return {
            "capsules": [capsule.describe() for capsule in self.capsules],
            "obstacles": [obstacle.describe() for obstacle in self.obstacles],
            "self_pairs": [list(pair) for pair in self.self_pairs],
        }


def _added(geometry: pin.GeometryModel, name: str, joint: int, placement: pin.SE3, shape: Any) -> int:
    return int(geometry.addGeometryObject(pin.GeometryObject(name, joint, placement, shape)))


def separable_pairs(
    model: pin.Model, capsules: Sequence[LinkCapsule], q: np.ndarray, margin: float
) -> tuple[ShapePair, ...]:
    """Pairs of capsules that can be kept apart by ``margin`` m: those that are that far apart at ``q`` (nq,).

    Left out are two capsules of one link, of links connected by a joint, and those that overlap at ``q``,
    because capsules are wider than what they enclose.
    """

    def joined(first: LinkCapsule, second: LinkCapsule) -> bool:
        one, other = (int(model.frames[model.getFrameId(c.frame)].parentJoint) for c in (first, second))
        return one == other or model.parents[one] == other or model.parents[other] == one

    pairs = tuple(
        (first.name, second.name)
        for first, second in itertools.combinations(capsules, 2)
        if not joined(first, second)
    )
    scene = CollisionScene(model=model, capsules=tuple(capsules), self_pairs=pairs)
    distances = scene.distances(q) if pairs else np.zeros(0)
    return tuple(pair for pair, distance in zip(pairs, distances, strict=True) if distance > margin)
