"""Figures of a check about limits of torques, drives, velocities and positions."""

from __future__ import annotations

import numpy as np

from trajopt.certify.samples import largest
from trajopt.dynamics.base_joint import position_limits
from trajopt.solution.solution import Solution

_Figures = dict[str, float | None]


def limit_figures(plan: Solution) -> _Figures:
    """Torques and velocities over their limits minus one, positions beyond theirs over the range."""
    effort = _beyond(plan.tau, plan.meta["effort_limit"])
    # Rates that are control inputs have values at collocation points only, others everywhere.
    moving = plan.collocation if plan.meta.get("actuation") == "velocity" else slice(None)
    velocity = _beyond(plan.v[moving], plan.meta["velocity_limit"])
    lower, upper = position_limits(plan.model)
    beyond = np.maximum(plan.q - upper, lower - plan.q)
    limited = np.isfinite(lower) | np.isfinite(upper)
    span = np.where(np.isfinite(upper - lower) & (upper > lower), upper - lower, 1.0)
    return {
        "effort_excess": largest(effort[plan.collocation]),
        "effort_excess_between": largest(effort[~plan.collocation]),
        "velocity_excess": largest(velocity),
        "position_excess": largest((beyond / span)[:, limited]),
    }


def _beyond(values: np.ndarray, limit: list[float | None] | None) -> np.ndarray:
    """|x| / limit - 1 of the limited columns; where the limit is zero, |x| itself."""
    if limit is None:
        return np.zeros((len(values), 0))
    bound = np.array([np.inf if entry is None else entry for entry in limit], dtype=float)
    columns = np.isfinite(bound)
    unit = np.where(bound[columns] > 0, bound[columns], 1.0)
    return np.asarray((np.abs(values[:, columns]) - bound[columns]) / unit)


def drive_figures(plan: Solution) -> _Figures:
    """Motor torque and voltage over their limits, minus one, from ``tau``, ``v`` and the drives of meta."""
    rates, torque = plan.v[:, plan.n_unactuated :], plan.drive_torque
    found = [(row, drive) for row, drive in enumerate(plan.drives) if drive is not None]
    current = [torque[:, i] / d.joint_torque_limit for i, d in found if np.isfinite(d.torque_limit)]
    voltage = [d.voltage_use(torque[:, i], rates[:, i]) for i, d in found if np.isfinite(d.stall_torque)]
    points = plan.collocation
    return {
        "drive_torque_excess": largest(np.abs([row[points] for row in current]) - 1),
        "drive_voltage_excess": largest(np.abs([row[points] for row in voltage]) - 1),
        "drive_voltage_excess_between": largest(np.abs([row[~points] for row in voltage]) - 1),
    }
