"""Comparison of a discovered cycle with the known gaits."""

import numpy as np

from trajopt.discovery.modes import ModeSequence
from trajopt.discovery.task import ContactTask
from trajopt.errors import InputError
from trajopt.schedule.gaits import Gait, gait_names, gait_of


def nearest_gait(task: ContactTask, modes: ModeSequence) -> tuple[str, float] | None:
    """The known gait nearest in touchdowns and duty factors, and its distance in periods, or None."""
    try:
        names = gait_names(task.robot)
    except InputError:
        return None
    gait = _as_gait(modes)
    if gait is None or not task.periodic:
        return None
    away = {name: _apart(gait, gait_of(task.robot, name)) for name in names}
    best = min(away, key=lambda name: away[name])
    return best, away[best]


def _as_gait(modes: ModeSequence) -> Gait | None:
    """Read duty factors and touchdowns from a cycle in which every foot steps once; None for other cycles."""
    duty, offsets = modes.duty(), {}
    begins = np.cumsum([0.0, *(duration for _, duration in modes.modes)]) / modes.duration
    for foot in sorted(duty):
        on = [foot in contacts for contacts in modes.key]
        lands = [i for i in range(len(on)) if on[i] and not on[i - 1]]
        if len(lands) != 1:
            return None
        offsets[foot] = float(begins[lands[0]])
    return Gait(name="read", duty=duty, offsets=offsets) if duty else None


def _apart(one: Gait, other: Gait) -> float:
    """Mean difference of touchdowns at the best time shift, plus half that of duty factors, in periods."""
    feet = [foot for foot in other.feet if foot in one.feet]
    if len(feet) < len(other.feet):
        return 1.0
    lags = np.array([one.offsets[foot] - other.offsets[foot] for foot in feet])
    apart = min(np.abs((lags - lag + 0.5) % 1.0 - 0.5).mean() for lag in lags)
    return float(apart + np.mean([abs(one.duty_of(foot) - other.duty_of(foot)) for foot in feet]) / 2)
