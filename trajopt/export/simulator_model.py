"""A MuJoCo model of the robot from MJCF, and the values of its joints in a motion."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.errors import InputError, expanded, first_line, not_among
from trajopt.export.exported_motion import ExportedMotion
from trajopt.robot.mujoco_package import mujoco_package, muted_mujoco
from trajopt.simulation.mjcf import mjcf_of

# Name of a free joint without a name.
FREE_JOINT = "root"


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulatorModel:
    """A compiled model, with the names of its joints, bodies (the world first) and sites in its order.

    source: its name in messages.
    """

    compiled: Any
    source: str
    joint_names: tuple[str, ...]
    body_names: tuple[str, ...]
    site_names: tuple[str, ...]

    @property
    def is_free(self) -> np.ndarray:
        """Whether each joint is free (njnt,)."""
        return np.asarray(self.compiled.jnt_type == mujoco_package().mjtJoint.mjJNT_FREE)


def read_simulator_model(motion: ExportedMotion, mjcf: str | Path | None) -> SimulatorModel:
    """Read the model in an MJCF file; without one, the plan's, as `write_mjcf` writes it.

    Raises `InputError` for a file that MuJoCo cannot read, for ball joints, and without MuJoCo.
    """
    mujoco = mujoco_package()
    source = "the plan's own MJCF" if mjcf is None else str(mjcf)
    with muted_mujoco():
        try:
            if mjcf is None:
                compiled = mujoco.MjModel.from_xml_string(mjcf_of(motion.plan))
            else:
                compiled = mujoco.MjModel.from_xml_path(str(expanded(mjcf)))
        except ValueError as error:
            raise InputError(f"cannot read {source}: {first_line(error)}", "allowed: an MJCF file") from None
    joints = [compiled.joint(i).name for i in range(compiled.njnt)]
    types = mujoco.mjtJoint
    for name, kind in zip(joints, compiled.jnt_type, strict=True):
        if kind == types.mjJNT_BALL:
            raise InputError(f"joint '{name}' of {source} is a ball", "allowed: free, hinge and slide joints")
    return SimulatorModel(
        compiled=compiled,
        source=source,
        joint_names=tuple(
            name or (FREE_JOINT if kind == types.mjJNT_FREE else f"joint {i}")
            for i, (name, kind) in enumerate(zip(joints, compiled.jnt_type, strict=True))
        ),
        body_names=tuple(compiled.body(i).name for i in range(compiled.nbody)),
        site_names=tuple(compiled.site(i).name for i in range(compiled.nsite)),
    )


def named_coordinates(
    motion: ExportedMotion, simulator: SimulatorModel
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Positions and velocities (n,) by name of hinge or slide: of joints, and of parts of a base.

    Parts of a planar or virtual base are left out if the model has a free joint instead.
    """
    model, base = motion.model, base_of(motion.model)
    coordinates = {
        name: (motion.joints.position[:, i], motion.joints.velocity[:, i])
        for i, name in enumerate(motion.joints.names)
    }
    if simulator.is_free.any():
        return coordinates
    if base == "planar":
        x, y, cosine, sine = motion.q[:, :4].T
        forward, left, turning = motion.v[:, :3].T
        angle = np.unwrap(np.arctan2(sine, cosine))
        rates = (cosine * forward - sine * left, sine * forward + cosine * left, turning)
        parts = zip(("x", "y", "angle"), (x, y, angle), rates, strict=True)
        coordinates |= {f"{model.names[1]}_{part}": (value, rate) for part, value, rate in parts}
    elif base == "virtual":
        for joint in range(1, BASE_JOINT[base] + 1):
            entry = model.joints[joint]
            coordinates[model.names[joint]] = (motion.q[:, entry.idx_q], motion.v[:, entry.idx_v])
    return coordinates


def require_same_joints(motion: ExportedMotion, simulator: SimulatorModel) -> None:
    """Raise `InputError` if the model lacks a joint or base of the motion, or has an extra joint."""
    known, source, free = named_coordinates(motion, simulator), simulator.source, simulator.is_free
    base, held = base_of(motion.model), held_joints(motion, simulator)
    allowed = {"freeflyer": (1,), "fixed": (0,)}.get(base, (0, 1))
    if free.sum() not in allowed:
        raise InputError(
            f"{source} has {free.sum()} free joints",
            f"allowed: {allowed[-1]}, as the motion of {motion.robot}",
        )
    for name in known:
        if name not in simulator.joint_names:
            raise not_among(simulator.joint_names, name, f"joint '{name}' of the motion is not in {source}")
    for name, is_free in zip(simulator.joint_names, free, strict=True):
        if not is_free and name not in known and name not in held:
            raise not_among(known, name, f"joint '{name}' of {source} is not in the motion")


def held_joints(motion: ExportedMotion, simulator: SimulatorModel) -> dict[str, float]:
    """Angles, rad, of hinges that the motion holds, with the child link fixed to its parent.

    Examples are the arms of a humanoid whose plan moves only its legs. The poses of the two links give the
    angle.
    """
    compiled, names, angles = simulator.compiled, motion.links.names, {}
    hinge = mujoco_package().mjtJoint.mjJNT_HINGE
    for joint, name in enumerate(simulator.joint_names):
        body = int(compiled.jnt_bodyid[joint])
        child, parent = (simulator.body_names[i] for i in (body, compiled.body_parentid[body]))
        single = compiled.body_jntnum[body] == 1 and compiled.jnt_type[joint] == hinge
        if single and name not in motion.joints.names and child in names and parent in names:
            angles[name] = _hinge_angle(motion, simulator, joint, (parent, child))
    return angles


def _hinge_angle(
    motion: ExportedMotion, simulator: SimulatorModel, joint: int, links: tuple[str, str]
) -> float:
    """Angle of a hinge between two links at the start of the motion, as ``qpos`` counts it."""
    mujoco, compiled = mujoco_package(), simulator.compiled
    parent, child = (motion.links.quaternion[0, motion.links.names.index(link)] for link in links)
    turned, angle, back = np.zeros(4), np.zeros(3), np.zeros(4)
    mujoco.mju_negQuat(back, parent)
    mujoco.mju_mulQuat(turned, back, child)
    mujoco.mju_negQuat(back, compiled.body_quat[compiled.jnt_bodyid[joint]])
    mujoco.mju_mulQuat(turned, back, turned.copy())
    mujoco.mju_quat2Vel(angle, turned, 1.0)
    return float(angle @ compiled.jnt_axis[joint] + compiled.qpos0[compiled.jnt_qposadr[joint]])
