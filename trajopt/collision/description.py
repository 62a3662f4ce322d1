"""Shapes of a robot's links and the pairs that must not touch: all but those that touch by design."""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as Tree
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.arguments import checked
from trajopt.collision.hulls import joint_frame, read_shapes
from trajopt.collision.near import CollisionScene, ShapePair, separable_pairs
from trajopt.collision.shapes import LinkShape, Obstacle
from trajopt.dynamics.base_joint import BASE_ROWS
from trajopt.errors import InputError, shown
from trajopt.robot.building import reach
from trajopt.robot.mjcf import excluded_bodies
from trajopt.robot.robot import Robot
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.surface import MOST_SHAPES
from trajopt.terrain.terrain import Terrain

# Number of postures within the limits in which pairs are tested, and the fraction of overlaps above which a
# pair is taken to touch always.
POSTURES = 100
OVERLAP_SHARE = 0.95
SEED = 0
# Pairs that an SRDF disables for one of these reasons are still judged: the reason says that they were not
# seen to touch, not that they may.
JUDGED_REASONS = ("never",)
# Number of parent folders of a URDF in which a folder ``srdf`` is searched.
SRDF_LEVELS = 2
MOST_ROBOTS = 64
OVERLAP = "in the reference posture"
# Shapes of real robots are at most 1.2 times as large as the robot's reach, and at most 4 % of the pairs that
# are not neighbours overlap in the reference posture. Beyond these limits a description is doubtful.
MOST_SIZE, MOST_OVERLAPS = 5.0, 0.1
# Largest number of shapes named in a warning.
NAMED_SHAPES = 3
# The thinnest side of a link's box over its longest, so that it has a volume and is visible.
THINNEST = 0.02


@dataclass(frozen=True, kw_only=True)
class Carried:
    """The phases in which a shape is carried, and the obstacles that it rests on at their start or end."""

    phases: tuple[int, ...]
    rests_on: tuple[str, ...] = ()

    @classmethod
    def from_description(cls, described: Any) -> Carried:
        """Return the entry from its fields in a file. Raises InputError."""
        known = isinstance(described, dict) and set(described) == {"phases", "rests_on"}
        if not known or not all(isinstance(entry, list) for entry in described.values()):
            raise InputError(f"a carried body has {shown(described)}", "allowed: lists phases, rests_on")
        phases, under = described["phases"], described["rests_on"]
        if not all(type(phase) is int and phase >= 0 for phase in phases):
            raise InputError(f"phases of a carried body are {shown(phases)}", "allowed: numbers of phases")
        return cls(phases=tuple(phases), rests_on=tuple(map(str, under)))


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotShapes:
    """Shapes of a robot's links, see `robot_shapes`.

    Args:
        shapes: The shapes.
        pairs: Pairs of shapes, by name, that must not touch.
        left_out: The other pairs, each with its reason.
        missing: Geometry of the description that could not be read.
        above_ground: Whether the ground is an obstacle to the robot; False for a fixed base whose links reach
            below the world's origin in the reference posture, such as a pendulum.
        carried: The shapes that are carried bodies, by name; they are there in some phases only.
    """

    shapes: tuple[LinkShape, ...] = ()
    pairs: tuple[ShapePair, ...] = ()
    left_out: Mapping[ShapePair, str] = field(default_factory=dict)
    missing: tuple[str, ...] = ()
    above_ground: bool = True
    carried: Mapping[str, Carried] = field(default_factory=dict)

    def with_carried(
        self, robot: Robot, bodies: Mapping[str, Carried], shapes: Sequence[LinkShape]
    ) -> RobotShapes:
        """Return these shapes and those of carried ``bodies``, which keep apart from links if they can.

        Pairs are those of `separable_pairs`; the others are left out.
        """
        every = (*self.shapes, *shapes)
        apart = separable_pairs(robot.model, every, robot.reference, 0.0)
        pairs = tuple(pair for pair in apart if not bodies.keys().isdisjoint(pair))
        return replace(self, shapes=every, pairs=(*self.pairs, *pairs), carried={**self.carried, **bodies})

    def present(self, pairs: Sequence[ShapePair], phases: Sequence[int] | np.ndarray) -> np.ndarray:
        """Return a mask (K, n) of the phases (K,) in which both bodies of each of n pairs are there."""
        there = np.ones((len(phases), len(pairs)), dtype=bool)
        for name, body in self.carried.items():
            columns = [column for column, pair in enumerate(pairs) if name in pair]
            there[:, columns] &= np.isin(phases, body.phases)[:, None]
        return there

    def resting(self, pairs: Sequence[ShapePair]) -> np.ndarray:
        """Return a mask (n,) of pairs of a carried body and an obstacle that it rests on."""
        return np.array(
            [one in self.carried and other in self.carried[one].rests_on for one, other in pairs], dtype=bool
        )

    def scene(
        self, model: pin.Model, terrain: Terrain | None = None, obstacles: Sequence[Obstacle] = ()
    ) -> CollisionScene:
        """Return the scene of these shapes on ``model``, with the ground if it is an obstacle."""
        return CollisionScene(
            model=model,
            shapes=self.shapes,
            obstacles=tuple(obstacles),
            self_pairs=self.pairs,
            terrain=terrain if self.above_ground else None,
        )

    def doubts(self, model: pin.Model) -> tuple[str, ...]:
        """Return warnings about these shapes on ``model``, one line each: their size, many overlaps."""
        length, lines = reach(model), []
        sizes = {shape.name: shape.extent / length for shape in self.shapes if length > 0}
        outsized = sorted((name for name in sizes if sizes[name] > MOST_SIZE), key=lambda name: -sizes[name])
        if outsized:
            named = ", ".join(outsized[:NAMED_SHAPES]) + (", ..." if len(outsized) > NAMED_SHAPES else "")
            lines.append(
                f"shapes up to {sizes[outsized[0]]:.0f} times as large as the robot's reach, {length:.3g} m:"
                f' {named}; if their meshes are in mm, <mesh scale="0.001 0.001 0.001">'
            )
        overlapping = sum(OVERLAP in reason for reason in self.left_out.values())
        whole = overlapping + len(self.pairs)
        if overlapping > MOST_OVERLAPS * whole:
            share = f"{overlapping} of {whole} pairs of shapes ({100 * overlapping / whole:.0f} %)"
            lines.append(f"{share} are not judged, since they overlap {OVERLAP}")
        return tuple(lines)

    def describe(self) -> dict[str, Any]:
        """Return a JSON-able description for a solution file."""
        return {
            "shapes": [shape.describe() for shape in self.shapes],
            "pairs": [list(pair) for pair in self.pairs],
            "left_out": [[*pair, reason] for pair, reason in self.left_out.items()],
            "missing": list(self.missing),
            "above_ground": self.above_ground,
            **({"carried": {n: vars(body) for n, body in self.carried.items()}} if self.carried else {}),
        }

    @classmethod
    def from_description(cls, described: Any) -> RobotShapes:
        """Return the shapes from a result of ``describe``. Raises InputError."""
        keys = ("shapes", "pairs", "left_out", "missing")
        if not isinstance(described, dict) or not all(isinstance(described.get(k), list) for k in keys):
            raise InputError("bodies are not an object of lists", f"keys: {', '.join(keys)}")
        if len(described["shapes"]) > MOST_SHAPES:
            raise InputError(
                f"bodies have {len(described['shapes'])} shapes", f"allowed: up to {MOST_SHAPES}"
            )
        carried = described.get("carried", {})
        if not isinstance(carried, dict):
            raise InputError(f"carried bodies are {shown(carried)}", "allowed: an object by name of a shape")
        for key, size in (("pairs", 2), ("left_out", 3)):
            if not all(isinstance(entry, list) and len(entry) == size for entry in described[key]):
                raise InputError(f"{key} of bodies are not lists of {size} words", "names, and a reason")
        shapes = tuple(LinkShape.from_description(entry) for entry in described["shapes"])
        unknown = carried.keys() - {shape.name for shape in shapes}
        if unknown:
            raise InputError(
                f"carried bodies {shown(sorted(unknown))} are no shapes", "allowed: names of shapes"
            )
        return cls(
            shapes=shapes,
            pairs=tuple((str(first), str(second)) for first, second in described["pairs"]),
            left_out={(str(a), str(b)): str(reason) for a, b, reason in described["left_out"]},
            missing=tuple(str(entry) for entry in described["missing"]),
            above_ground=bool(described.get("above_ground", True)),
            carried={name: Carried.from_description(body) for name, body in carried.items()},
        )


@checked
def robot_shapes(robot: Robot) -> RobotShapes:
    """Return the shapes of a robot's description, and the pairs of them that must not touch.

    Shapes are those of `read_shapes`. Pairs are left out if they are on the same joint or on neighbouring
    joints, if an SRDF near the URDF or the MJCF file disables them, or if they overlap in the reference
    posture or in almost all sampled postures within the limits. The samples have a fixed seed. Results are
    cached by the robot's content.
    """
    return _robot_shapes(_KeyedRobot(_content(robot), robot))


@dataclass(frozen=True)
class _KeyedRobot:
    """A robot that compares equal to another with the same content."""

    content: tuple[object, ...]
    robot: Robot = field(compare=False)


def _content(robot: Robot) -> tuple[object, ...]:
    limits = (robot.reference, robot.position_lower, robot.position_upper)
    changed = None
    if robot.visual is not None and robot.visual.urdf.is_file():
        changed = robot.visual.urdf.stat().st_mtime_ns
    return robot.model.saveToString(), *(part.tobytes() for part in limits), robot.visual, changed


@lru_cache(maxsize=MOST_ROBOTS)
def _robot_shapes(keyed: _KeyedRobot) -> RobotShapes:
    robot = keyed.robot
    if robot.visual is None:
        return RobotShapes()
    shapes, links, missing = read_shapes(robot.visual, robot.model)
    left_out = dict(_touching_by_construction(robot, shapes, links))
    pairs = tuple(
        (first.name, second.name)
        for first, second in itertools.combinations(shapes, 2)
        if (first.name, second.name) not in left_out
    )
    for pair, reason in _overlapping(robot, shapes, pairs):
        left_out[pair] = reason
    pairs = tuple(pair for pair in pairs if pair not in left_out)
    return RobotShapes(
        shapes=shapes,
        pairs=pairs,
        left_out=left_out,
        missing=missing,
        above_ground=above_ground(robot, shapes),
    )


def above_ground(robot: Robot, shapes: tuple[LinkShape, ...]) -> bool:
    """Return whether the ground is an obstacle to a robot with these shapes, see `RobotShapes`."""
    if robot.base != "fixed":
        return True
    scene = CollisionScene(model=robot.model, shapes=shapes, terrain=FlatGround())
    return bool((scene.distances(robot.reference) >= 0).all())


def _touching_by_construction(
    robot: Robot, shapes: tuple[LinkShape, ...], links: Mapping[str, str]
) -> Iterator[tuple[ShapePair, str]]:
    """Yield pairs on the same or neighbouring joints, and those that a description disables."""
    model, disabled = robot.model, _disabled(robot)
    joints = {s.name: int(model.frames[model.getFrameId(s.frame)].parentJoint) for s in shapes}
    for first, second in itertools.combinations(shapes, 2):
        one, other = joints[first.name], joints[second.name]
        if one == other:
            yield (first.name, second.name), "on one link"
        elif model.parents[one] == other or model.parents[other] == one:
            yield (first.name, second.name), "neighbours"
        else:
            reason = disabled.get(frozenset((links[first.name], links[second.name])))
            if reason is not None:
                yield (first.name, second.name), reason


def _disabled(robot: Robot) -> dict[frozenset[str], str]:
    """Return link pairs that an SRDF or MJCF file disables because they touch, with reasons."""
    source = robot.visual
    if source is not None and source.is_mjcf:
        try:
            return dict.fromkeys(excluded_bodies(source.urdf), "excluded by the MJCF file")
        except InputError:  # the shapes are missing too, which is reported
            return {}
    file = None if source is None else _srdf_of(source.urdf)
    if file is None:
        return {}
    try:
        entries = list(Tree.parse(file).getroot().iter("disable_collisions"))
    except Tree.ParseError:
        return {}
    reasons = {frozenset((e.get("link1", ""), e.get("link2", ""))): e.get("reason", "") for e in entries}
    left_out = {pair: why for pair, why in reasons.items() if why.lower() not in JUDGED_REASONS}
    return {pair: f"SRDF: {why}" if why else "SRDF" for pair, why in left_out.items()}


def _srdf_of(urdf: Path) -> Path | None:
    """Return the SRDF named like the file or its robot, or the only one, in a nearby folder ``srdf``."""
    for folder in urdf.parents[:SRDF_LEVELS]:
        files = sorted((folder / "srdf").glob("*.srdf"))
        if not files:
            continue
        name = Tree.parse(urdf).getroot().get("name", "")
        named = [file for stem in (urdf.stem, name) for file in files if file.stem == stem]
        return next(iter(named or files[: len(files) == 1]), None)
    return None


def _overlapping(
    robot: Robot, shapes: tuple[LinkShape, ...], pairs: tuple[ShapePair, ...]
) -> Iterator[tuple[ShapePair, str]]:
    """Yield pairs that overlap in the reference posture, or in almost all sampled postures."""
    if not pairs:
        return
    scene = CollisionScene(model=robot.model, shapes=shapes, self_pairs=pairs)
    distances = scene.distances(np.vstack([robot.reference, sampled_postures(robot, POSTURES)]), within=0.0)
    often = (distances[1:] < 0).mean(axis=0)
    for pair, depth, part in zip(pairs, -distances[0], often, strict=True):
        if depth > 0:
            yield pair, f"overlap by {1e3 * depth:.1f} mm {OVERLAP}"
        elif part >= OVERLAP_SHARE:
            yield pair, f"overlap in {100 * part:.0f} % of all postures"


def sampled_postures(robot: Robot, count: int) -> np.ndarray:
    """Return postures (count, nq) within the limits, with the reference base and a fixed seed.

    A joint without limits is sampled within half a turn, or the robot's length, to either side.
    """
    model, random = robot.model, np.random.default_rng(SEED)
    lower, upper = np.zeros(robot.nv), np.zeros(robot.nv)
    for joint in list(model.joints)[1:]:
        if joint.idx_v < BASE_ROWS[robot.base]:
            continue
        rows, entries = slice(joint.idx_v, joint.idx_v + joint.nv), slice(joint.idx_q, joint.idx_q + joint.nq)
        straight = joint.shortname().removeprefix("JointModel").startswith(("P", "Translation"))
        free = robot.length if straight else np.pi
        lower[rows], upper[rows] = -free, free
        if joint.nq == joint.nv:
            at = robot.reference[entries]
            lower[rows] = np.maximum(robot.position_lower[entries] - at, -free)
            upper[rows] = np.minimum(robot.position_upper[entries] - at, free)
    steps = random.uniform(lower, upper, (count, robot.nv))
    return np.array([pin.integrate(model, robot.reference, step) for step in steps])


def inertia_boxes(model: pin.Model) -> tuple[LinkShape, ...]:
    """Return the solid boxes that have the links' masses and inertias, for robots without shapes.

    The box of a hollow link is larger than the link.
    """
    boxes = []
    for joint in range(1, model.njoints):
        if box := box_of_inertia(model.inertias[joint]):
            frame = joint_frame(model, joint)
            place = model.frames[model.getFrameId(frame)].placement.actInv(box[1])
            boxes.append(LinkShape.box(model.names[joint], frame, box[0], place.translation, place.rotation))
    return tuple(boxes)


def box_of_inertia(inertia: pin.Inertia) -> tuple[np.ndarray, pin.SE3] | None:
    """Sides (3,) m and placement of the solid box of that mass and inertia; None for a point or no mass.

    I_1 = m (b^2 + c^2) / 12 and so on in turn, for the sides a, b, c along the principal axes.
    """
    if not inertia.mass > 0:
        return None
    moments, axes = np.linalg.eigh(inertia.inertia)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    sides = np.sqrt(np.maximum(6 * (moments.sum() - 2 * moments) / inertia.mass, 0.0))
    if not sides.max() > 0:
        return None
    return np.maximum(sides, THINNEST * sides.max()), pin.SE3(axes, inertia.lever)
