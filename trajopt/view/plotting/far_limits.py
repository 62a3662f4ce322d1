"""Limits far beyond the velocities and torques that are used, as a description's placeholders, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trajopt.view.plotting.draw import FAR
from trajopt.view.plotting.joints import JointAxis
from trajopt.view.plotting.motion import MotionQuantities
from trajopt.view.plotting.quantities import limit_of, share, value

BEYOND = "beyond the axis"


def are_far(kind: str, axes: Sequence[JointAxis], motions: Sequence[MotionQuantities]) -> bool:
    """Whether all limits of velocity or torque are many times (`FAR`) what the motions use of them.

    False for positions, without a limit, and where nothing is used.
    """
    if kind == "position":
        return False
    used = np.array([share(kind, axis, motion) for axis in axes for motion in motions])
    return bool(0.0 < used[np.isfinite(used)].max(initial=0.0) < 1 / FAR)


def most_used(kind: str, axes: Sequence[JointAxis], motion: MotionQuantities) -> float:
    """Return the largest magnitude of a velocity or torque; 0 if none is finite."""
    found = np.array([value(kind, axis, motion) for axis in axes])
    return float(np.abs(found[np.isfinite(found)]).max(initial=0.0))


def unit_of(kind: str, axis: JointAxis) -> str:
    """Return the unit of a velocity or torque of an axis."""
    if kind == "velocity":
        return f"{axis.unit}/s"
    return "N" if axis.slides else "N m"


def limit_words(kind: str, axes: Sequence[JointAxis]) -> str:
    """Return limits of velocity or torque, as "limit 1000 rad/s" or "limits 24 to 45 N m"; empty without."""
    parts = []
    for unit in dict.fromkeys(unit_of(kind, axis) for axis in axes):
        limits = {limit_of(kind, axis)[1] for axis in axes if unit_of(kind, axis) == unit}
        finite = sorted(limit for limit in limits if np.isfinite(limit))
        if finite:
            ends = dict.fromkeys(f"{limit:.4g}" for limit in (finite[0], finite[-1]))
            parts.append((" to ".join(ends), unit))
    several = len(parts) > 1 or any(" to " in ends for ends, _ in parts)
    said = ", ".join(f"{ends} {unit}" for ends, unit in parts)
    return f"limit{'s' * several} {said}" if parts else ""
