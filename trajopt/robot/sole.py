"""The centre of pressure of a contact."""

import numpy as np


def centre_of_pressure(force: np.ndarray, moment: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Vector from the contact frame's origin to the centre of pressure, ``n x m / (n . f)``, (..., 3) in m.

    ``force`` and ``moment`` (..., 3) act at that origin; the unit ``normal`` (..., 3) of the surface is in
    the same axes. Infinite or NaN without a normal force.
    """
    pressure = np.sum(np.asarray(normal) * force, axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.cross(normal, moment) / pressure)
