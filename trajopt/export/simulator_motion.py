"""A motion in the coordinates, joints and bodies of a MuJoCo model, by MuJoCo's own kinematics."""

from dataclasses import dataclass

import numpy as np

from trajopt.errors import InputError
from trajopt.export.exported_motion import ExportedMotion
from trajopt.export.links import without_jumps
from trajopt.export.simulator_model import (
    SimulatorModel,
    held_joints,
    named_coordinates,
    require_same_joints,
)
from trajopt.motion.local_states import rotation_matrices
from trajopt.robot.mujoco_package import mujoco_package

# Descriptions of a robot from two sources are rounded differently, by less than this, m.
SAME_PLACE = 5e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulatorMotion:
    """A motion at n times in the order of a MuJoCo model; SI units.

    Args:
        qpos, qvel: (n, nq), (n, nv).
        xpos, xquat, subtree_com: (n, nbody, 3), (n, nbody, 4) wxyz, (n, nbody, 3), the world first.
        cvel: (n, nbody, 6) angular and linear velocity, about the centre of mass of the body's tree.
        site_xpos, site_xmat: (n, nsite, 3), (n, nsite, 9).
    """

    simulator: SimulatorModel
    qpos: np.ndarray
    qvel: np.ndarray
    xpos: np.ndarray
    xquat: np.ndarray
    cvel: np.ndarray
    subtree_com: np.ndarray
    site_xpos: np.ndarray
    site_xmat: np.ndarray

    @property
    def linear_velocity(self) -> np.ndarray:
        """Velocities (n, nbody, 3), m/s, of the bodies' origins, world axes."""
        from_com = self.xpos - self.subtree_com[:, self.simulator.compiled.body_rootid]
        return self.cvel[..., 3:] + np.cross(self.cvel[..., :3], from_com)

    @property
    def angular_velocity(self) -> np.ndarray:
        """Angular velocities (n, nbody, 3), rad/s, of the bodies, world axes."""
        return self.cvel[..., :3]


# What MuJoCo computes for each state.
COMPUTED = ("xpos", "xquat", "cvel", "subtree_com", "site_xpos", "site_xmat")


def simulator_motion(motion: ExportedMotion, simulator: SimulatorModel) -> SimulatorMotion:
    """Convert a motion to the model's coordinates.

    Raises `InputError` if joints have other names, or a body is not where the link of its name is.
    """
    require_same_joints(motion, simulator)
    mujoco, compiled = mujoco_package(), simulator.compiled
    qpos, qvel = _coordinates(motion, simulator)
    data, rows = mujoco.MjData(compiled), []
    for own_q, own_v in zip(qpos, qvel, strict=True):
        data.qpos, data.qvel = own_q, own_v
        for compute in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel):
            compute(compiled, data)
        rows.append([getattr(data, name).copy() for name in COMPUTED])
    computed = {
        name: np.array(values) for name, values in zip(COMPUTED, zip(*rows, strict=True), strict=True)
    }
    computed["xquat"] = without_jumps(computed["xquat"])
    result = SimulatorMotion(simulator=simulator, qpos=qpos, qvel=qvel, **computed)
    _require_same_places(motion, result)
    return result


def _coordinates(motion: ExportedMotion, simulator: SimulatorModel) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, nq) and velocities (n, nv) of MuJoCo's joints."""
    compiled, named, held = (
        simulator.compiled,
        named_coordinates(motion, simulator),
        held_joints(motion, simulator),
    )
    qpos, qvel = np.zeros((len(motion.t), compiled.nq)), np.zeros((len(motion.t), compiled.nv))
    for joint, name in enumerate(simulator.joint_names):
        place, row = compiled.jnt_qposadr[joint], compiled.jnt_dofadr[joint]
        if simulator.is_free[joint]:
            body = simulator.body_names[compiled.jnt_bodyid[joint]]
            qpos[:, place : place + 7], qvel[:, row : row + 6] = _free_joint(motion, body)
        elif name in named:
            qpos[:, place], qvel[:, row] = named[name]
        else:
            qpos[:, place] = held[name]
    return qpos, qvel


def _free_joint(motion: ExportedMotion, body: str) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates (n, 7) and velocities (n, 6) of the link with this name, or of the base if there is none.

    Linear velocities are along world axes, angular velocities along the body's.
    """
    links = motion.links
    base = links.names.index(body) if body in links.names else links.base
    quaternion = links.quaternion[:, base]
    turn = rotation_matrices(quaternion[:, [1, 2, 3, 0]])
    angular = np.einsum("nji,nj->ni", turn, links.angular_velocity[:, base])
    return np.hstack([links.position[:, base], quaternion]), np.hstack(
        [links.linear_velocity[:, base], angular]
    )


def _require_same_places(motion: ExportedMotion, result: SimulatorMotion) -> None:
    simulator = result.simulator
    for body, name in enumerate(simulator.body_names):
        if name in motion.links.names:
            planned = motion.links.position[:, motion.links.names.index(name)]
            apart = float(np.linalg.norm(result.xpos[:, body] - planned, axis=1).max())
            if apart > SAME_PLACE:
                raise InputError(
                    f"{simulator.source} has '{name}' {1000 * apart:.0f} mm from where the motion has it",
                    f"allowed: a model of {motion.robot}",
                )
