"""MJCF files: MuJoCo compiles them, and a `pin.Model` is built from what it compiled.

Coordinates are MuJoCo's qpos, joint by joint in its order; only quaternions are (x, y, z, w). The tree of the
free joint comes first, as a base does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import Base, base_of, position_limits
from trajopt.dynamics.virtual_base import DEFAULT_ORDER, from_free_flyer, virtual_model
from trajopt.errors import InputError
from trajopt.robot.building import sagittal
from trajopt.robot.mjcf_actuators import effort_limits
from trajopt.robot.mujoco_package import mujoco_package, muted_mujoco
from trajopt.robot.reading import existing_file

# An axis is a coordinate axis up to the rounding of its normalisation.
ALIGNED = 1e-15
HOME = "home"
# A keyframe may be at a limit, up to the rounding of files, rad or m.
LIMIT_SLACK = 1e-6


@dataclass(frozen=True, kw_only=True)
class MjcfRobot:
    """What an MJCF file says of a robot. ``model`` has the base that was asked for.

    passive: joints without actuator, of a file with actuators. home: the keyframe as a reference, for
    `Robot.from_model`; None without one within the limits.
    """

    model: pin.Model
    passive: tuple[str, ...]
    home: np.ndarray | None


@dataclass(frozen=True)
class _Body:
    """Where a body of MuJoCo's is: its joint in the model, its placement there, its frame."""

    joint: int
    placement: pin.SE3
    frame: int


@dataclass
class _Build:
    compiled: Any
    model: pin.Model = field(default_factory=pin.Model)
    taken: set[str] = field(default_factory=set)
    bodies: dict[int, _Body] = field(default_factory=dict)


def compile_mjcf(path: str | Path) -> Any:
    """The ``mujoco.MjModel`` of a file. Raises `InputError` for a file that MuJoCo cannot read."""
    source = existing_file(path, "MJCF")
    with muted_mujoco("reading MJCF"):
        try:
            return mujoco_package().MjModel.from_xml_path(str(source))
        except (ValueError, RuntimeError) as error:
            reason = " ".join(str(error).split())
            raise InputError(f"{source} is not a readable MJCF file: {reason}") from None


def read_mjcf(path: str | Path, compiled: Any, base: Base | None) -> MjcfRobot:
    """The robot of a compiled file; ``base=None`` takes the base that the file has.

    A file with a free joint of its own has a floating base: a different ``base`` raises `InputError`. A file
    without one gets the requested base, above all bodies that move.
    """
    plain = mjcf_model(path, compiled)
    kind = base_of(plain)
    model = plain
    if base not in (None, kind) and kind == "fixed":
        root = pin.JointModelPlanar() if base == "planar" else pin.JointModelFreeFlyer()
        model = mjcf_model(path, compiled, root)
        model = sagittal(model) if base == "planar" else model
    elif base not in (None, kind) and (kind, base) != ("freeflyer", "virtual"):
        raise InputError(
            f"{path} has a {kind} root joint of its own, base={base!r} contradicts it", f"{kind!r}"
        )
    home = _home(compiled, plain)
    if base == "virtual" and kind != "virtual":
        model = virtual_model(model)
        if kind == "freeflyer" and home is not None:
            still = np.zeros(plain.nv)
            home = from_free_flyer(DEFAULT_ORDER, home, still, still)[0]
    driven = effort_limits(compiled).driven
    free = compiled.jnt_type == mujoco_package().mjtJoint.mjJNT_FREE
    passive = [name for name, idle in zip(joint_names(compiled), ~driven & ~free, strict=True) if idle]
    return MjcfRobot(model=model, passive=tuple(passive) if driven.any() else (), home=home)


def mjcf_model(path: str | Path, compiled: Any, root: Any = None) -> pin.Model:
    """The model of a compiled file, with a joint ``root`` above all bodies that move, if one is given."""
    build = _Build(compiled)
    model, free = build.model, _free_bodies(path, compiled)
    model.name = bytes(compiled.names).split(b"\0")[0].decode()
    gravity_off = compiled.opt.disableflags & mujoco_package().mjtDisableBit.mjDSBL_GRAVITY
    model.gravity = pin.Motion(np.zeros(3) if gravity_off else compiled.opt.gravity.copy(), np.zeros(3))
    names = body_names(compiled)
    build.taken |= {"universe", *names[1:]}
    build.bodies[0] = rooted = _Body(0, pin.SE3.Identity(), 0)
    moving = set(robot_bodies(compiled))
    if root is not None:
        own = unique("root_joint", build.taken | set(joint_names(compiled)))
        joint = model.addJoint(0, root, pin.SE3.Identity(), own)
        rooted = _Body(joint, pin.SE3.Identity(), model.addJointFrame(joint, 0))
    first = {int(compiled.body_rootid[body]) for body in free}
    order = sorted(range(1, compiled.nbody), key=lambda body: int(compiled.body_rootid[body]) not in first)
    added: dict[int, int] = {}
    for body in order:
        parent = int(compiled.body_parentid[body])
        holder = rooted if parent == 0 and body in moving else build.bodies[parent]
        on = _add_joints(build, body, holder, added)
        frame = pin.Frame(names[body], on.joint, on.frame, on.placement, pin.FrameType.BODY)
        build.bodies[body] = _Body(on.joint, on.placement, model.addFrame(frame))
        turned = rotation(compiled.body_iquat[body])
        inertia = turned @ np.diag(compiled.body_inertia[body]) @ turned.T
        lumped = pin.Inertia(float(compiled.body_mass[body]), compiled.body_ipos[body].copy(), inertia)
        model.appendBodyToJoint(on.joint, lumped, on.placement)
    _add_rows(compiled, model, added)
    _add_points(build, moving)
    return model


def _free_bodies(path: str | Path, compiled: Any) -> list[int]:
    kinds = compiled.jnt_type == mujoco_package().mjtJoint.mjJNT_FREE
    free = [int(body) for body in compiled.jnt_bodyid[kinds]]
    if len(free) > 1:
        names = body_names(compiled)
        others = ", ".join(f"'{names[body]}'" for body in free[1:])
        raise InputError(f"{path} has free bodies besides '{names[free[0]]}': {others}", "one free joint")
    return free


def _add_joints(build: _Build, body: int, holder: _Body, added: dict[int, int]) -> _Body:
    """Add the joints of a body in series; returns where the body is. ``added``: MuJoCo's joint -> joint."""
    compiled, kinds = build.compiled, mujoco_package().mjtJoint
    joint, frame = holder.joint, holder.frame
    place = holder.placement * placement(compiled.body_pos[body], compiled.body_quat[body])
    start, names = int(compiled.body_jntadr[body]), joint_names(compiled)
    for index in range(start, start + int(compiled.body_jntnum[body])):
        kind, axis, anchor = compiled.jnt_type[index], compiled.jnt_axis[index], compiled.jnt_pos[index]
        zero = float(compiled.qpos0[compiled.jnt_qposadr[index]])
        at = place * pin.SE3(np.eye(3), anchor.copy())
        if kind == kinds.mjJNT_FREE:
            jointed, at, anchor = pin.JointModelFreeFlyer(), pin.SE3.Identity(), np.zeros(3)
        elif kind == kinds.mjJNT_BALL:
            jointed = pin.JointModelSpherical()
        elif kind == kinds.mjJNT_SLIDE:
            jointed, at = _straight("P", axis), at * pin.SE3(np.eye(3), -zero * axis)
        else:
            jointed, at = _straight("R", axis), at * pin.SE3(pin.exp3(-zero * axis), np.zeros(3))
        joint = added[index] = build.model.addJoint(joint, jointed, at, names[index])
        if names[index] not in build.taken:
            build.taken.add(names[index])
            frame = build.model.addJointFrame(joint, frame)
        place = pin.SE3(np.eye(3), -anchor)
    return _Body(joint, place, frame)


def _straight(kind: str, axis: np.ndarray) -> Any:
    """A joint of one coordinate, "R" about or "P" along an axis."""
    for letter, unit in zip("XYZ", np.eye(3), strict=True):
        if np.abs(axis - unit).max() <= ALIGNED:
            return getattr(pin, f"JointModel{kind}{letter}")()
    name = "JointModelRevoluteUnaligned" if kind == "R" else "JointModelPrismaticUnaligned"
    return getattr(pin, name)(axis.copy())


def _add_rows(compiled: Any, model: pin.Model, added: dict[int, int]) -> None:
    """Limits, armature and friction of joints; those that MuJoCo does not limit have none."""
    actuation = effort_limits(compiled)
    for limit, sign in (("upper", 1), ("lower", -1)):
        for what in ("Effort", "Velocity", "Position"):
            getattr(model, f"{limit}{what}Limit")[:] = sign * np.inf
    for index, joint in added.items():
        row, start = model.joints[joint], int(compiled.jnt_dofadr[index])
        v, dofs = slice(row.idx_v, row.idx_v + row.nv), slice(start, start + row.nv)
        model.armature[v] = compiled.dof_armature[dofs]
        model.damping[v] = compiled.dof_damping[dofs]
        model.upperDryFrictionLimit[v] = compiled.dof_frictionloss[dofs]
        model.lowerDryFrictionLimit[v] = -compiled.dof_frictionloss[dofs]
        if row.nv == 1:
            model.armature[v] += actuation.armature[index]
            model.upperEffortLimit[v] = actuation.effort[index]
            model.lowerEffortLimit[v] = -actuation.effort[index]
        if row.nv == 1 and compiled.jnt_limited[index]:
            model.lowerPositionLimit[row.idx_q], model.upperPositionLimit[row.idx_q] = compiled.jnt_range[
                index
            ]


def _add_points(build: _Build, moving: set[int]) -> None:
    """Add frames of colliding balls and of sites, which feet may be."""
    compiled, kinds = build.compiled, mujoco_package().mjtObj
    touching = (compiled.geom_contype | compiled.geom_conaffinity) != 0
    balls = touching & (compiled.geom_type == mujoco_package().mjtGeom.mjGEOM_SPHERE)
    for index in np.flatnonzero(balls).tolist():
        body = int(compiled.geom_bodyid[index])
        if body in moving:
            name = mujoco_package().mj_id2name(compiled, kinds.mjOBJ_GEOM, index)
            _add_point(build, name, "ball", body, compiled.geom_pos[index], compiled.geom_quat[index])
    for index in range(compiled.nsite):
        name, body = (
            mujoco_package().mj_id2name(compiled, kinds.mjOBJ_SITE, index),
            compiled.site_bodyid[index],
        )
        if name:
            _add_point(build, name, "site", int(body), compiled.site_pos[index], compiled.site_quat[index])


def _add_point(
    build: _Build, name: str | None, kind: str, body: int, position: np.ndarray, quaternion: np.ndarray
) -> None:
    on, owner = build.bodies[body], body_names(build.compiled)[body]
    own = name if name and name not in build.taken else unique(f"{name or owner}_{kind}", build.taken)
    build.taken.add(own)
    place = on.placement * placement(position, quaternion)
    build.model.addFrame(pin.Frame(own, on.joint, on.frame, place, pin.FrameType.OP_FRAME))


def _home(compiled: Any, model: pin.Model) -> np.ndarray | None:
    """The keyframe "home", or else the first, if it is within the limits."""
    kind = mujoco_package().mjtObj.mjOBJ_KEY
    named = [mujoco_package().mj_id2name(compiled, kind, index) for index in range(compiled.nkey)]
    if not named:
        return None
    q = configuration(compiled, model, compiled.key_qpos[named.index(HOME) if HOME in named else 0])
    lower, upper = position_limits(model)
    return q if np.isfinite(q).all() and (np.abs(np.clip(q, lower, upper) - q) < LIMIT_SLACK).all() else None


def configuration(compiled: Any, model: pin.Model, qpos: np.ndarray) -> np.ndarray:
    """Configuration (nq,) of the model at MuJoCo's qpos: m, rad, quaternions (x, y, z, w)."""
    q = pin.neutral(model)
    for name, start in zip(joint_names(compiled), compiled.jnt_qposadr, strict=True):
        joint = model.joints[model.getJointId(name)]
        values = qpos[start : start + joint.nq].copy()
        if joint.nq >= 4:
            values[-4:] = np.roll(values[-4:], -1) / np.linalg.norm(values[-4:])
        q[joint.idx_q : joint.idx_q + joint.nq] = values
    return q


def robot_bodies(compiled: Any) -> list[int]:
    """Bodies of trees with joints, all if there are none: the others are the scene."""
    moving = {int(compiled.body_rootid[body]) for body in compiled.jnt_bodyid}
    every = range(1, int(compiled.nbody))
    return [body for body in every if not moving or int(compiled.body_rootid[body]) in moving]


def body_names(compiled: Any) -> list[str]:
    """Names of all bodies, the world's first; those without are numbered."""
    kind = mujoco_package().mjtObj.mjOBJ_BODY
    return _names(compiled, kind, [f"body{index}" for index in range(compiled.nbody)])


def joint_names(compiled: Any) -> list[str]:
    """Names of all joints; those without are named after their bodies."""
    names, kind = body_names(compiled), mujoco_package().mjtObj.mjOBJ_JOINT
    return _names(compiled, kind, [f"{names[body]}_joint" for body in compiled.jnt_bodyid])


def _names(compiled: Any, kind: Any, otherwise: Sequence[str]) -> list[str]:
    given = [mujoco_package().mj_id2name(compiled, kind, index) for index in range(len(otherwise))]
    taken = {name for name in given if name}
    return [name or unique(other, taken) for name, other in zip(given, otherwise, strict=True)]


def unique(name: str, taken: set[str]) -> str:
    """The name, with a number if it is ``taken`` already; it is added to them."""
    number, found = 1, name
    while found in taken:
        number, found = number + 1, f"{name}_{number + 1}"
    taken.add(found)
    return found


def placement(position: np.ndarray, quaternion: np.ndarray) -> pin.SE3:
    """Placement at MuJoCo's position and quaternion (w, x, y, z)."""
    return pin.SE3(rotation(quaternion), position.copy())


def rotation(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrix of MuJoCo's quaternion (w, x, y, z)."""
    w, x, y, z = quaternion
    return np.array(pin.Quaternion(w, x, y, z).normalized().toRotationMatrix())
