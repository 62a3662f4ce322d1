"""Roles of a robot's feet, found from geometry alone and not from names.

Forward is the base's x axis and left is its y axis, as in all descriptions that follow REP 103.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
import pinocchio as pin

from trajopt.arguments import checked
from trajopt.dynamics.base_joint import BASE_JOINT
from trajopt.dynamics.model_quantities import contact_jacobian
from trajopt.errors import InputError
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.robot import Robot

# A contact higher above the lowest one than this fraction of the robot's length is a hand or a knee.
HAND_HEIGHT = 0.1
# Feet closer along an axis than this fraction of the robot's length cannot be distinguished by it.
FOOT_GAP = 0.02

# A joint nearer to its parent than this fraction of the robot's length counts as being at the same place.
SAME_JOINT = 0.25
# A frame nearer to a joint than this is at the joint, m.
SAME_PLACE = 1e-9
# Largest distance of a wheel's centre from the axis of its joint, over its radius.
OFF_AXIS = 1e-3


@checked
@dataclass(frozen=True, kw_only=True)
class Legs:
    """Names of the contacts of a quadruped's feet."""

    front_left: str
    front_right: str
    hind_left: str
    hind_right: str

    @property
    def by_role(self) -> Mapping[str, str]:
        """Contact name of every role, in the order of the fields."""
        return MappingProxyType(dict(vars(self)))

    @property
    def mirror(self) -> Mapping[str, str]:
        """Contact on the other side of the body, by contact."""
        pairs = ((self.front_left, self.front_right), (self.hind_left, self.hind_right))
        return MappingProxyType({name: other for pair in pairs for name, other in (pair, pair[::-1])})


@checked
def feet_in_base(robot: Robot, q: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """Positions (3,) of the robot's feet in the axes of its base, m, by contact name.

    They are taken at ``q`` (nq,), default the reference. Feet are the contacts that stand: hands and knees,
    higher by a tenth of the robot's length or more, are left out. For a planar robot the axes are the
    world's. Raises `InputError` for a robot on a fixed base, or without contacts.
    """
    if robot.base == "fixed" or not robot.contacts:
        raise InputError(
            f"robot '{robot.name}' has a {robot.base} base and {len(robot.contacts)} contacts",
            "allowed: a base that moves, on feet",
        )
    posture = robot.reference if q is None else np.asarray(q, dtype=float)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, posture)
    placements = contact_positions(robot, posture)
    lowest = min(position[2] for position in placements.values())
    base = data.oMi[BASE_JOINT[robot.base]].copy()
    if robot.base == "planar":  # its joint's y axis points up, the plane is the world's x-z plane
        base.rotation = np.eye(3)
    return {
        name: base.actInv(position)
        for name, position in placements.items()
        if position[2] - lowest < HAND_HEIGHT * robot.length
    }


@checked
def on_feet(robot: Robot) -> Robot:
    """The robot with its feet as its only contacts. Raises as `feet_in_base`."""
    return replace(robot, contacts=tuple(robot.contact(name) for name in feet_in_base(robot)))


@checked
def legs_only(robot: Robot) -> Robot:
    """The robot with its feet as its only contacts, and all joints that carry no foot locked.

    It serves tasks on legs alone: Talos has its left arm welded in the reference. A robot that only has legs
    is returned unchanged. Raises `InputError` for a robot on a fixed base, or without contacts.
    """
    kept, model = on_feet(robot), robot.model
    moved = {
        joint
        for foot in kept.contacts
        for joint in model.supports[model.frames[model.getFrameId(foot.frame)].parentJoint]
    }
    idle = [
        model.names[joint.id]
        for joint in list(model.joints)[1:]
        if joint.idx_v in robot.actuated_rows and joint.id not in moved
    ]
    if not idle and len(kept.contacts) == len(robot.contacts):
        return robot
    return kept.with_locked(idle) if idle else kept


@checked
def quadruped_legs(robot: Robot) -> Legs:
    """Roles of a quadruped's four feet in its reference posture. Raises `InputError`."""
    feet = feet_in_base(robot)
    if len(feet) != 4:
        raise InputError(f"robot '{robot.name}' has {len(feet)} feet", "allowed: a quadruped, 4 feet")
    hind, front = _halves(robot, feet, 0, "in front of each other")
    (front_right,), (front_left,) = _halves(robot, front, 1, "beside each other")
    (hind_right,), (hind_left,) = _halves(robot, hind, 1, "beside each other")
    return Legs(front_left=front_left, front_right=front_right, hind_left=hind_left, hind_right=hind_right)


@checked
def biped_legs(robot: Robot) -> tuple[str, str]:
    """Contacts of a robot's left and right foot in its reference posture. Raises `InputError`."""
    feet = feet_in_base(robot)
    if len(feet) != 2:
        raise InputError(f"robot '{robot.name}' has {len(feet)} feet", "allowed: a biped, 2 feet")
    (right,), (left,) = _halves(robot, feet, 1, "beside each other")
    return left, right


@checked
def feet_by_side(robot: Robot) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Contacts of a robot's left and right feet in its reference posture, each side from hind to front.

    Of an odd number of feet the left side has one more; of two feet on the midline the front one is left.
    Raises as `feet_in_base`.
    """
    feet, gap = feet_in_base(robot), FOOT_GAP * robot.length
    ordered = sorted(feet, key=lambda name: (round(feet[name][1] / gap), feet[name][0]))
    sides = ordered[len(feet) // 2 :], ordered[: len(feet) // 2]
    left, right = (tuple(sorted(side, key=lambda name: feet[name][0])) for side in sides)
    return left, right


@checked
def wheel_rows(robot: Robot) -> dict[str, int]:
    """Rows of v of the joints that turn wheels, by contact name.

    A wheel is a rolling contact whose centre is on the axis of the joint of its link.
    """
    model, rows = robot.model, {}
    for contact in robot.contacts:
        joint = model.joints[model.frames[model.getFrameId(contact.frame)].parentJoint]
        if contact.rolling and joint.nv == 1:
            motion = contact_jacobian(model, robot.reference, [(contact.frame, 6)])[:, joint.idx_v]
            if motion[3:].any() and np.linalg.norm(motion[:3]) < OFF_AXIS * contact.radius:
                rows[contact.name] = joint.idx_v
    return rows


@checked
def require_soles(robot: Robot) -> None:
    """Raise `InputError` for a robot with a point foot."""
    points = [name for name in feet_in_base(robot) if robot.contact(name).kind != "surface"]
    if points:
        raise InputError(
            f"robot '{robot.name}' stands on points: {', '.join(points)}",
            "allowed: a biped on soles (points walk in biped-gait)",
        )


def _halves(
    robot: Robot, feet: Mapping[str, np.ndarray], axis: int, how: str
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """The lower and the upper half of the feet along an axis of the base."""
    ordered = sorted(feet, key=lambda name: float(feet[name][axis]))
    half = len(ordered) // 2
    gap = feet[ordered[half]][axis] - feet[ordered[half - 1]][axis]
    least = FOOT_GAP * robot.length
    if not gap > least:
        raise InputError(
            f"feet {', '.join(ordered)} of robot '{robot.name}' are not {how} in its reference posture",
            f"allowed: more than {least:.3g} m apart, x forward and y to the left of the base",
        )
    return {name: feet[name] for name in ordered[:half]}, {name: feet[name] for name in ordered[half:]}


@checked
def leg_joints(robot: Robot) -> tuple[str, ...]:
    """Frames at the joints of the limbs, such as hips and knees.

    These are the root of each limb and every joint a link away from its parent: of joints close to each
    other only the inner one counts. Each joint is named by the first frame at its
    origin whose name is unique; a joint without such a frame is left out.
    """
    model, data = robot.model, robot.model.createData()
    pin.forwardKinematics(model, data, robot.reference)
    named = Counter(frame.name for frame in model.frames)
    joints = []
    for joint in range(2, model.njoints):
        parent = model.parents[joint]
        apart = np.linalg.norm(data.oMi[joint].translation - data.oMi[parent].translation)
        if parent != 1 and apart <= SAME_JOINT * robot.length:
            continue
        joints += [
            frame.name
            for frame in model.frames
            if frame.parentJoint == joint
            and named[frame.name] == 1
            and np.abs(frame.placement.translation).max() < SAME_PLACE
        ][:1]
    return tuple(joints)


def require_free_flyer(robot: Robot) -> None:
    """Raise `InputError` unless the robot's root is a free-flyer placed in world axes."""
    if robot.base != "freeflyer" or not robot.model.jointPlacements[1].isIdentity():
        raise InputError(
            f"robot '{robot.name}' has a {robot.base} base", "allowed: a free-flyer in world axes"
        )
