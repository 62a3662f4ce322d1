"""Half of a mirror-symmetric robot on a planar base: each pair of limbs is merged into the left one.

In a mirror-symmetric motion the base moves in its x-z plane, and both limbs of a pair move alike. The kinetic
and potential energy are those of the base in the plane and of one limb per pair with twice the mass, inertia
and armature. The limb may leave the plane, as an abducted leg does. Its joints have twice the torque and its
contacts twice the force. Joints of the midline that would leave the plane (yaw, roll) are locked first.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import position_limits
from trajopt.dynamics.rerooting import JOINT_ROWS, joint_slices
from trajopt.errors import InputError
from trajopt.reduced.scenes.reduction import FollowingPart, Reduction
from trajopt.robot.actuators.drive import Drive
from trajopt.robot.building import sagittal
from trajopt.robot.contact import Contact
from trajopt.robot.mirror import Mirror, keepers, mirrored_range, reflected, reflected_inertia
from trajopt.robot.robot import Robot


def turned_by_mirror(robot: Robot, mirror: Mirror) -> tuple[str, ...]:
    """Return the joints on the midline that a symmetric motion holds at zero, such as waist yaw and roll."""
    model = robot.model
    return tuple(
        model.names[j] for j in range(2, model.njoints) if mirror.partner[j] == j and mirror.sign[j] < 0
    )


def half_robot(robot: Robot, mirror: Mirror, images: Sequence[int], q: np.ndarray) -> Reduction:
    """Return the half of ``robot`` in the plane y = q[1]; ``images`` are those of `paired_contacts`.

    ``q`` (nq,) is the start. It must be its own mirror image, with the base heading along the world's x axis.
    """
    kept = keepers(robot, mirror, q)
    names, joints = robot.model.names, {}
    for joint, image in list(enumerate(mirror.partner))[2:]:
        joints[names[joint]] = FollowingPart(names[joint])
        if joint not in kept:
            joints[names[joint]] = FollowingPart(names[image], mirror.sign[joint], True)
    contacts = {
        contact.name: _contact_follower(robot, kept, contact, robot.contacts[image])
        for contact, image in zip(robot.contacts, images, strict=True)
    }
    kept_contacts = {follower.name for follower in contacts.values()}
    model, mirrored = _half_model(robot, mirror, kept, float(q[1]))
    small = _with_limits(robot, model, joints, tuple(c for c in robot.contacts if c.name in kept_contacts))
    made = Reduction(
        whole=robot, small=small, start=q, joints=joints, contacts=contacts, mirrored_frames=mirrored
    )
    return replace(made, small=_finished(made))


def _contact_follower(robot: Robot, kept: Sequence[int], contact: Contact, image: Contact) -> FollowingPart:
    """Map a contact on a kept limb to itself, and a pair on one midline body to the first of the two."""
    joint = int(robot.model.frames[robot.model.getFrameId(contact.frame)].parentJoint)
    names = [entry.name for entry in robot.contacts]
    image_joint = int(robot.model.frames[robot.model.getFrameId(image.frame)].parentJoint)
    earlier = names.index(contact.name) <= names.index(image.name)
    first = earlier if joint == image_joint else joint in kept
    return FollowingPart(contact.name) if first else FollowingPart(image.name, 1.0, True)


def _half_model(
    robot: Robot, mirror: Mirror, kept: Sequence[int], y0: float
) -> tuple[pin.Model, frozenset[str]]:
    model, new = robot.model, pin.Model()
    new.name, new.gravity = model.name, model.gravity
    placement = pin.SE3(np.eye(3), np.array([0.0, y0, 0.0]))
    numbers = {1: new.addJoint(0, pin.JointModelPlanar(), placement, model.names[1])}
    for joint in kept[1:]:
        parent = numbers[int(model.parents[joint])]
        numbers[joint] = new.addJoint(
            parent, model.joints[joint], model.jointPlacements[joint], model.names[joint]
        )
    for joint in kept:
        new.appendBodyToJoint(numbers[joint], model.inertias[joint], pin.SE3.Identity())
        image = mirror.partner[joint]
        if image != joint:
            other = reflected_inertia(mirror.offset[joint].act(model.inertias[image]))
            new.appendBodyToJoint(numbers[joint], other, pin.SE3.Identity())
    mirrored = _add_frames(model, new, mirror, numbers)
    _merge_rows(model, new, mirror, kept)
    return sagittal(new), mirrored


def _add_frames(
    model: pin.Model, new: pin.Model, mirror: Mirror, numbers: Mapping[int, int]
) -> frozenset[str]:
    """Add all frames under their names; frames of dropped bodies go to their mirror images."""
    mirrored = set()
    holders = {0: 0} | {joint: new.addJointFrame(joint, 0) for joint in numbers.values()}
    for frame in list(model.frames)[1:]:
        joint = int(frame.parentJoint)
        kind = pin.FrameType.OP_FRAME if frame.type == pin.FrameType.JOINT else frame.type
        placement = frame.placement
        if joint in numbers:
            at = numbers[joint]
        elif joint == 0:
            at = 0
        else:
            image = mirror.partner[joint]
            at, placement = numbers[image], reflected(mirror.offset[image] * frame.placement)
            mirrored.add(frame.name)
        if not new.existFrame(frame.name):
            new.addFrame(pin.Frame(frame.name, at, holders[at], placement, kind), False)
    return frozenset(mirrored)


def _merge_rows(model: pin.Model, new: pin.Model, mirror: Mirror, kept: Sequence[int]) -> None:
    """Add up the armatures of both joints of a pair; copy the other rows from the joint that is kept."""
    for joint in kept[1:]:
        name, image = model.names[joint], mirror.partner[joint]
        v, old = joint_slices(new, name)[1], joint_slices(model, name)[1]
        for row in JOINT_ROWS:
            getattr(new, row)[v] = getattr(model, row)[old]
        if image != joint:
            other = joint_slices(model, model.names[image])[1]
            new.armature[v] = model.armature[old] + model.armature[other]
            new.rotorInertia[v] = model.rotorInertia[old] + model.rotorInertia[other]


def _with_limits(
    robot: Robot, model: pin.Model, joints: Mapping[str, FollowingPart], contacts: tuple[Contact, ...]
) -> Robot:
    """Return the small robot with the tighter limits of each pair, and a neutral reference."""
    lower, upper = position_limits(model)
    lower[:], upper[:] = -np.inf, np.inf
    velocity = np.full(model.nv, np.inf)
    for name, follower in joints.items():
        old_q, old_v = joint_slices(robot.model, name)
        new_q, new_v = joint_slices(model, follower.name)
        velocity[new_v] = np.minimum(velocity[new_v], robot.velocity_limit[old_v])
        if old_q.stop - old_q.start == 1:
            entry = old_q.start
            low, high = mirrored_range(
                robot.position_lower[entry], robot.position_upper[entry], follower.sign
            )
            lower[new_q] = np.maximum(lower[new_q], low)
            upper[new_q] = np.minimum(upper[new_q], high)
    reference = np.clip(pin.neutral(model), lower, upper)
    if robot.thrusters or robot.joint_forces or robot.mimics:
        raise InputError(
            f"'{robot.name}' has thrusters, forces at joints, or joints that follow",
            "allowed in a half: none",
        )
    return Robot(
        name=f"{robot.name} (half)",
        model=model,
        base="planar",
        reference=reference,
        velocity_limit=velocity,
        position_lower=lower,
        position_upper=upper,
        contacts=contacts,
        passive=tuple(name for name in robot.passive if model.existJointName(name)),
        given_length=robot.length,
    )


def _finished(reduction: Reduction) -> Robot:
    """Return the small robot with the whole robot's reference, torque limits and drives."""
    whole, small = reduction.whole, reduction.small
    effort = None if whole.torque_limit is None else reduction.drop_torques(whole.torque_limit)
    drives = None
    if whole.drives is not None:
        shares = np.abs(reduction.shares)
        drives = tuple(_merged([whole.drives[row] for row in np.flatnonzero(column)]) for column in shares.T)
    reference = np.clip(reduction.drop_q(whole.reference), small.position_lower, small.position_upper)
    return replace(
        small,
        reference=reference,
        torque_limit=effort if effort is not None and np.isfinite(effort).any() else None,
        drives=drives,
    )


def _merged(drives: list[Drive | None]) -> Drive | None:
    """Merge n equal drives into one with n times the torque, inertia and friction at the same speed."""
    first, n = drives[0], len(drives)
    if first is None or n == 1:
        return first
    scaled = {
        name: n * getattr(first, name)
        for name in ("rotor_inertia", "viscous_friction", "coulomb_friction", "torque_limit", "stall_torque")
    }
    return replace(first, **scaled)
