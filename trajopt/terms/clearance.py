"""The constraint that links stay clear of obstacles and of each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.errors import InputError, require_not_negative
from trajopt.robot.collision.distances import Box, SymbolicAxis, box_distance, segment_distance
from trajopt.robot.collision.near import CollisionScene, ShapePair
from trajopt.robot.collision.shapes import BoxObstacle, LinkShape, Obstacle
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.interfaces import PointConstraint, Rows, Term

# Error of smoothing in a distance, over the robot's length: a millimetre on an arm of one metre.
SMOOTHING = 1e-3


@dataclass(frozen=True, kw_only=True)
class Clearance(PointConstraint):
    """Pairs of a collision scene keep a distance at every collocation point.

    Distances are smooth and on the safe side, see `distances`: a pair that satisfies its row is at least
    ``margin`` apart, and one that is ``margin`` and 2e-3 of the robot's length apart satisfies its row.
    Obstacles and margin are parameters: moving them needs no compilation.

    Args:
        scene: all capsules and obstacles; a check of the solution measures all of it.
        pairs: the pairs that become rows, one each: those that can come near.
        margin: least distance, m.

    Raises:
        InputError: for a negative margin or a pair that is not in the scene.
    """

    scene: CollisionScene
    pairs: tuple[ShapePair, ...]
    margin: float = 0.0

    def __post_init__(self) -> None:
        require_not_negative("margin to obstacles", self.margin, "m")
        object.__setattr__(self, "pairs", tuple((str(a), str(b)) for a, b in self.pairs))
        known = set(self.scene.pairs)
        unknown = [pair for pair in self.pairs if pair not in known]
        if unknown:
            raise InputError(f"the scene has no pair {unknown[0]}", "allowed: pairs of the scene")

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        if not self.pairs:
            return None
        capsules = {shape.name: shape for shape in self.scene.shapes}
        obstacles = {obstacle.name: _Placed(obstacle, context) for obstacle in self._met()}
        margin, smoothing = context.parameter(self.margin), SMOOTHING * units.length
        rows = []
        for first, second in self.pairs:
            own, axis = capsules[first], _axis(context, capsules[first])
            if second in capsules:
                reach = own.radius + capsules[second].radius + margin
                rows.append(segment_distance(axis, _axis(context, capsules[second]), reach, smoothing))
            else:
                rows.append(obstacles[second].beyond(axis, own.radius + margin, smoothing))
        return Rows.create(ca.vertcat(*rows), 0.0, np.inf, units.length)

    def _met(self) -> tuple[Obstacle, ...]:
        met = {second for _, second in self.pairs}
        return tuple(obstacle for obstacle in self.scene.obstacles if obstacle.name in met)


class _Placed:
    """An obstacle with its place and size as parameters of a context."""

    def __init__(self, obstacle: Obstacle, context: Context) -> None:
        self.box: Box | None = None
        if isinstance(obstacle, BoxObstacle):
            parts = (obstacle.turn, obstacle.position, obstacle.sides / 2)
            self.box = Box(*(context.parameter(part) for part in parts))
        else:
            self.axis = SymbolicAxis(*(context.parameter(end) for end in obstacle.axis))
            self.radius = context.parameter(obstacle.radius)

    def beyond(self, axis: SymbolicAxis, reach: ca.SX, smoothing: float) -> ca.SX:
        """Smooth distance of ``axis`` from the obstacle minus ``reach`` m."""
        if self.box is not None:
            return box_distance(axis, self.box, reach, smoothing)
        return segment_distance(axis, self.axis, self.radius + reach, smoothing)


def _axis(context: Context, capsule: LinkShape) -> SymbolicAxis:
    frame = context.frame(capsule.frame)
    ends = (frame.position + ca.mtimes(frame.rotation, ca.DM(end)) for end in capsule.axis)
    return SymbolicAxis(*ends)


def collision_scene(terms: Sequence[Term]) -> CollisionScene | None:
    """Collision scene of the terms, None where none of them is a `Clearance`.

    Raises:
        InputError: where there are several scenes.
    """
    scenes = [term.scene for term in terms if isinstance(term, Clearance)]
    if any(scene is not scenes[0] for scene in scenes):
        raise InputError("a problem has several collision scenes", "allowed: one")
    return scenes[0] if scenes else None


def collision_meta(terms: Sequence[Term]) -> dict[str, Any]:
    """Description of the collision scene for a solution's meta; empty where there is none."""
    scene = collision_scene(terms)
    return {} if scene is None else {"collision": scene.describe()}
