"""MJCF files: MuJoCo compiles them, and a `pin.Model` and its shapes are built from the result.

Coordinates are those of MuJoCo's qpos, joint by joint, except that quaternions are (x, y, z, w).
"""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import BASE_JOINT, Base, base_of, position_limits
from trajopt.dynamics.rerooting import Body
from trajopt.dynamics.virtual_base import DEFAULT_ORDER, from_free_flyer, virtual_model
from trajopt.errors import InputError
from trajopt.robot.actuators.actuation import Thruster
from trajopt.robot.building import planar_root, sagittal
from trajopt.robot.mjcf_actuators import BALL, FREE, HINGE, SLIDE, actuation_of
from trajopt.robot.mujoco_package import mujoco_package, muted_mujoco
from trajopt.robot.reading import existing_file
from trajopt.robot.validation import LIMIT_SLACK

# An axis within this of a coordinate axis is that axis: rounding of its normalisation.
ALIGNED = 1e-15
HOME = "home"
SPHERE = 2  # of MuJoCo's mjtGeom
# MuJoCo draws groups below this by default; by convention, geoms that only collide are in higher ones.
DRAWN_GROUPS = 3
# Planes, height fields and distance fields are not parts of robots.
MESH = 7
KINDS = {
    2: lambda x, y, z: coal.Sphere(x),
    3: lambda x, y, z: coal.Capsule(x, 2 * y),
    4: lambda x, y, z: coal.Ellipsoid(x, y, z),
    5: lambda x, y, z: coal.Cylinder(x, 2 * y),
    6: lambda x, y, z: coal.Box(2 * x, 2 * y, 2 * z),
}


class MjcfRobot(NamedTuple):
    """A robot as its MJCF file describes it.

    Args:
        model: model on the robot's base.
        passive: joints without an actuator, if others have one.
        start: configuration (nq,) of the file's keyframe, or else of its bodies as they are placed.
        thrusters: thrusters on the base.
    """

    model: pin.Model
    passive: tuple[str, ...]
    start: np.ndarray
    thrusters: tuple[Thruster, ...]


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

    A file with a free joint of its own has a floating base: a ``base`` other than "freeflyer" or "virtual"
    raises `InputError`. A file without one gets the requested base, above all bodies that move.
    """
    names, free = body_names(compiled), compiled.jnt_bodyid[compiled.jnt_type == FREE]
    if len(free) > 1:
        others = ", ".join(f"'{names[body]}'" for body in free[1:])
        raise InputError(f"{path} has free bodies besides '{names[free[0]]}': {others}", "one free joint")
    trees = compiled.body_rootid[compiled.jnt_bodyid]
    if len(free) and len(set(trees)) > 1:
        beside = (name for name, tree in zip(joint_names(compiled), trees, strict=True) if tree != free[0])
        what = f"{path} has joints besides the free body '{names[free[0]]}': {', '.join(beside)}"
        raise InputError(what, "a file of the robot alone")
    model = plain = mjcf_model(compiled)
    kind, start = base_of(plain), _start(compiled, plain)
    if base not in (None, kind, "virtual" if kind == "freeflyer" else kind):
        root = planar_root(plain)
        if kind != "fixed" or root:
            own = f"a planar root ({root})" if root else f"a {kind} root joint"
            what = f"{path} has {own} of its own, base={base!r} contradicts it"
            raise InputError(what, f"{kind!r}")
        planar = base == "planar"
        model = mjcf_model(compiled, pin.JointModelPlanar() if planar else pin.JointModelFreeFlyer())
        model = sagittal(model) if planar else model
        start = np.concatenate([pin.neutral(model)[: model.nq - plain.nq], start])
    if base == "virtual" and kind != "virtual":
        start = from_free_flyer(DEFAULT_ORDER, start, *np.zeros((2, model.nv)))[0]
        model = virtual_model(model)
    actuation, free = actuation_of(compiled), BASE_JOINT[base_of(model)]
    driven, flies = actuation.driven, base_of(model) in ("freeflyer", "planar")
    carried = {frame.name for frame in model.frames if flies and frame.parentJoint == free}
    thrusters = tuple(one for one in actuation.thrusters if one.frame in carried)
    idle = ~driven & (compiled.nu > 0) & (compiled.jnt_type != FREE)
    passive = tuple(np.array(joint_names(compiled))[idle].tolist())
    return MjcfRobot(model, passive, start, thrusters)


def joint_springs(compiled: Any) -> dict[str, tuple[float, float]]:
    """Stiffness, N m/rad or N/m, and rest position, rad or m, of hinges and slides with springs, by name."""
    springs = {}
    for index, name in enumerate(joint_names(compiled)):
        stiffness = float(compiled.jnt_stiffness[index])
        if stiffness and compiled.jnt_type[index] in (SLIDE, HINGE):
            springs[name] = stiffness, float(compiled.qpos_spring[compiled.jnt_qposadr[index]])
    return springs


def mjcf_model(compiled: Any, root: Any = None) -> pin.Model:
    """The model of a compiled file, with the joint ``root``, if given, above all bodies that move."""
    model, names, joints = pin.Model(), body_names(compiled), joint_names(compiled)
    model.name = bytes(compiled.names).split(b"\0")[0].decode()
    off = compiled.opt.disableflags & mujoco_package().mjtDisableBit.mjDSBL_GRAVITY
    model.gravity = pin.Motion(np.zeros(3) if off else compiled.opt.gravity.copy(), np.zeros(3))
    bodies = {0: Body(0, pin.SE3.Identity())}
    moving, rooted, bodies_by_name = robot_bodies(compiled), bodies[0], set(names)
    if root is not None:
        own = unique("root_joint", {*names, *joints})
        rooted = Body(model.addJoint(0, root, pin.SE3.Identity(), own), pin.SE3.Identity())
        model.addJointFrame(rooted.joint, 0)
    for body in range(1, compiled.nbody):
        parent = int(compiled.body_parentid[body])
        above = rooted if parent == 0 and body in moving else bodies[parent]
        on = _add_joints(compiled, model, body, above, joints, bodies_by_name)
        bodies[body] = on
        model.addFrame(pin.Frame(names[body], on.joint, 0, on.placement, pin.FrameType.BODY))
        inertia = pin.Inertia(compiled.body_mass[body], np.zeros(3), np.diag(compiled.body_inertia[body]))
        centre = placement(compiled.body_ipos[body], compiled.body_iquat[body])
        model.appendBodyToJoint(on.joint, inertia, on.placement * centre)
    _add_rows(compiled, model)
    _add_points(compiled, model, bodies)
    return model


def _add_joints(
    compiled: Any, model: pin.Model, body: int, on: Body, joints: Sequence[str], bodies: set[str]
) -> Body:
    """Add a body's joints in series and return where it is; ``joints`` and ``bodies`` are all names."""
    joint = on.joint
    place = on.placement * placement(compiled.body_pos[body], compiled.body_quat[body])
    start = int(compiled.body_jntadr[body])
    for index in range(start, start + int(compiled.body_jntnum[body])):
        kind, axis, anchor = compiled.jnt_type[index], compiled.jnt_axis[index], compiled.jnt_pos[index]
        zero = float(compiled.qpos0[compiled.jnt_qposadr[index]])
        at = place * pin.SE3(np.eye(3), anchor.copy())
        if kind == FREE:
            moved, at, anchor = pin.JointModelFreeFlyer(), pin.SE3.Identity(), np.zeros(3)
        elif kind == BALL:
            moved = pin.JointModelSpherical()
        elif kind == SLIDE:
            moved, at = _along("Prismatic", axis), at * pin.SE3(np.eye(3), -zero * axis)
        else:
            moved, at = _along("Revolute", axis), at * pin.SE3(pin.exp3(-zero * axis), np.zeros(3))
        joint = model.addJoint(joint, moved, at, joints[index])
        if joints[index] not in bodies:
            model.addJointFrame(joint, 0)
        place = pin.SE3(np.eye(3), -anchor)
    return Body(joint, place)


def _along(kind: str, axis: np.ndarray) -> Any:
    """A joint model of one coordinate, "Revolute" or "Prismatic", with that axis."""
    for letter, unit in zip("XYZ", np.eye(3), strict=True):
        if np.abs(axis - unit).max() <= ALIGNED:
            return getattr(pin, f"JointModel{kind[0]}{letter}")()
    return getattr(pin, f"JointModel{kind}Unaligned")(axis.copy())


def _add_rows(compiled: Any, model: pin.Model) -> None:
    """Set limits, armature and friction of joints; those that MuJoCo does not limit have no limits."""
    actuation = actuation_of(compiled)
    for limit, sign in (("upper", 1), ("lower", -1)):
        for what in ("Effort", "Velocity", "Position"):
            getattr(model, f"{limit}{what}Limit")[:] = sign * np.inf
    for index, name in enumerate(joint_names(compiled)):
        joint, start = model.joints[model.getJointId(name)], int(compiled.jnt_dofadr[index])
        v, dofs = slice(joint.idx_v, joint.idx_v + joint.nv), slice(start, start + joint.nv)
        model.armature[v] = compiled.dof_armature[dofs] + actuation.armature[index]
        model.damping[v] = compiled.dof_damping[dofs]
        model.upperDryFrictionLimit[v] = compiled.dof_frictionloss[dofs]
        model.lowerDryFrictionLimit[v] = -compiled.dof_frictionloss[dofs]
        model.upperEffortLimit[v], model.lowerEffortLimit[v] = np.array([[1], [-1]]) * actuation.effort[index]
        if joint.nv == 1 and compiled.jnt_limited[index]:
            lower, upper = compiled.jnt_range[index]
            model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q] = lower, upper


def _add_points(compiled: Any, model: pin.Model, bodies: dict[int, Body]) -> None:
    """Add frames at the robot's colliding balls and at sites, which may be feet."""
    touching = (compiled.geom_contype | compiled.geom_conaffinity) != 0
    balls = touching & (compiled.geom_type == SPHERE) & np.isin(compiled.geom_bodyid, robot_bodies(compiled))
    points = [("ball", compiled.geom(int(index))) for index in np.flatnonzero(balls)]
    points += [("site", site) for site in map(compiled.site, range(compiled.nsite)) if site.name]
    names = body_names(compiled)
    taken = {frame.name for frame in model.frames} | set(names)
    for kind, point in points:
        body, free = int(point.bodyid[0]), point.name and point.name not in taken
        owner = point.name or names[body]
        name = unique(point.name if free else f"{owner}_{kind}", taken)
        place = bodies[body].placement * placement(point.pos, point.quat)
        model.addFrame(pin.Frame(name, bodies[body].joint, 0, place, pin.FrameType.OP_FRAME))


def _start(compiled: Any, model: pin.Model) -> np.ndarray:
    """Configuration of the keyframe "home", or else the first, if within limits; else of bodies as placed."""
    names = [compiled.key(index).name for index in range(compiled.nkey)]
    if names:
        q = configuration(compiled, model, compiled.key_qpos[names.index(HOME) if HOME in names else 0])
        if (np.abs(np.clip(q, *position_limits(model)) - q) <= LIMIT_SLACK).all():
            return q
    return np.clip(configuration(compiled, model, compiled.qpos0), *position_limits(model))


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
    """Bodies of trees with joints, or all if there are none; other bodies belong to the scene."""
    roots = {int(compiled.body_rootid[body]) for body in compiled.jnt_bodyid}
    return [
        body for body in range(1, compiled.nbody) if not roots or int(compiled.body_rootid[body]) in roots
    ]


def body_names(compiled: Any) -> list[str]:
    """Names of all bodies, the world first; unnamed ones are numbered."""
    given = [compiled.body(index).name for index in range(compiled.nbody)]
    return _complete(given, [f"body{index}" for index in range(compiled.nbody)])


def joint_names(compiled: Any) -> list[str]:
    """Names of all joints; unnamed ones are named after their bodies."""
    given, bodies = [compiled.joint(index).name for index in range(compiled.njnt)], body_names(compiled)
    return _complete(given, [f"{bodies[body]}_joint" for body in compiled.jnt_bodyid])


def _complete(given: Sequence[str], otherwise: Sequence[str]) -> list[str]:
    taken = set(given)
    return [name or unique(other, taken) for name, other in zip(given, otherwise, strict=True)]


def unique(name: str, taken: set[str]) -> str:
    """The name, with a number appended if it is ``taken``; the result is added to ``taken``."""
    numbered = (f"{name}_{number}" for number in range(2, len(taken) + 3))
    found = next(each for each in (name, *numbered) if each not in taken)
    taken.add(found)
    return found


def placement(position: np.ndarray, quaternion: np.ndarray) -> pin.SE3:
    """Placement at MuJoCo's position and quaternion (w, x, y, z)."""
    return pin.XYZQUATToSE3(np.concatenate([position, np.roll(quaternion, -1)]))


def mjcf_geometry(path: Path, model: pin.Model, kind: pin.GeometryType) -> pin.GeometryModel:
    """Collision or visual geoms of the robot, on the frames of their bodies. Raises `InputError`."""
    compiled = compile_mjcf(path)
    own = np.isin(compiled.geom_bodyid, robot_bodies(compiled))
    own &= np.isin(compiled.geom_type, [*KINDS, MESH])
    chosen = (compiled.geom_contype | compiled.geom_conaffinity) != 0
    if kind == pin.GeometryType.VISUAL:
        chosen = compiled.geom_group < DRAWN_GROUPS
        chosen |= not (chosen & own).any()
    geometry, names = pin.GeometryModel(), body_names(compiled)
    taken, counts = set[str](), Counter[str]()
    for index in np.flatnonzero(own & chosen).tolist():
        geom = compiled.geom(index)
        body, material = names[geom.bodyid[0]], int(geom.matid[0])
        if not model.existFrame(body, pin.FrameType.BODY):
            continue
        frame = model.getFrameId(body, pin.FrameType.BODY)
        on, name = model.frames[frame], unique(geom.name or f"{body}_{counts[body]}", taken)
        counts[body] += 1
        shape = (
            _mesh(compiled, int(geom.dataid[0])) if geom.type[0] == MESH else KINDS[geom.type[0]](*geom.size)
        )
        place = on.placement * placement(geom.pos, geom.quat)
        colour = np.array(geom.rgba if material < 0 else compiled.mat_rgba[material], dtype=float)
        entry = (name, on.parentJoint, frame, place, shape, "", np.ones(3), True, colour)
        geometry.addGeometryObject(pin.GeometryObject(*entry))
    return geometry


def _mesh(compiled: Any, mesh: int) -> Any:
    corner, face = compiled.mesh_vertadr[mesh], compiled.mesh_faceadr[mesh]
    corners = compiled.mesh_vert[corner : corner + compiled.mesh_vertnum[mesh]].astype(float)
    faces = compiled.mesh_face[face : face + compiled.mesh_facenum[mesh]].astype(np.int64)
    shape = coal.BVHModelOBBRSS()
    shape.beginModel(len(faces), len(corners))
    shape.addVertices(corners)
    shape.addTriangles(faces)
    shape.endModel()
    return shape


def excluded_bodies(path: Path) -> set[frozenset[str]]:
    """Pairs of bodies in ``<exclude>`` elements. Raises `InputError`."""
    compiled = compile_mjcf(path)
    names = body_names(compiled)
    return {frozenset((names[pair >> 16], names[pair & 0xFFFF])) for pair in compiled.exclude_signature}
