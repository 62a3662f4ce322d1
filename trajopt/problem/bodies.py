"""The bodies of a problem that must stay apart: its robot's links, obstacles and the ground."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.robot.collision.description import robot_shapes
from trajopt.robot.collision.near import GROUND, CollisionScene, ShapePair, separable_pairs
from trajopt.robot.collision.planes import CornerRow, corner_rows
from trajopt.robot.collision.shapes import LinkShape
from trajopt.robot.robot import Robot
from trajopt.terms.clearance import Clearance
from trajopt.terrain.flat import FlatGround

# Points of a link this near to where a contact of the link touches, m, touch with it.
TOUCHING = 0.01
# A start may be this much nearer, m: what a check allows.
START_ERROR = 1e-3
# Such links may be this much deeper in the ground than where the robot stands in its reference posture, m: at
# touchdown they are on the ground, where the landing's rows hold them.
SLACK = 3e-4


Touching = tuple[tuple[str, np.ndarray], ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class ProblemBodies:
    """The scene of a problem, and the least distance (n_pairs,) m of each of its pairs.

    ``touching``: of each shape, by its name, the contacts that it carries, each with the points (n,) there.
    """

    scene: CollisionScene
    margins: np.ndarray
    touching: Mapping[str, Touching]

    @property
    def pairs(self) -> tuple[ShapePair, ...]:
        """Pairs of the scene."""
        return self.scene.pairs

    def rows(
        self,
        configurations: np.ndarray,
        wanted: Sequence[tuple[int, ShapePair, frozenset[str]]],
        within: float,
    ) -> list[tuple[CornerRow, ...]]:
        """Rows that keep pairs apart near configurations (K, nq).

        Args:
            configurations: where planes are laid.
            wanted: of each: the configuration's number, the pair, and the contacts that are active there.
            within: bodies of the ground farther away than this, m, get no rows.
        """
        margins = dict(zip(self.pairs, self.margins.tolist(), strict=True))
        found = self.scene.approaches(configurations, [(k, pair) for k, pair, _ in wanted], within)
        laid = []
        for (_, pair, active), approaches in zip(wanted, found, strict=True):
            standing = [points for contact, points in self.touching[pair[0]] if contact in active]
            left_out = np.any(standing, axis=0) if pair[1] == GROUND and standing else None
            laid.append(tuple(row for own in approaches for row in corner_rows(own, margins[pair], left_out)))
        return laid


def clearance_of(problem: Problem) -> Clearance:
    """The problem's `Clearance`, or the default. Raises InputError for several."""
    found = [term for term in problem.terms if isinstance(term, Clearance)]
    if len(found) > 1:
        raise InputError(f"problem '{problem.name}' has {len(found)} clearance terms", "allowed: one")
    return found[0] if found else Clearance()


def bodies_of(problem: Problem) -> ProblemBodies:
    """The bodies of a problem. Raises InputError."""
    clearance, robot = clearance_of(problem), problem.robot
    known = robot_shapes(robot)
    shapes = known.shapes if clearance.shapes is None else clearance.shapes
    if clearance.shapes is None:
        pairs = known.pairs
    else:
        pairs = separable_pairs(robot.model, shapes, robot.reference, clearance.margin)
    scene = CollisionScene(
        model=robot.model,
        shapes=shapes,
        obstacles=clearance.obstacles,
        self_pairs=pairs if clearance.self_collision else (),
        terrain=problem.terrain if clearance.ground else None,
    )
    touching = {shape.name: _touching(robot, shape) for shape in shapes}
    margins = _margins(robot, scene, touching, clearance.margin)
    return ProblemBodies(scene=scene, margins=margins, touching=touching)


def _margins(
    robot: Robot, scene: CollisionScene, touching: Mapping[str, Touching], margin: float
) -> np.ndarray:
    """Least distance (n_pairs,) m: none for links fixed to the world, with which only other links collide."""
    found = np.full(len(scene.pairs), margin)
    found[: scene.n_ground] = 0.0
    flat = CollisionScene(model=robot.model, shapes=scene.shapes, terrain=FlatGround())
    standing = dict(zip(scene.shapes, flat.distances(robot.reference)[0].tolist(), strict=True))
    for column, shape in enumerate(scene.shapes[: scene.n_ground]):
        if touching[shape.name]:
            found[column] = min(standing[shape], 0.0) - SLACK
    frames = [robot.model.frames[robot.model.getFrameId(shape.frame)] for shape in scene.shapes]
    fixed = {s.name for s, frame in zip(scene.shapes, frames, strict=True) if frame.parentJoint == 0}
    outer = [column for column, pair in enumerate(scene.pairs[: scene.n_outer]) if pair[0] in fixed]
    found[outer] = -np.inf
    return found


def require_clear_start(problem: Problem, bodies: ProblemBodies) -> None:
    """Raise `InputError` where a fixed start has bodies nearer to each other than they may be."""
    if problem.periodicity is not None or not bodies.pairs:
        return
    short = bodies.scene.distances(problem.initial_q, 0.1 + float(bodies.margins.max()))[0] - bodies.margins
    worst = int(np.argmin(short))
    if short[worst] < -START_ERROR:
        (first, second), margin = bodies.pairs[worst], bodies.margins[worst]
        raise InputError(
            f"'{first}' starts {short[worst] + margin:.4f} m from '{second}' (negative: inside it)",
            f"allowed: at least {margin:g} m",
        )


def _touching(robot: Robot, shape: LinkShape) -> Touching:
    """Contacts carried by a shape's joint, with the shape's points (n,) near the touching point or sole."""
    model, found = robot.model, []
    own = model.frames[model.getFrameId(shape.frame)]
    for contact in robot.contacts:
        frame = model.frames[model.getFrameId(contact.frame)]
        if frame.parentJoint != own.parentJoint:
            continue
        local = own.placement.actInv(frame.placement).actInv
        points = np.array([local(point) for point in shape.points])
        size = np.array([contact.half_length, contact.half_width, 0.0])
        away = np.linalg.norm(np.maximum(np.abs(points) - size, 0.0), axis=1)
        near = away <= TOUCHING + shape.radius
        if near.any():
            found.append((contact.name, near))
    return tuple(found)
