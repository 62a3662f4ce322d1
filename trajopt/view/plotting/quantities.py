"""Position, velocity and torque of a joint axis, their limits, and the share of a limit that is used."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trajopt.view.plotting.draw import FAR
from trajopt.view.plotting.joints import JointAxis, position
from trajopt.view.plotting.motion import MotionQuantities

KINDS = ("position", "velocity", "torque")
BEYOND = "beyond the axis"


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


def unit_of(kind: str, axis: JointAxis) -> str:
    """Unit of a position, velocity or torque of an axis."""
    if kind == "torque":
        return "N" if axis.slides else "N m"
    return axis.unit if kind == "position" else f"{axis.unit}/s"


def units_of(kind: str, axes: Sequence[JointAxis]) -> str:
    """Units of some axes, those of turning ones first."""
    ordered = sorted(axes, key=lambda axis: axis.slides)
    return ", ".join(dict.fromkeys(unit_of(kind, axis) for axis in ordered))


def are_far(kind: str, axes: Sequence[JointAxis], motion: MotionQuantities) -> bool:
    """Whether all limits of velocity or torque are many times (`FAR`) what the motion uses of them.

    This is so for placeholders of a description; False for positions, without a limit, and where nothing is
    used.
    """
    used = np.array([share(kind, axis, motion) for axis in axes])
    return kind != "position" and bool(0.0 < used[np.isfinite(used)].max(initial=0.0) < 1 / FAR)


def most_used(kind: str, axes: Sequence[JointAxis], motion: MotionQuantities) -> float:
    """Return the largest magnitude of a velocity or torque; 0 if none is finite."""
    values = np.array([value(kind, axis, motion) for axis in axes])
    return float(np.abs(values[np.isfinite(values)]).max(initial=0.0))


def limit_words(kind: str, axes: Sequence[JointAxis]) -> str:
    """Return limits of velocity or torque, as "limit 1000 rad/s" or "limits 24 to 45 N m"; empty without."""
    parts = []
    for unit in dict.fromkeys(unit_of(kind, axis) for axis in axes):
        limits = [limit_of(kind, axis)[1] for axis in axes if unit_of(kind, axis) == unit]
        finite = sorted(limit for limit in limits if np.isfinite(limit))
        if finite:
            ends = dict.fromkeys(f"{limit:.4g}" for limit in (finite[0], finite[-1]))
            parts.append(f"{' to '.join(ends)} {unit}")
    several = len(parts) > 1 or any(" to " in part for part in parts)
    return f"limit{'s' * several} {', '.join(parts)}" if parts else ""
