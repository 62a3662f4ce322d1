"""From a numeric `pin.Model` to the arrays of a `Robot`: base, limits, reference."""

import contextlib
import math
from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from trajopt.arguments import checked
from trajopt.dynamics.base_joint import (
    BASE_COORDINATES,
    BASE_JOINT,
    BASE_POSITION,
    BASE_ROWS,
    UNLIMITED,
    Base,
    base_of,
    position_limits,
)
from trajopt.dynamics.rerooting import Body, copy_bodies
from trajopt.errors import InputError, UnsupportedJointError
from trajopt.robot.contact import Contact, require_frame
from trajopt.terrain.surface import SAME_PLANE

# A base lower than this fraction of the reach does not stand on its contacts: it lies, or hangs.
STANDING_PART = 0.05

# Feet less than this height in m above the ground are meant to be on it; Newton steps that put them there.
HEIGHT_ROUNDING, LEVELLING_STEPS = 1e-3, 4

# A plane counts as one of the world's coordinate planes up to rounding in description files.
ALIGNED = 1e-12
# Largest sine of the angle between a joint's axis and the normal of the plane it moves in: rounding, too.
PARALLEL = 1e-6

# Pinocchio's planar joint moves in its own x-y plane. This placement lays it in the
# sagittal plane: its x is the world's x, its y is up, and it turns about the world's -y.
SAGITTAL = pin.SE3(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]), np.zeros(3))


def within_plane(model: pin.Model, contacts: tuple[Contact, ...]) -> tuple[Contact, ...]:
    """Return contacts without the rows that a planar base makes meaningless; unchanged for other bases.

    A contact on a limb that can leave the plane (an abducted leg) keeps them: its foot could slide sideways.
    """
    if base_of(model) != "planar":
        return contacts
    normal = np.abs(model.jointPlacements[1].rotation[:, 2])
    axis = int(np.argmax(normal))
    if normal[axis] < 1 - ALIGNED:
        return contacts
    leaving = leaving_plane(model, axis, pin.neutral(model))
    return tuple(
        contact if _carried_by(model, contact.frame) & leaving else contact.within_plane(axis)
        for contact in contacts
    )


def leaving_plane(model: pin.Model, axis: int, q: np.ndarray) -> set[int]:
    """Joints behind the root whose motion at q (nq,) leaves planes normal to the world's axis ``axis``."""
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    leaving = set()
    for joint in range(2, model.njoints):
        rows = slice(model.joints[joint].idx_v, model.joints[joint].idx_v + model.joints[joint].nv)
        axes = data.J[:, rows].copy()
        # Motions in the plane: rotation about its normal, or translation within it.
        turning = np.delete(axes[3:], axis, axis=0)
        slides = axes[axis] if not axes[3:].any() else np.zeros(0)
        if (np.abs(turning) > PARALLEL).any() or (np.abs(slides) > PARALLEL).any():
            leaving.add(joint)
    return leaving


def planar_root(model: pin.Model) -> str:
    """Axes of the first three joints if they are two slides and a turn in one plane, else empty.

    Such as "bx along x, by along y, byaw about z", in the world at neutral.
    """
    if model.njoints < 4 or [*model.parents][1:4] != [0, 1, 2] or [*model.nvs][1:4] != [1, 1, 1]:
        return ""
    axes = pin.computeJointJacobians(model, model.createData(), pin.neutral(model))[:, :3]
    turning = axes[3:].any(axis=0)
    units = np.where(turning, axes[3:], axes[:3]).T
    if turning.sum() != 1 or np.abs(units @ units.T - np.eye(3)).max() > PARALLEL:
        return ""
    ways = ("about" if turns else "along" for turns in turning)
    told = zip(list(model.names)[1:4], ways, map(_direction, units), strict=True)
    return ", ".join(" ".join(words) for words in told)


def _direction(unit: np.ndarray) -> str:
    """A unit vector (3,) as an axis, such as "-y", or as numbers."""
    for letter, number in zip("xyz", unit, strict=True):
        if abs(number) > 1 - PARALLEL:
            return letter if number > 0 else f"-{letter}"
    return "(" + ", ".join(f"{number:.3g}" for number in unit) + ")"


def _carried_by(model: pin.Model, frame: str) -> set[int]:
    """Joints between the root and a frame; none for a frame that does not exist."""
    carrier = model.frames[model.getFrameId(frame)].parentJoint if model.existFrame(frame) else 0
    return set(model.supports[carrier])


@checked
def sagittal(model: pin.Model) -> pin.Model:
    """Return ``model`` with its planar root joint turned into the world's x-z plane.

    The configuration of the root is (x, z, cos, sin) of the pitch, nose up; its velocity is
    (forward, up) in the base's axes and the pitch rate. Bodies keep their pose at neutral.
    """
    turned = pin.Model(model)
    inverse = SAGITTAL.inverse()
    turned.jointPlacements[1] = turned.jointPlacements[1] * SAGITTAL
    turned.inertias[1] = inverse.act(turned.inertias[1])
    for joint in range(2, turned.njoints):
        if turned.parents[joint] == 1:
            turned.jointPlacements[joint] = inverse * turned.jointPlacements[joint]
    for frame in turned.frames:
        if frame.parentJoint == 1 and frame.type != pin.FrameType.JOINT:
            frame.placement = inverse * frame.placement
    return turned


def locked_model(model: pin.Model, joints: Sequence[str], reference: np.ndarray) -> pin.Model:
    """Return ``model`` with ``joints`` welded at their value in ``reference`` (nq,)."""
    known = list(model.names)[1:]
    for name in joints:
        if name not in known:
            raise InputError(f"joint '{name}' to lock is unknown", "one of " + ", ".join(known))
    if all(model.existFrame(name, pin.FrameType.JOINT) for name in known):
        with contextlib.suppress(ValueError):  # of frames that share a name
            return pin.buildReducedModel(model, [model.getJointId(name) for name in joints], reference)
    # It needs a frame for each joint; in an MJCF file a body may have the name instead.
    new, bodies = pin.Model(), {0: Body(0, pin.SE3.Identity())}
    new.name, new.gravity = model.name, model.gravity
    for index, name in enumerate(known, start=1):
        joint, on = model.joints[index], bodies[int(model.parents[index])]
        place = on.placement * model.jointPlacements[index]
        if name in joints:
            data = joint.createData()
            joint.calc(data, reference)
            bodies[index] = Body(on.joint, place * data.M)
        else:
            bodies[index] = Body(new.addJoint(on.joint, joint, place, name), pin.SE3.Identity())
    copy_bodies(model, new, bodies)
    return new


def with_frames(model: pin.Model, frames: Mapping[str, tuple[str, ArrayLike, ArrayLike]]) -> pin.Model:
    """Return a copy of ``model`` with frames that are fixed to others.

    ``frames`` maps a name to another frame, and position (3,), m, and roll, pitch, yaw (3,), rad, in it.
    Raises `InputError` for an unknown or a repeated frame.
    """
    new = pin.Model(model)
    for name, (other, position, angles) in frames.items():
        require_frame(new, other, f"frame '{name}'")
        if new.existFrame(name):
            raise InputError(f"frame '{name}' to add is in the model already", "allowed: another name")
        index = new.getFrameId(other)
        turn = pin.rpy.rpyToMatrix(np.array(angles, dtype=float))
        place = new.frames[index].placement * pin.SE3(turn, np.array(position, dtype=float))
        new.addFrame(pin.Frame(name, new.frames[index].parentJoint, index, place, pin.FrameType.OP_FRAME))
    return new


def velocity_limit_of(model: pin.Model, base: Base) -> np.ndarray:
    """Return the velocity limits (nv,), infinite at the base and where there is none."""
    limit = np.where(np.abs(model.upperVelocityLimit) > UNLIMITED, np.inf, np.abs(model.upperVelocityLimit))
    limit[: BASE_ROWS[base]] = np.inf
    return limit


def unactuated_rows(model: pin.Model, base: Base, passive: Sequence[str]) -> np.ndarray:
    """Return the rows of v of the base and of the ``passive`` joints; raises `InputError`."""
    behind = [model.names[joint.id] for joint in list(model.joints)[1:] if joint.idx_v >= BASE_ROWS[base]]
    for name in passive:
        if name not in behind:
            raise InputError(f"passive joint '{name}' is unknown", "one of " + ", ".join(behind))
        if list(passive).count(name) > 1:
            raise InputError(f"passive joint '{name}' is named twice", "each joint once")
    return np.sort(np.concatenate([np.arange(BASE_ROWS[base]), joint_entries(model, passive)[1]]))


def torque_limit_of(model: pin.Model, base: Base, passive: Sequence[str]) -> np.ndarray | None:
    """Return the torque limit (nu,) on the joint side, or None if no actuated row has one."""
    effort = np.delete(model.upperEffortLimit, unactuated_rows(model, base, passive))
    limit = np.where(np.abs(effort) > UNLIMITED, np.inf, np.abs(effort))
    return limit if np.isfinite(limit).any() else None


def reference_posture(
    model: pin.Model,
    base: Base,
    contacts: Sequence[Contact],
    posture: ArrayLike | Mapping[str, float] | None,
) -> np.ndarray:
    """Return the reference configuration (nq,).

    ``posture`` is a whole configuration (nq,), which is returned as it is; the positions of the joints behind
    the base (nq - base), in order or by name (others stay at neutral); or None for neutral within the limits.
    Except for a whole configuration, the base is level, at x = y = 0, at the height at which the lowest of
    the contacts touches level ground at height 0, see `put_on_ground`.
    """
    if posture is not None and not isinstance(posture, Mapping):
        given = np.array(posture, dtype=float)
        joints = model.nq - BASE_COORDINATES[base]
        if given.shape == (model.nq,):
            return given
        if given.shape != (joints,):
            raise InputError(
                f"reference has shape {given.shape}", f"({model.nq},) or, joints alone, ({joints},)"
            )
        q = np.concatenate([pin.neutral(model)[: BASE_COORDINATES[base]], given])
    else:
        q = named_posture(model, posture or {}, np.clip(pin.neutral(model), *position_limits(model)))
    return put_on_ground(model, base, contacts, q)


def named_posture(model: pin.Model, values: Mapping[str, float], others: np.ndarray) -> np.ndarray:
    """Return a configuration (nq,) with joints at ``values`` by name, and at ``others`` (nq,)."""
    q = others.copy()
    for name, value in values.items():
        if not model.existJointName(name):
            raise InputError(f"joint '{name}' of the reference is unknown", ", ".join(list(model.names)[1:]))
        joint = model.joints[model.getJointId(name)]
        if joint.nv != 1:
            raise UnsupportedJointError(name, joint.shortname(), "joints of one angle or one length, by name")
        q[joint.idx_q] = np.cos(value) if joint.nq == 2 else value
        if joint.nq == 2:
            q[joint.idx_q + 1] = np.sin(value)
    return q


def put_on_ground(model: pin.Model, base: Base, contacts: Sequence[Contact], q: np.ndarray) -> np.ndarray:
    """Return ``q`` with the base moved up or down until the lowest of ``contacts`` touches height 0.

    Angles are often rounded, so points less than `HEIGHT_ROUNDING` higher are also moved onto the ground, by
    the least change of the joints.
    """
    if base == "fixed" or not contacts:
        return q
    upright = q.copy()
    height = BASE_POSITION[base] - 1
    data = model.createData()
    pin.framesForwardKinematics(model, data, upright)
    up = (model.jointPlacements[1].rotation.T @ np.array([0.0, 0.0, 1.0]))[height]
    if abs(up) < 0.5:
        return upright
    lowest = min(
        data.oMf[model.getFrameId(contact.frame)].translation[2] - contact.radius for contact in contacts
    )
    upright[height] -= lowest / up
    return _levelled(model, base, contacts, upright)


def _levelled(model: pin.Model, base: Base, contacts: Sequence[Contact], q: np.ndarray) -> np.ndarray:
    """Return ``q`` with point contacts up to `HEIGHT_ROUNDING` above height 0 moved onto it."""
    if any(contact.kind != "point" for contact in contacts):
        return q
    data, first, level = model.createData(), BASE_ROWS[base], q
    for step in range(LEVELLING_STEPS):
        pin.computeJointJacobians(model, data, level)
        frames = [model.getFrameId(contact.frame) for contact in contacts]
        pin.updateFramePlacements(model, data)
        heights = [data.oMf[frame].translation[2] for frame in frames]
        gaps = np.array([height - contact.radius for height, contact in zip(heights, contacts, strict=True)])
        if step == 0 and not SAME_PLANE < np.abs(gaps).max() < HEIGHT_ROUNDING:
            return q
        world = (pin.getFrameJacobian(model, data, f, pin.LOCAL_WORLD_ALIGNED)[2, first:] for f in frames)
        moved = np.linalg.lstsq(np.array(list(world)), -gaps, rcond=None)[0]
        level = pin.integrate(model, level, np.concatenate([np.zeros(first), moved]))
    lower, upper = position_limits(model)
    return level if np.all((lower <= level) & (level <= upper)) and np.abs(gaps).max() < SAME_PLANE else q


def reach(model: pin.Model) -> float:
    """Return the longest sum of link lengths (m) from the root to any frame or centre of mass."""
    along = np.zeros(model.njoints)
    for joint in range(2, model.njoints):
        step = math.hypot(*model.jointPlacements[joint].translation)
        along[joint] = along[model.parents[joint]] + step
    tips = [
        along[frame.parentJoint] + math.hypot(*frame.placement.translation)
        for frame in model.frames
        if frame.parentJoint > 0
    ]
    centres = [along[joint] + math.hypot(*model.inertias[joint].lever) for joint in range(1, model.njoints)]
    return float(max([*tips, *centres], default=0.0))


def joint_entries(model: pin.Model, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices in q and in v of the joints with these names."""
    kept = [model.joints[model.getJointId(name)] for name in names]
    rows_q = [np.arange(joint.idx_q, joint.idx_q + joint.nq) for joint in kept]
    rows_v = [np.arange(joint.idx_v, joint.idx_v + joint.nv) for joint in kept]
    nothing = [np.zeros(0, dtype=int)]
    return np.concatenate(rows_q or nothing), np.concatenate(rows_v or nothing)


def characteristic_length(
    model: pin.Model, base: Base, frames: Sequence[str], reference: np.ndarray
) -> float:
    """Return a robot's length in m: its base's height over contact ``frames``, or its reach.

    See `Robot.length`; the height is taken in the posture ``reference`` (nq,).
    """
    extent = reach(model)
    if base != "fixed" and frames:
        data = model.createData()
        pin.framesForwardKinematics(model, data, reference)
        feet = [data.oMf[model.getFrameId(frame)].translation[2] for frame in frames]
        height = float(data.oMi[BASE_JOINT[base]].translation[2] - np.mean(feet))
        if height > STANDING_PART * extent:
            return height
    return extent if extent > 0 else 1.0
