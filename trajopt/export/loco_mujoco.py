"""Trajectories for LocoMuJoCo, as its ``Trajectory.load`` reads them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.export.archives import names_array, write_archive
from trajopt.export.exported_motion import ExportedMotion, require_one_robot
from trajopt.export.simulator_model import read_simulator_model
from trajopt.export.simulator_motion import COMPUTED, simulator_motion

# Fields of the compiled model that a trajectory stores, on joints, bodies and sites.
OF_MODEL = (
    *("njnt", "jnt_type"),
    *("nbody", "body_rootid", "body_weldid", "body_mocapid"),
    *("body_pos", "body_quat", "body_ipos", "body_iquat"),
    *("nsite", "site_bodyid", "site_pos", "site_quat"),
)


def write_loco_mujoco(motions: Sequence[ExportedMotion], path: Path, options: Mapping[str, Any]) -> None:
    """Write motions of one robot one after the other; ``split_points`` has the start of each, and the end.

    The loader refuses unknown keys, so torques and forces are left out.
    """
    require_one_robot(motions)
    simulator = read_simulator_model(motions[0], options.get("mjcf"))
    simulated = [simulator_motion(motion, simulator) for motion in motions]
    arrays = {
        "joint_names": names_array(simulator.joint_names),
        "body_names": names_array(simulator.body_names),
        "site_names": names_array(simulator.site_names),
        "frequency": np.array(motions[0].rate),
        "split_points": np.append(0, np.cumsum([len(motion.t) for motion in motions])),
    }
    arrays |= {key: np.array(getattr(simulator.compiled, key)) for key in OF_MODEL}
    arrays |= {
        key: np.concatenate([getattr(one, key) for one in simulated]) for key in ("qpos", "qvel", *COMPUTED)
    }
    write_archive(path, arrays)
