"""The bodies of a problem that must stay apart: its robot's links, obstacles and the ground."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from trajopt.collision.description import Carried, RobotShapes, above_ground, box_of_inertia, robot_shapes
from trajopt.collision.near import CollisionScene, ShapePair, separable_pairs
from trajopt.collision.planes import PlacedBody, SeparatingPlane, beyond_foot, separating_plane
from trajopt.collision.shapes import LinkShape
from trajopt.errors import InputError
from trajopt.problem.places import CONTACT_GAP, PLACE_SLACK
from trajopt.problem.problem import Problem
from trajopt.robot.contact import Contact
from trajopt.robot.payload import Payload
from trajopt.robot.robot import Robot
from trajopt.schedule.moment import END, Moment, Target, start_of
from trajopt.terms.clearance import Clearance
from trajopt.terms.terminal import TerminalPosture
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.smooth import SmoothTerrain

# Shapes within this distance of a contact's ball, or of a corner of its sole, m, touch the ground with it.
TOUCH_GAP = 0.01
# Links that touch the ground may be this deep in it, m, or this much deeper than in the reference or initial
# posture: in stance other rows hold them on the ground.
FOOT_DEPTH, MORE_DEPTH = 4e-4, 1e-4
# A pair nearer than allowed by this much, m, is too near; a solver and the checks between moments leave less.
GAP_SLACK = 5e-4
# A ball of this radius, m, stands for the origin of a frame.
POINT = 1e-4
POINT_NAME = "origin of the frame"


@dataclass(frozen=True, kw_only=True, eq=False)
class ProblemBodies:
    """The scene of a problem, and the least distance (n_pairs,) m that each of its pairs must keep.

    ``present`` (n_phases, n_pairs) marks the phases in which both bodies of a pair are there.
    """

    scene: CollisionScene
    margins: np.ndarray
    present: np.ndarray

    @property
    def pairs(self) -> tuple[ShapePair, ...]:
        """Pairs of the scene."""
        return self.scene.pairs

    @cached_property
    def margin_of(self) -> dict[ShapePair, float]:
        """The least distance of each pair, m."""
        return dict(zip(self.pairs, self.margins.tolist(), strict=True))

    @property
    def widest(self) -> float:
        """The largest margin of a pair, m; zero if none is positive."""
        return float(self.margins.max(initial=0.0))

    def is_foot(self, shape: LinkShape, contact: Contact) -> bool:
        """Whether a shape on a contact's link cannot get deeper, however the link turns about the contact.

        This holds for a ball around a point contact, and for a shape that hardly extends beyond the contact's
        own ball. A link with a sole does not turn about it.
        """
        if contact.kind == "surface":
            return True
        model = self.scene.model
        centre, carrier = (
            model.frames[model.getFrameId(name)].placement for name in (contact.frame, shape.frame)
        )
        points = [(centre.inverse() * carrier).act(point) for point in shape.points]
        reach = float(np.linalg.norm(points, axis=1).max()) + shape.radius
        return reach <= max(shape.radius, contact.radius) + TOUCH_GAP

    def planes(
        self,
        configurations: np.ndarray,
        wanted: Sequence[tuple[int, ShapePair]],
        within: float,
        feet: Sequence[PlacedBody | None],
    ) -> list[tuple[SeparatingPlane, ...]]:
        """Planes that keep pairs apart near configurations (K, nq); several where the ground has faces.

        Args:
            configurations: configurations (K, nq) at which the planes are determined.
            wanted: for each result, the index of the configuration and the pair.
            within: faces of the ground farther away than this, m, get no plane, except for the nearest one.
            feet: for each result, the contacts of the pair's first link, which the planes keep clear if they
                can; None for none.
        """
        margins = self.margin_of
        by_pair = self.scene.approaches(configurations, wanted, within)
        return [
            tuple(
                separating_plane(
                    near if foot is None else beyond_foot(near, foot, margins[pair]), margins[pair]
                )
                for near in approaches
            )
            for (_, pair), approaches, foot in zip(wanted, by_pair, feet, strict=True)
        ]


def clearance_of(problem: Problem) -> Clearance:
    """The problem's `Clearance`, or the default. Raises InputError for several."""
    terms = [term for term in problem.terms if isinstance(term, Clearance)]
    if len(terms) > 1:
        raise InputError(f"problem '{problem.name}' has {len(terms)} clearance terms", "allowed: one")
    return terms[0] if terms else Clearance()


def shapes_of(problem: Problem) -> RobotShapes:
    """Shapes of the robot's links, and which pairs of them must stay apart in this problem."""
    clearance, robot = clearance_of(problem), problem.robot
    if clearance.shapes is None:
        known = robot_shapes(robot)
    else:
        pairs = separable_pairs(robot.model, clearance.shapes, robot.reference, clearance.margin)
        solid = above_ground(robot, clearance.shapes)
        known = RobotShapes(shapes=clearance.shapes, pairs=pairs, above_ground=solid)
    if problem.payloads:
        known = _with_payloads(problem, known, clearance)
    return known if clearance.self_collision else replace(known, pairs=())


def _with_payloads(problem: Problem, known: RobotShapes, clearance: Clearance) -> RobotShapes:
    """The shapes with those of carried bodies; a body in several phases is one.

    A body rests on an obstacle if it is nearer than the margin at a goal, or at the start.
    """
    carried: dict[str, Carried] = {}
    shapes: dict[tuple[object, ...], LinkShape] = {}
    for number, phase in enumerate(problem.schedule.names):
        if phase in problem.payloads:
            made = payload_shape(problem.robot, problem.payloads[phase], f"payload {len(shapes) + 1}")
            name = shapes.setdefault((made.frame, made.points.tobytes(), made.radius), made).name
            before = carried[name].phases if name in carried else ()
            carried[name] = Carried(phases=(*before, number))
    every = known.with_carried(problem.robot, carried, tuple(shapes.values()))
    if not (clearance.margin > 0 and clearance.obstacles):
        return every
    scene = every.scene(problem.robot.model, problem.terrain, clearance.obstacles)
    under: dict[str, set[str]] = {name: set() for name in carried}
    for placed in _placed(problem, every, scene):
        for one, other in scene.pairs[scene.n_ground : scene.n_outer]:
            if one in under and placed.distances.get((one, other), np.inf) < clearance.margin:
                under[one].add(other)
    resting = {name: replace(body, rests_on=tuple(sorted(under[name]))) for name, body in carried.items()}
    return replace(every, carried=resting)


def payload_shape(robot: Robot, payload: Payload, name: str) -> LinkShape:
    """The shape of a carried body on the frame of its contact: its own, that of its inertia, or a point."""
    frame = robot.contact(payload.contact).frame
    if payload.points is not None:
        return LinkShape(name=name, frame=frame, points=payload.points, radius=payload.radius)
    if box := box_of_inertia(payload.spatial):
        return LinkShape.box(name, frame, box[0], box[1].translation, box[1].rotation)
    return LinkShape.sphere(name, frame, payload.centre, POINT)


def bodies_of(problem: Problem) -> ProblemBodies:
    """The bodies of a problem. Raises InputError where two overlap at its start or at a goal."""
    clearance, shapes = clearance_of(problem), shapes_of(problem)
    scene = shapes.scene(problem.robot.model, problem.terrain, clearance.obstacles)
    # A periodic motion's start is free.
    start = scene.distances_at(problem.initial_q) if problem.periodicity is None else None
    margins = _margins(problem.robot, scene, clearance.margin, start)
    margins[shapes.resting(scene.pairs)] = 0.0
    present = shapes.present(scene.pairs, range(len(problem.schedule.phases)))
    bodies = ProblemBodies(scene=scene, margins=margins, present=present)
    for placed in _placed(problem, shapes, scene):
        _require_clear(bodies, placed)
    return bodies


def _margins(robot: Robot, scene: CollisionScene, margin: float, start: np.ndarray | None) -> np.ndarray:
    """Least distance (n_pairs,) in m of each pair; for two links at most that in the reference posture.

    ``start`` holds the distances (n_pairs,) in m at a fixed start.
    """
    margins = np.full(len(scene.pairs), margin)
    if scene.n_ground:
        flat = CollisionScene(model=robot.model, shapes=scene.shapes, terrain=FlatGround())
        standing = flat.distances(robot.reference)[0]
        if start is not None:
            standing = np.minimum(standing, start[: scene.n_ground])
        touching = _touching(robot, scene.moving)
        margins[: scene.n_ground] = np.where(touching, np.minimum(standing - MORE_DEPTH, -FOOT_DEPTH), 0.0)
    if margin > 0 and scene.self_pairs:
        margins[scene.n_outer :] = self_margins(robot, scene, margin)
    return margins


def self_margins(robot: Robot, scene: CollisionScene, margin: float) -> np.ndarray:
    """Least distance (n,) in m of each pair of links: ``margin``, at most that in the reference posture."""
    apart = scene.distances_at(robot.reference)[scene.n_outer :]
    return np.asarray(np.minimum(margin, np.maximum(apart, 0.0)))


def contacts_by_shape(robot: Robot, shapes: Sequence[LinkShape]) -> dict[str, list[Contact]]:
    """Contacts of the link that carries each shape, by the shape's name."""
    joints = {frame.name: frame.parentJoint for frame in robot.model.frames}
    return {
        shape.name: [c for c in robot.contacts if joints[c.frame] == joints[shape.frame]] for shape in shapes
    }


def _touching(robot: Robot, shapes: Sequence[LinkShape]) -> np.ndarray:
    """Mask (n,) of shapes around a contact: within `TOUCH_GAP` of its ball or of a corner of its sole."""
    balls = {
        contact.name: [
            LinkShape.sphere(
                f"{contact.name} corner {i}",
                contact.frame,
                [*corner, 0.0],
                contact.radius + TOUCH_GAP,
            )
            for i, corner in enumerate(contact.corners)
        ]
        for contact in robot.contacts
    }
    on_link = contacts_by_shape(robot, shapes)
    pairs = [(s.name, ball.name) for s in shapes for c in on_link[s.name] for ball in balls[c.name]]
    every = (*shapes, *itertools.chain.from_iterable(balls.values()))
    scene = CollisionScene(model=robot.model, shapes=every, self_pairs=tuple(pairs))
    distances = scene.distances(robot.reference)[0]
    near = {shape for (shape, _), distance in zip(pairs, distances, strict=True) if distance <= 0}
    return np.array([shape.name in near for shape in shapes], dtype=bool)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Placed:
    """Signed distances in m of pairs that are known before solving, and by how much they may be off.

    ``where`` is the part of a message that says where the bodies are.
    """

    where: str
    distances: Mapping[ShapePair, float]
    slack: float = 0.0


def _require_clear(bodies: ProblemBodies, placed: _Placed) -> None:
    """Raise `InputError` if placed bodies are nearer to each other than allowed."""
    margins, distances = bodies.margin_of, placed.distances
    worst = min(distances, key=lambda pair: distances[pair] - margins[pair], default=None)
    if worst is not None and distances[worst] - margins[worst] < -GAP_SLACK - placed.slack:
        raise InputError(
            f"'{worst[0]}' {placed.where} {distances[worst]:.4f} m from '{worst[1]}' (negative: inside it)",
            f"allowed: at least {margins[worst]:g} m",
        )


def _placed(problem: Problem, shapes: RobotShapes, scene: CollisionScene) -> Iterator[_Placed]:
    """Yield the distances at a fixed start and at the goals, as far as they are known before solving.

    For a configuration all pairs are known. For a posture placed where a contact lands, pairs of links are;
    for a frame's pose, its link with ground and obstacles. About a mere position the link may turn. Pairs of
    bodies that are not carried at that moment are left out.
    """
    schedule = problem.schedule

    def there(distances: Mapping[ShapePair, float], moment: Moment) -> dict[ShapePair, float]:
        both = np.atleast_1d(shapes.present(tuple(distances), schedule.phases_at(moment)).any(axis=0))
        return {pair: distances[pair] for pair, known in zip(distances, both, strict=True) if known}

    def at(q: np.ndarray, moment: Moment, first: int = 0) -> dict[ShapePair, float]:
        every = zip(scene.pairs[first:], scene.distances_at(q)[first:].tolist(), strict=True)
        return there(dict(every), moment)

    # A periodic motion's start is free.
    if problem.periodicity is None:
        yield _Placed(where="starts", distances=at(problem.initial_q, start_of(schedule.names[0])))
    # Contacts, and other links with them, may be this far from where the goal has them.
    stands = any(phase.contacts for phase in schedule.phases)
    slack = max(CONTACT_GAP, PLACE_SLACK * problem.robot.length) if stands else 0.0
    for term in problem.terms if scene.pairs else ():
        where = f"in q of {term.name} is"
        if isinstance(term, TerminalPosture):
            yield _Placed(where=where, distances=at(term.q, END, scene.n_outer), slack=slack)
        for target in term.targets():
            if target.q is not None:
                yield _Placed(where=where, distances=at(target.q, target.at), slack=slack)
            else:
                known = "is" if target.rotation is not None else "is at most"
                goal = f"at the goal of {term.name} of '{target.frame}' {known}"
                link = there(placed_link(scene, target), target.at)
                yield _Placed(where=goal, distances=link, slack=slack)


def placed_link(scene: CollisionScene, target: Target) -> dict[ShapePair, float]:
    """Signed distances in m of the link that carries a target's frame from ground and obstacles, by pair.

    If the target leaves its rotation free, they are upper bounds over all rotations. With ``d`` the distance
    of the frame's origin from a shape of its link, negative inside, and ``e`` that of the target from another
    body, the shape has a point within ``d`` of the target, or all points within ``-d``, so that its distance
    from the body is at most ``d + e``. Smooth ground, whose distances are those from tangent planes, is then
    left out.
    """
    if target.frame is None or target.position is None:
        return {}
    frames = {frame.name: frame for frame in scene.model.frames}
    carrier = frames[target.frame]
    shapes = tuple(s for s in scene.moving if frames[s.frame].parentJoint == carrier.parentJoint)
    if not shapes:
        return {}
    link = pin.Model()
    joint = link.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "link")
    for name in {target.frame, *(shape.frame for shape in shapes)}:
        link.addFrame(pin.Frame(name, joint, frames[name].placement, pin.FrameType.OP_FRAME))
    rotation = np.eye(3) if target.rotation is None else target.rotation
    q = pin.SE3ToXYZQUAT(pin.SE3(rotation, target.position) * carrier.placement.inverse())
    if target.rotation is not None:
        alone = CollisionScene(model=link, shapes=shapes, obstacles=scene.obstacles, terrain=scene.terrain)
        return dict(zip(alone.pairs, alone.distances(q)[0].tolist(), strict=True))
    origin = LinkShape.sphere(POINT_NAME, target.frame, np.zeros(3), POINT)
    alone = CollisionScene(
        model=link,
        shapes=(*shapes, origin),
        obstacles=scene.obstacles,
        self_pairs=tuple((shape.name, POINT_NAME) for shape in shapes),
        terrain=None if isinstance(scene.terrain, SmoothTerrain) else scene.terrain,
    )
    distances = dict(zip(alone.pairs, (alone.distances(q)[0] + POINT).tolist(), strict=True))
    return {
        (shape, other): distances[shape, POINT_NAME] + distances[POINT_NAME, other]
        for shape, other in alone.pairs[: alone.n_outer]
        if shape != POINT_NAME
    }
