"""The MuJoCo model of a `pin.Model`: the same bodies, joints, inertias, armature and gravity.

Every joint becomes one body with the inertia that Pinocchio has lumped onto it. MuJoCo's compiler refuses
massless bodies and inertias that no rigid body has, both of which Pinocchio's recursions accept; so bodies
are compiled with a stand-in inertia, and the true inertias are written into the compiled model.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.dynamics.manifold import Coordinates, Joint
from trajopt.errors import InputError
from trajopt.robot.mujoco_package import mujoco_package
from trajopt.simulation.coordinates import CoordinateMap, JointAddress

# Columns of a joint's motion with a smaller angular part are translations.
TRANSLATION = 1e-9
# Stand-in inertia for compilation: offset and not diagonal, so that the compiler takes no special case.
STAND_IN = {"mass": 1.0, "ipos": [0.1, 0.2, 0.3], "fullinertia": [1.0, 1.1, 1.2, 0.1, 0.1, 0.1]}


@dataclass(frozen=True, kw_only=True)
class Bodies:
    """A specification ``spec`` before compilation, and the name of each joint's body."""

    model: pin.Model
    spec: Any
    names: tuple[str, ...]


def body_name(joint: int) -> str:
    """Name of the body of a joint, by the joint's index; joint 0 is the world."""
    return "world" if joint == 0 else f"body{joint}"


def build_bodies(model: pin.Model) -> Bodies:
    """Bodies and joints of a model, without geometry. Raises `InputError` for what MuJoCo cannot express."""
    mujoco = mujoco_package()
    spec = mujoco.MjSpec()
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    spec.option.gravity = model.gravity.linear
    bodies = [spec.worldbody]
    for index, joint in enumerate(Coordinates(model).joints, start=1):
        placement = model.jointPlacements[index]
        body = bodies[model.parents[index]].add_body(
            name=body_name(index),
            pos=placement.translation,
            quat=mujoco_quaternion(placement.rotation),
            explicitinertial=True,
            **STAND_IN,
        )
        _add_joint(mujoco, body, model, index, joint)
        bodies.append(body)
    return Bodies(model=model, spec=spec, names=tuple(body_name(i) for i in range(len(bodies))))


def mujoco_quaternion(rotation: np.ndarray) -> np.ndarray:
    """Return MuJoCo's quaternion (w, x, y, z) of a rotation matrix (3, 3)."""
    quaternion = pin.Quaternion(np.array(rotation)).normalized()
    return np.array([quaternion.w, quaternion.x, quaternion.y, quaternion.z])


def _add_joint(mujoco: Any, body: Any, model: pin.Model, index: int, joint: Joint) -> None:
    hinge, slide = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
    axes = np.eye(3)
    if joint.kind == "freeflyer":
        # A free joint of MuJoCo hangs from the world; elsewhere four joints give the same coordinates.
        parts = [(slide, axis) for axis in axes] + [(mujoco.mjtJoint.mjJNT_BALL, axes[2])]
        if model.parents[index] == 0 and model.jointPlacements[index].isIdentity():
            parts = [(mujoco.mjtJoint.mjJNT_FREE, axes[2])]
    elif joint.kind == "spherical":
        parts = [(mujoco.mjtJoint.mjJNT_BALL, axes[2])]
    elif joint.kind == "planar":
        parts = [(slide, axes[0]), (slide, axes[1]), (hinge, axes[2])]
    elif model.joints[index].shortname() == "JointModelTranslation":
        parts = [(slide, axis) for axis in axes]
    elif model.joints[index].shortname() == "JointModelSphericalZYX":
        parts = [(hinge, axis) for axis in axes[::-1]]
    else:
        axis, turns = joint_axis(model, index)
        parts = [(hinge if turns else slide, axis)]
    for number, (kind, axis) in enumerate(parts):
        body.add_joint(name=part_name(index, number), type=kind, axis=axis)


def part_name(index: int, number: int) -> str:
    """Name of the MuJoCo joint for one part of a joint, by the joint's index and the part's number."""
    return f"joint{index}.{number}"


def joint_axis(model: pin.Model, index: int) -> tuple[np.ndarray, bool]:
    """Axis (3,) of a joint of one degree of freedom in its own frame, and whether it is revolute."""
    data = model.createData()
    columns = pin.computeJointJacobians(model, data, pin.neutral(model)).reshape(6, model.nv)
    motion = data.oMi[index].actInv(pin.Motion(columns[:, model.joints[index].idx_v]))
    turns = bool(np.linalg.norm(motion.angular) > TRANSLATION)
    return np.array(motion.angular if turns else motion.linear), turns


def compile_bodies(bodies: Bodies) -> tuple[Any, CoordinateMap]:
    """Compile a model with the inertias of the `pin.Model`; returns it with the map of its coordinates.

    Raises `InputError` for a model that MuJoCo refuses, as with a mesh of three points.
    """
    try:
        compiled = bodies.spec.compile()
    except ValueError as error:
        raise InputError(f"MuJoCo refuses the model: {' '.join(str(error).split())}") from None
    addresses = []
    for index, joint in enumerate(Coordinates(bodies.model).joints, start=1):
        first = compiled.joint(part_name(index, 0))
        q, v = int(first.qposadr[0]), int(first.dofadr[0])
        size = {"freeflyer": 7, "spherical": 4}.get(joint.kind, joint.v.stop - joint.v.start)
        addresses.append(
            JointAddress(joint=joint, q=slice(q, q + size), v=slice(v, v + joint.v.stop - joint.v.start))
        )
    coordinates = CoordinateMap(
        coordinates=Coordinates(bodies.model), addresses=tuple(addresses), nq=int(compiled.nq)
    )
    _write_armature(compiled, bodies.model, coordinates)
    write_inertias(compiled, bodies.model)
    return compiled, coordinates


def _write_armature(compiled: Any, model: pin.Model, coordinates: CoordinateMap) -> None:
    for address in coordinates.addresses:
        armature = np.array(model.armature[address.joint.v])
        linear = {"freeflyer": 3, "planar": 2}.get(address.joint.kind, 0)
        if armature[:linear].any():
            raise InputError(
                f"joint '{address.joint.name}' has armatures {armature[:linear]} kg along its body's axes",
                "allowed in a simulation: none along axes that turn with the body",
            )
        compiled.dof_armature[address.v] = armature


def write_inertias(compiled: Any, model: pin.Model) -> None:
    """Write masses, centres of mass and inertias of a model with the same joints into a compiled one."""
    mujoco = mujoco_package()
    for index in range(1, model.njoints):
        body, inertia = compiled.body(body_name(index)).id, model.inertias[index]
        moments, axes = np.linalg.eigh(np.array(inertia.inertia))
        if np.linalg.det(axes) < 0:
            axes[:, 0] *= -1
        compiled.body_mass[body] = inertia.mass
        compiled.body_ipos[body] = inertia.lever
        compiled.body_inertia[body] = moments
        compiled.body_iquat[body] = mujoco_quaternion(axes)
    mujoco.mj_setConst(compiled, mujoco.MjData(compiled))
