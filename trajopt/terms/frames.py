"""Constraints of frames at nodes: links that stay above a height, and where an axis points at a moment."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pinocchio as pin

from trajopt.errors import InputError
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.interfaces import Rows
from trajopt.terms.node_interfaces import NodeConstraint, NodePlace, nearest_node

# A joint nearer to the one before it than this part of the robot's length is at the same place.
SAME_JOINT = 0.25
# A frame is at a joint if it is this near to it, m.
SAME_PLACE = 1e-9


def leg_joints(robot: Robot) -> tuple[str, ...]:
    """Frames at the joints that bound the trunk and the legs: the root of each limb, and every one a link on.

    Of a quadruped the hips (of two that are close to each other the inner one) and the knees. The first frame
    at the joint's place whose name no other frame has; a joint without any is left out.
    """
    model, data = robot.model, robot.model.createData()
    pin.forwardKinematics(model, data, robot.reference)
    named = Counter(frame.name for frame in model.frames)
    found = []
    for joint in range(2, model.njoints):
        parent = model.parents[joint]
        apart = np.linalg.norm(data.oMi[joint].translation - data.oMi[parent].translation)
        if parent != 1 and apart <= SAME_JOINT * robot.length:
            continue
        found += [
            frame.name
            for frame in model.frames
            if frame.parentJoint == joint
            and named[frame.name] == 1
            and np.abs(frame.placement.translation).max() < SAME_PLACE
        ][:1]
    return tuple(found)


@dataclass(frozen=True, kw_only=True)
class FramesAbove(NodeConstraint):
    """Origins of ``frames`` at least ``height`` m high in the world at all nodes of ``phases`` but the start.

    A node between two phases belongs to the later one.
    """

    frames: tuple[str, ...]
    height: float

    def __post_init__(self) -> None:
        if not self.frames or not math.isfinite(self.height):
            raise InputError(
                f"{len(self.frames)} frames are kept above {self.height:g} m",
                "allowed: frames, and a finite height",
            )

    def acts_at(self, place: NodePlace) -> bool:
        own = place.index < place.count or place.last
        return own and place.index > 0 and self.acts_in(place.phase.name)

    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        heights = [context.frame(frame).position[2] for frame in self.frames]
        return Rows.create(ca.vertcat(*heights), self.height, np.inf, units.length)


@dataclass(frozen=True, kw_only=True)
class FrameDirection(NodeConstraint):
    """An axis of a frame points within ``angle`` rad of a ``direction`` at the node nearest to ``fraction``.

    ``axis`` (3,) in the frame and ``direction`` (3,) in the world, made unit vectors; of the phase ``phase``
    (of its own nodes: the last one of all but the last phase belongs to the next). The row is their cosine.
    Halfway through a somersault the base's z axis points down. Raises `InputError`.
    """

    frame: str
    axis: tuple[float, float, float]
    direction: tuple[float, float, float]
    angle: float
    phase: str
    fraction: float = 0.5

    def __post_init__(self) -> None:
        for name in ("axis", "direction"):
            vector = np.array(getattr(self, name), dtype=float)
            if vector.shape != (3,) or not np.isfinite(vector).all() or not np.linalg.norm(vector) > 0:
                raise InputError(f"{name} of {self.name} is {vector}", "allowed: 3 finite numbers, not all 0")
            object.__setattr__(self, name, tuple((vector / np.linalg.norm(vector)).tolist()))
        if not 0 < self.angle < math.pi:
            raise InputError(f"angle of {self.name} is {self.angle:g} rad", "allowed: between 0 and pi")
        if not 0 <= self.fraction <= 1:
            raise InputError(f"fraction of {self.name} is {self.fraction:g}", "allowed: 0 to 1")
        object.__setattr__(self, "phases", (self.phase,))

    def acts_at(self, place: NodePlace) -> bool:
        return place.phase.name == self.phase and place.index == nearest_node(place, self.fraction)

    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        axis, direction = (context.parameter(np.array(v)) for v in (self.axis, self.direction))
        cosine = ca.dot(direction, ca.mtimes(context.frame(self.frame).rotation, axis))
        return Rows.create(cosine, math.cos(self.angle), np.inf, 1.0)
