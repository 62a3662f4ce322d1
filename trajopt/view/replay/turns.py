"""Rotations of many frames as quaternions (x, y, z, w), as three.js takes them."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

# A direction whose z component is below this times its length points straight down.
DOWN = -1 + 1e-12


def quaternions_of(rotations: np.ndarray) -> np.ndarray:
    """Quaternions (n, 4) of rotation matrices (n, 3, 3)."""
    return np.asarray(Rotation.from_matrix(rotations).as_quat())


def turns_to(directions: np.ndarray) -> np.ndarray:
    """Quaternions (n, 4) of the least rotations that take z to directions (n, 3); the identity for none."""
    length = np.linalg.norm(directions, axis=1, keepdims=True)
    unit = np.divide(directions, length, out=np.tile([0.0, 0.0, 1.0], (len(length), 1)), where=length > 0)
    down = unit[:, 2] <= DOWN
    half = np.column_stack([-unit[:, 1], unit[:, 0], np.zeros(len(unit)), 1 + unit[:, 2]])
    half[down] = [1.0, 0.0, 0.0, 0.0]
    return np.asarray(half / np.linalg.norm(half, axis=1, keepdims=True))
