"""Archives of arrays (.npz), with extra arrays for readers that take more than the format has."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.export.exported_motion import ExportedMotion


def frame_rate(rate: float) -> np.ndarray:
    """A rate (), Hz: an integer where it is whole, as in the files that come with readers."""
    return np.array(int(rate)) if float(rate).is_integer() else np.array(float(rate))


def single(values: np.ndarray) -> np.ndarray:
    """The values in single precision, to which readers convert them."""
    return values.astype(np.float32)


def names_array(names: tuple[str, ...] | list[str]) -> np.ndarray:
    """Names as an array of text, even if there are none."""
    return np.array(names, dtype=str)


def contact_arrays(motion: ExportedMotion) -> dict[str, np.ndarray]:
    """Contacts of a motion, for readers that ignore unknown keys.

    ``contact_names`` (nc,) frames, ``contact_active`` (n, nc), ``contact_forces`` and ``contact_moments``
    (n, nc, 3) N and N m of the surroundings on the robot, world axes at the frames' origins.
    """
    return {
        "contact_names": names_array(motion.contact_frames),
        "contact_active": motion.active,
        "contact_forces": single(motion.f[..., :3]),
        "contact_moments": single(motion.f[..., 3:]),
    }


def write_archive(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write named arrays, compressed and without pickles."""
    every: dict[str, Any] = dict(arrays)
    with path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **every)
