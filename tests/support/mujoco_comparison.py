"""A model read from MJCF against MuJoCo: poses, masses, gravity and inverse dynamics at random states."""

from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from trajopt.robot.mjcf import body_names, configuration, joint_names

STATES = 3
FREE, BALL = mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL


def random_qpos(compiled: Any, random: np.random.Generator) -> np.ndarray:
    """Positions within a unit of qpos0, quaternions of any rotation."""
    qpos = compiled.qpos0 + random.uniform(-1, 1, compiled.nq)
    for kind, start in zip(compiled.jnt_type, compiled.jnt_qposadr, strict=True):
        if kind in (FREE, BALL):
            at = start + 3 * (kind == FREE)
            quaternion = random.normal(size=4)
            qpos[at : at + 4] = quaternion / np.linalg.norm(quaternion)
    return qpos


def without_other_forces(compiled: Any) -> None:
    """Take out of MuJoCo's inverse dynamics all that is not the tree of bodies, armature and gravity."""
    for name in ("CONSTRAINT", "SPRING", "DAMPER", "PASSIVE"):  # the last is MuJoCo 3's for the two before
        compiled.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}", 0))
    compiled.opt.density = compiled.opt.viscosity = 0.0
    compiled.opt.wind[:] = 0.0
    compiled.body_gravcomp[:] = 0.0
    getattr(compiled, "tendon_armature", np.zeros(0))[:] = 0.0


def differences(compiled: Any, model: pin.Model, seed: int = 0) -> dict[str, float]:
    """Largest difference of each quantity, as a part of its own size or of 1."""
    random, found = np.random.default_rng(seed), {}
    without_other_forces(compiled)
    names, data, own = body_names(compiled), mujoco.MjData(compiled), model.createData()

    def record(what: str, value: Any, theirs: Any) -> None:
        scale = max(1.0, float(np.abs(theirs).max(initial=0.0)))
        apart = float(np.abs(np.asarray(value) - theirs).max(initial=0.0)) / scale
        found[what] = max(found.get(what, 0.0), apart)

    record("gravity", model.gravity.linear, compiled.opt.gravity * (not compiled.opt.disableflags & GRAVITY))
    record("mass", sum(i.mass for i in list(model.inertias)), compiled.body_mass[1:].sum())
    for _ in range(STATES):
        data.qpos[:] = random_qpos(compiled, random)
        data.qvel[:], data.qacc[:] = random.normal(size=(2, compiled.nv))
        qacc = data.qacc.copy()
        mujoco.mj_inverse(compiled, data)
        q, v, a = configuration(compiled, model, data.qpos), np.zeros(model.nv), np.zeros(model.nv)
        torque = np.zeros(model.nv)
        for index, name in enumerate(joint_names(compiled)):
            joint, start = model.joints[model.getJointId(name)], compiled.jnt_dofadr[index]
            rows, dofs = slice(joint.idx_v, joint.idx_v + joint.nv), slice(start, start + joint.nv)
            v[rows], a[rows], torque[rows] = data.qvel[dofs], qacc[dofs], data.qfrc_inverse[dofs]
            if compiled.jnt_type[index] == FREE:
                world = pin.Quaternion(q[joint.idx_q + 3 : joint.idx_q + 7]).toRotationMatrix()
                linear = slice(joint.idx_v, joint.idx_v + 3)
                v[linear], torque[linear] = world.T @ v[linear], world.T @ torque[linear]
                turning = v[joint.idx_v + 3 : joint.idx_v + 6]
                a[linear] = world.T @ a[linear] - np.cross(turning, v[linear])
        record("inverse dynamics", pin.rnea(model, own, q, v, a), torque)
        pin.framesForwardKinematics(model, own, q)
        for body in range(1, compiled.nbody):
            place = own.oMf[model.getFrameId(names[body], pin.FrameType.BODY)]
            record("positions", place.translation, data.xpos[body])
            record("rotations", place.rotation, data.xmat[body].reshape(3, 3))
        mass = sum(inertia.mass for inertia in model.inertias)
        if mass:
            moving = sum(i.mass for i in list(model.inertias)[1:])
            centre = (moving * pin.centerOfMass(model, own, q) if moving else np.zeros(3)) + model.inertias[
                0
            ].mass * model.inertias[0].lever
            record("centre of mass", centre / mass, data.subtree_com[0])
    return found


GRAVITY = int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
