"""Motions for adversarial motion priors in Isaac Lab, as its ``MotionLoader`` reads them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from trajopt.export.archives import contact_arrays, frame_rate, names_array, single, write_archive
from trajopt.export.exported_motion import ExportedMotion


def write_isaaclab_amp(motions: Sequence[ExportedMotion], path: Path, options: Mapping[str, Any]) -> None:
    """Write one motion; float32, quaternions wxyz, velocities of the links' origins along world axes."""
    (motion,) = motions
    links = motion.links
    arrays = {
        "fps": frame_rate(motion.rate),
        "dof_names": names_array(motion.joints.names),
        "body_names": names_array(links.names),
        "dof_positions": single(motion.joints.position),
        "dof_velocities": single(motion.joints.velocity),
        "body_positions": single(links.position),
        "body_rotations": single(links.quaternion),
        "body_linear_velocities": single(links.linear_velocity),
        "body_angular_velocities": single(links.angular_velocity),
        "dof_torques": single(motion.joints.torque),
    }
    write_archive(path, arrays | contact_arrays(motion))
