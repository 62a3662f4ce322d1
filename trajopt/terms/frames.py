"""Constraints on frames at nodes: pose, velocity, height, and the direction of an axis."""

import math
from dataclasses import dataclass

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.arguments import Array3, Array33, UnitVector, checked
from trajopt.dynamics.rotations import rotation_error
from trajopt.errors import InputError
from trajopt.robot.units import Units
from trajopt.robot.validation import UNIT_SLACK
from trajopt.schedule.moment import Target
from trajopt.terms.context import Context
from trajopt.terms.interfaces import AtMoment, DuringPhases, NodeConstraint, NodePlace, Rows


@checked
@dataclass(frozen=True, kw_only=True)
class FrameHeight(AtMoment, NodeConstraint):
    """A frame is at least, or at most, at a height at one moment.

        p_z >= height        or with ``below``        p_z <= height

    with p the frame's origin in the world. The row is over l.

    Args:
        frame: name of the frame.
        height: height of its origin in the world, m.
        at: the moment; default the end of the motion.
        below: bound the height from above instead.
    """

    frame: str
    height: float
    below: bool = False

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        bounds = (-np.inf, self.height) if self.below else (self.height, np.inf)
        return Rows.create(context.frame(self.frame).position[2], *bounds, units.length)


@checked
@dataclass(frozen=True, kw_only=True)
class FramePose(AtMoment, NodeConstraint):
    """A frame has a given position, orientation or both at one moment.

        p = position                         3 rows over l
        2 tan(angle / 2) axis = 0            3 rows, for the relative rotation, rotation^T R

    with p the frame's origin and R its axes in the world.

    Args:
        frame: name of the frame.
        position: of its origin in the world (3,), m; None leaves it free.
        rotation: its axes in the world (3, 3); None leaves it free.
        at: the moment at which the pose is reached; default the end of the motion.

    Raises:
        InputError: for neither a position nor a rotation, another shape, and a matrix that is not a rotation.
    """

    frame: str
    position: Array3 | None = None
    rotation: Array33 | None = None

    def __post_init__(self) -> None:
        if self.position is None and self.rotation is None:
            raise InputError(
                f"{self.name} of '{self.frame}' has no goal", "allowed: position, rotation or both"
            )
        turn = np.eye(3) if self.rotation is None else self.rotation
        if not np.allclose(turn.T @ turn, np.eye(3), rtol=0, atol=UNIT_SLACK):
            raise InputError(f"rotation of {self.name} is {turn.tolist()}", "allowed: (3, 3), orthonormal")
        if np.linalg.det(turn) < 0:
            raise InputError(f"rotation of {self.name} is a reflection", "allowed: determinant 1")

    @override
    def targets(self) -> tuple[Target, ...]:
        target = Target(frame=self.frame, position=self.position, rotation=self.rotation, at=self.at)
        return (target,)

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        frame = context.frame(self.frame)
        expressions, targets, scales = [], [], []
        if self.position is not None:
            expressions.append(frame.position)
            targets.append(self.position)
            scales.append(np.full(3, units.length))
        if self.rotation is not None:
            expressions.append(rotation_error(context.parameter(self.rotation), frame.rotation))
            targets.append(np.zeros(3))
            scales.append(np.ones(3))
        bound = np.concatenate(targets)
        return Rows.create(ca.vertcat(*expressions), bound, bound, np.concatenate(scales))


@checked
@dataclass(frozen=True, kw_only=True)
class FrameVelocity(AtMoment, NodeConstraint):
    """A frame has a given velocity at one moment.

        (p', omega) = velocity

    with p' the velocity of the frame's origin and omega its angular velocity. Rows are over sqrt(g l) and
    sqrt(g / l).

    Args:
        frame: name of the frame.
        velocity: linear (m/s) and angular (rad/s) in world axes (6,).
        at: the moment at which the frame moves like this; default the end of the motion.
    """

    frame: str
    velocity: np.ndarray

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        return Rows.create(context.frame(self.frame).velocity, self.velocity, self.velocity, units.twist)


@checked
@dataclass(frozen=True, kw_only=True)
class FramesAbove(DuringPhases, NodeConstraint):
    """Frames stay above a height at all nodes of the chosen phases, except at each phase's start.

        p_z >= height

    for the origin p of each frame. Rows are over l.

    Args:
        frames: names of the frames.
        height: least height of their origins in the world, m.
        during: names of the phases, default all; a node between two phases belongs to the later one.
    """

    frames: tuple[str, ...]
    height: float

    def __post_init__(self) -> None:
        if not self.frames:
            raise InputError(f"no frame is kept above {self.height:g} m", "allowed: one or more frames")

    @override
    def acts_at(self, place: NodePlace) -> bool:
        of_phase = place.index < place.count or place.last
        return of_phase and place.index > 0 and self.acts_in(place.phase.name)

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        heights = [context.frame(frame).position[2] for frame in self.frames]
        return Rows.create(ca.vertcat(*heights), self.height, np.inf, units.length)


@checked
@dataclass(frozen=True, kw_only=True)
class FrameDirection(AtMoment, NodeConstraint):
    """An axis of a frame is within an angle of a direction at one moment.

        direction . R axis >= cos(angle)

    with R the frame's axes in the world. For example, halfway through a somersault the base's z axis points
    down.

    Args:
        frame: name of the frame.
        axis: axis in the frame (3,), normalised.
        direction: direction in the world (3,), normalised.
        angle: largest angle between them, rad, between 0 and pi.
        at: the moment; default the end of the motion.

    Raises:
        InputError: for zero vectors, and numbers out of range.
    """

    frame: str
    axis: UnitVector
    direction: UnitVector
    angle: float

    def __post_init__(self) -> None:
        if not 0 < self.angle < math.pi:
            raise InputError(f"angle of {self.name} is {self.angle:g} rad", "allowed: between 0 and pi")

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        axis, direction = (context.parameter(np.array(v)) for v in (self.axis, self.direction))
        cosine = ca.dot(direction, ca.mtimes(context.frame(self.frame).rotation, axis))
        return Rows.create(cosine, math.cos(self.angle), np.inf, 1.0)
