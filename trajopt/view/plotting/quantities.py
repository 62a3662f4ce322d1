"""Position, velocity and torque of a joint axis, their limits, and the share of a limit that is used."""

from __future__ import annotations

import numpy as np

from trajopt.view.plotting.joints import JointAxis, position
from trajopt.view.plotting.motion import MotionQuantities

KINDS = ("position", "velocity", "torque")


def share(kind: str, axis: JointAxis, motion: MotionQuantities) -> np.ndarray:
    """Share (K,) of the limit that an axis uses; NaN where it has none.

    For a position, its distance from the middle of its range over half the range; for velocities and torques,
    the magnitude over the limit.
    """
    lower, upper = limit_of(kind, axis)
    half = (upper - lower) / 2
    if not (np.isfinite(half) and half > 0):
        return np.full(len(motion.t), np.nan)
    return np.abs(value(kind, axis, motion) - (upper + lower) / 2) / half


def value(kind: str, axis: JointAxis, motion: MotionQuantities) -> np.ndarray:
    """Position, velocity or torque (K,) of an axis."""
    if kind == "position":
        return position(axis, motion)
    if kind == "velocity":
        return motion.solution.v[:, axis.row]
    if axis.torque is None:
        return np.full(len(motion.t), np.nan)
    return motion.solution.tau[:, axis.torque]


def limit_of(kind: str, axis: JointAxis) -> tuple[float, float]:
    """Least and largest allowed value of an axis."""
    if kind == "position":
        return axis.lower, axis.upper
    most = axis.speed if kind == "velocity" else axis.effort
    return -most, most
