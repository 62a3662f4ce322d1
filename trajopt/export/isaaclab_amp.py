"""Motions of Isaac Lab for adversarial motion priors, as its ``MotionLoader`` reads them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.export.archives import frame_rate, single, write_archive
from trajopt.export.exported_motion import ExportedMotion


def write_isaaclab_amp(motions: Sequence[ExportedMotion], path: Path, options: Mapping[str, Any]) -> None:
    """Write one motion; float32, quaternions w, x, y, z, velocities of the links' frames along world axes."""
    (motion,) = motions
    links = motion.links
    write_archive(
        path,
        {
            "fps": frame_rate(motion.rate),
            "dof_names": np.array(motion.joint_names, dtype=str),
            "body_names": np.array(links.names, dtype=str),
            "dof_positions": single(motion.joint_position),
            "dof_velocities": single(motion.joint_velocity),
            "body_positions": single(links.position),
            "body_rotations": single(links.quaternion),
            "body_linear_velocities": single(links.linear_velocity),
            "body_angular_velocities": single(links.angular_velocity),
        },
        motion,
    )
