"""Archives of arrays (.npz), and what is added for readers that ignore what they do not know."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.export.exported_motion import ExportedMotion


def frame_rate(rate: float) -> np.ndarray:
    """A rate (), Hz: a whole number where it is one, as readers and their own files have it."""
    return np.array(int(rate)) if float(rate).is_integer() else np.array(float(rate))


def write_archive(path: Path, arrays: Mapping[str, np.ndarray], motion: ExportedMotion) -> None:
    """Write arrays, then torques and contacts of the motion under names that no reader of such files knows.

    ``joint_torques`` (n, d) N m or N; ``contact_names`` (nc,), ``contact_active`` (n, nc), ``contact_forces``
    and ``contact_moments`` (n, nc, 3) N, N m, world axes at the contact frames' origins.
    """
    added = {
        "joint_names": np.array(motion.joint_names, dtype=str),
        "joint_torques": single(motion.joint_torque),
        "contact_names": np.array(motion.plan.contact_frames, dtype=str),
        "contact_active": motion.active,
        "contact_forces": single(motion.f[..., :3]),
        "contact_moments": single(motion.f[..., 3:]),
    }
    every: dict[str, Any] = {**added, **arrays}
    with path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **every)


def single(values: np.ndarray) -> np.ndarray:
    """The values in single precision, which readers convert to."""
    return values.astype(np.float32)
