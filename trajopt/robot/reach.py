"""Upper bound on the distance between two points on a robot: the lengths of the links between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.dynamics.model_content import frame_content, joint_kind

# Joints that rotate about a point fixed in their parent: distances from it are constant.
TURNING = ("RX", "RY", "RZ", "RUBX", "RUBY", "RUBZ", "RevoluteUnaligned", "RevoluteUnboundedUnaligned",
           "Spherical", "SphericalZYX")  # fmt: skip


@dataclass(frozen=True)
class LinkPoint:
    """A point (3,) m in the frame of a joint; for joint 0, in the world."""

    joint: int
    point: np.ndarray

    @classmethod
    def of_frame(cls, model: pin.Model, frame: str) -> LinkPoint:
        """The origin of a frame. Raises `InputError` that lists close names."""
        frame_content(model, frame)
        place = model.frames[model.getFrameId(frame)]
        return cls(int(place.parentJoint), np.array(place.placement.translation))

    def root(self, model: pin.Model) -> LinkPoint:
        """Where the first joint on the path from the root to it is attached, in the world."""
        way = _to_root(model, self.joint)
        if len(way) == 1:
            return self
        return LinkPoint(0, np.array(model.jointPlacements[way[-2]].translation))


def longest_between(model: pin.Model, one: LinkPoint, other: LinkPoint) -> float:
    """Upper bound on the distance in m between two places, over all configurations; inf where there is none.

    The bound is the sum of the lengths from joint to joint on the path between them. Prismatic joints have no
    bound, whatever their limits.
    """
    ancestors = set(_to_root(model, one.joint))
    top = next(joint for joint in _to_root(model, other.joint) if joint in ancestors)
    (first, way), (second, back) = (_climb(model, place, top) for place in (one, other))
    return float(np.linalg.norm(first - second)) + way + back


def _to_root(model: pin.Model, joint: int) -> list[int]:
    path = [joint]
    while path[-1]:
        path.append(int(model.parents[path[-1]]))
    return path


def _climb(model: pin.Model, place: LinkPoint, top: int) -> tuple[np.ndarray, float]:
    """Point of body ``top`` where the branch to ``place`` is attached, and the length from there to it."""
    joint, point, length = place.joint, place.point, 0.0
    while joint != top:
        turns = joint_kind(model, joint) in TURNING
        length += float(np.linalg.norm(point)) if turns else np.inf
        joint, point = int(model.parents[joint]), np.array(model.jointPlacements[joint].translation)
    return point, length
