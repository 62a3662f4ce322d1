"""Motions for mjlab and BeyondMimic (whole_body_tracking), as their ``MotionLoader`` reads them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.export.archives import contact_arrays, frame_rate, names_array, single, write_archive
from trajopt.export.exported_motion import ExportedMotion
from trajopt.export.simulator_model import read_simulator_model
from trajopt.export.simulator_motion import simulator_motion


def write_mjlab(motions: Sequence[ExportedMotion], path: Path, options: Mapping[str, Any]) -> None:
    """Write one motion; float32, joints and bodies in the simulator's order, without free joint and world.

    Velocities are those of the bodies' origins along world axes, as in mjlab's converter.
    """
    (motion,) = motions
    simulator = read_simulator_model(motion, options.get("mjcf"))
    simulated = simulator_motion(motion, simulator)
    compiled, joints = simulator.compiled, np.flatnonzero(~simulator.is_free)
    names = [simulator.joint_names[i] for i in joints]
    arrays = {
        "fps": frame_rate(motion.rate)[None],
        "joint_pos": single(simulated.qpos[:, compiled.jnt_qposadr[joints]]),
        "joint_vel": single(simulated.qvel[:, compiled.jnt_dofadr[joints]]),
        "body_pos_w": single(simulated.xpos[:, 1:]),
        "body_quat_w": single(simulated.xquat[:, 1:]),
        "body_lin_vel_w": single(simulated.linear_velocity[:, 1:]),
        "body_ang_vel_w": single(simulated.angular_velocity[:, 1:]),
        "joint_names": names_array(names),
        "body_names": names_array(simulator.body_names[1:]),
        "joint_torques": single(_torques(motion, names)),
    }
    write_archive(path, arrays | contact_arrays(motion))


def _torques(motion: ExportedMotion, names: list[str]) -> np.ndarray:
    """Torques (n, d) of joints by name; 0 for those that the motion does not drive, such as a base's."""
    torque = np.zeros((len(motion.t), len(names)))
    for column, name in enumerate(names):
        if name in motion.joints.names:
            torque[:, column] = motion.joints.torque[:, motion.joints.names.index(name)]
    return torque
