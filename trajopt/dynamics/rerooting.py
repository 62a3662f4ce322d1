"""Re-rooting of a floating model at another of its bodies: the same tree, seen from a contact point.

A joint of one degree of freedom places its child in its parent at ``M exp(S q)``. Seen from the child
the parent is at ``exp(-S q) M^-1``. With T a half turn about an axis perpendicular to S,
``exp(-S q) = T exp(S q) T^-1``: the joint of the same kind, placed at T. A reversed joint therefore keeps the
name, coordinate, rate, torque, armature and limits of the original.

Pinocchio's graphs (``pin.graph``) also reverse joints, but need the robot as a graph to begin with. Version
4.1 leaves a body's inertia at its joint where the body's frame lies elsewhere, as it does behind every
reversed joint (`docs/modelling/coordinates.md`).
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError, UnsupportedJointError

# Name of the frame of a re-rooted model that lies where the floating base's joint was.
BASE_FRAME = "floating_base"
# Rows of a model (nv,) that belong to a joint and stay with it.
JOINT_ROWS = (
    "armature", "rotorInertia", "rotorGearRatio", "damping",
    "upperEffortLimit", "lowerEffortLimit", "upperVelocityLimit", "lowerVelocityLimit",
    "upperDryFrictionLimit", "lowerDryFrictionLimit",
)  # fmt: skip


@dataclass(frozen=True)
class Body:
    """A body of the old model: its joint in the new model, and its old frame in that joint's frame."""

    joint: int
    placement: pin.SE3


def path_to_base(model: pin.Model, joint: int) -> list[int]:
    """Return the joints from ``joint`` up to the base, joint 1, both included.

    Raises `UnsupportedJointError` for a joint with more than one degree of freedom.
    """
    path = [joint]
    while path[-1] != 1:
        if path[-1] == 0:
            raise InputError(
                f"the contact on joint '{model.names[joint]}' is not on a limb of the base", "one on a limb"
            )
        path.append(int(model.parents[path[-1]]))
    for index in path[:-1]:
        if model.joints[index].nv != 1:
            raise UnsupportedJointError(
                model.names[index],
                model.joints[index].shortname().removeprefix("JointModel"),
                "joints of one degree of freedom between base and contact; lock it",
            )
    return path


def joint_motion(joint: pin.JointModel) -> pin.Motion:
    """Motion subspace of a joint of one degree of freedom, in its own frame."""
    data, q = joint.createData(), np.zeros(joint.idx_q + joint.nq)
    q[joint.idx_q] = float(joint.nq == 2)  # (cos, sin) of a continuous joint
    joint.calc(data, q)
    return pin.Motion(np.ravel(data.S))


def reroot(
    model: pin.Model, frame: str, passive: pin.JointModel, passive_name: str, root: pin.SE3
) -> pin.Model:
    """Return ``model`` standing on ``frame``, which a ``passive`` joint connects to the world at ``root``.

    The passive joint comes first, then the joints from there to the base, then the limbs; all but the first
    keep their name, coordinate and rows. With the passive joint at neutral, the frame's body is oriented as
    in the neutral configuration of ``model``. Frames are kept; `BASE_FRAME` is where joint 1 was. Raises
    `InputError`, `UnsupportedJointError`.
    """
    foot = model.frames[model.getFrameId(frame)]
    path = path_to_base(model, int(foot.parentJoint))
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    turned = root.rotation.T @ data.oMi[foot.parentJoint].rotation
    new = pin.Model()
    new.name, new.gravity = f"{model.name} on {frame}", model.gravity
    first = new.addJoint(0, passive, root, passive_name)
    bodies = {path[0]: Body(first, pin.SE3(turned, -turned @ foot.placement.translation))}
    for child, parent in pairwise(path):
        body, half_turn = bodies[child], _half_turn(joint_motion(model.joints[child]))
        placement = body.placement * half_turn
        reverse = new.addJoint(body.joint, model.joints[child], placement, model.names[child])
        bodies[parent] = Body(reverse, half_turn.inverse() * model.jointPlacements[child].inverse())
    for joint in reversed(path):  # the base's limbs first: Pinocchio needs a depth-first order
        _hang_limbs(model, new, joint, path, bodies)
    copy_bodies(model, new, bodies)
    if not new.existFrame(BASE_FRAME):
        base = bodies[1]
        new.addFrame(pin.Frame(BASE_FRAME, base.joint, 0, base.placement, pin.FrameType.OP_FRAME))
    return new


def _half_turn(motion: pin.Motion) -> pin.SE3:
    """A half turn about an axis perpendicular to that of the joint, which it reverses."""
    axis = motion.angular if np.any(motion.angular) else motion.linear
    perpendicular = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    perpendicular /= np.linalg.norm(perpendicular)
    return pin.SE3(2 * np.outer(perpendicular, perpendicular) - np.eye(3), np.zeros(3))


def _hang_limbs(
    model: pin.Model, new: pin.Model, joint: int, path: list[int], bodies: dict[int, Body]
) -> None:
    """Add the limbs of ``joint`` that are not on the path, and record where their bodies are."""
    limbs = {joint}
    for index in range(1, model.njoints):
        parent = int(model.parents[index])
        if parent in limbs and index not in path:
            limbs.add(index)
            at = bodies[parent]
            placement = at.placement * model.jointPlacements[index]
            added = new.addJoint(at.joint, model.joints[index], placement, model.names[index])
            bodies[index] = Body(added, pin.SE3.Identity())


def joint_slices(model: pin.Model, name: str) -> tuple[slice, slice]:
    """Return the entries of a joint in q and in v."""
    joint = model.joints[model.getJointId(name)]
    return slice(joint.idx_q, joint.idx_q + joint.nq), slice(joint.idx_v, joint.idx_v + joint.nv)


def joints_with(model: pin.Model, marked: np.ndarray) -> list[str]:
    """Return the names of joints with a true entry in ``marked``, a mask (nq,) of q or (nv,) of v."""
    rows = 0 if len(marked) == model.nq else 1
    return [name for name in list(model.names)[1:] if marked[joint_slices(model, name)[rows]].any()]


def copy_bodies(model: pin.Model, new: pin.Model, bodies: dict[int, Body]) -> None:
    """Copy the inertias and frames of the old model's bodies, and the rows and limits of its joints."""
    for joint, body in bodies.items():
        new.appendBodyToJoint(body.joint, model.inertias[joint], body.placement)
    _copy_rows(model, new)
    _copy_frames(model, new, bodies)


def _copy_rows(model: pin.Model, new: pin.Model) -> None:
    """Copy rows and limits to the joints of the same name; other joints have no limits and no effort."""
    for name in list(new.names)[1:]:
        q, v = joint_slices(new, name)
        if not model.existJointName(name):
            for row in JOINT_ROWS[:4]:
                getattr(new, row)[v] = 0.0
            new.upperEffortLimit[v], new.lowerEffortLimit[v] = 0.0, 0.0
            new.upperVelocityLimit[v], new.lowerVelocityLimit[v] = np.inf, -np.inf
            new.lowerPositionLimit[q], new.upperPositionLimit[q] = -np.inf, np.inf
            continue
        old_q, old_v = joint_slices(model, name)
        for row in JOINT_ROWS:
            getattr(new, row)[v] = getattr(model, row)[old_v]
        new.lowerPositionLimit[q] = model.lowerPositionLimit[old_q]
        new.upperPositionLimit[q] = model.upperPositionLimit[old_q]


def _copy_frames(model: pin.Model, new: pin.Model, bodies: dict[int, Body]) -> None:
    """Copy the old model's frames on bodies and the world; frames of joints move with their joints."""
    holders = dict.fromkeys(range(new.njoints), 0)
    for joint, name in enumerate(list(new.names)[1:], start=1):
        # A model may give a joint no frame, where a link has its name.
        if model.existFrame(name, pin.FrameType.JOINT) or not model.existFrame(name):
            holders[joint] = new.addJointFrame(joint, 0)
    world = {0: Body(0, pin.SE3.Identity())}
    for frame in list(model.frames)[1:]:
        if new.existFrame(frame.name, frame.type):
            continue
        body = (bodies | world)[int(frame.parentJoint)]
        kind = pin.FrameType.OP_FRAME if frame.type == pin.FrameType.JOINT else frame.type
        placement = body.placement * frame.placement
        moved = pin.Frame(frame.name, body.joint, holders[body.joint], placement, kind, frame.inertia)
        new.addFrame(moved, False)
