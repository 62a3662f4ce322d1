"""Figures of a check about limits of torques, drives, velocities and positions."""

from collections.abc import Sequence

import numpy as np

from trajopt.dynamics.base_joint import position_limits
from trajopt.motion.traces import Trace, Traces, joints_of, names_of_inputs, names_of_rows
from trajopt.solution.solution import Solution


def limit_traces(plan: Solution) -> Traces:
    """Torques and velocities over their limits minus one, positions beyond theirs over the range."""
    rows = names_of_rows(plan)
    driven, least = names_of_inputs(plan), [thruster.least for thruster in plan.description.thrusters]
    # Rates that are control inputs have values at collocation points only, others everywhere.
    moving = plan.collocation[:, None] if plan.description.velocity_input else True
    lower, upper = position_limits(plan.model)
    beyond = np.maximum(plan.q - upper, lower - plan.q)
    limited = np.isfinite(lower) | np.isfinite(upper)
    span = np.where(np.isfinite(upper - lower) & (upper > lower), upper - lower, 1.0)
    places = [name for joint, name in joints_of(plan) for _ in range(joint.nq)]
    return {
        "effort_excess": _beyond(plan.tau, plan.description.effort_limit, driven, least=least),
        "velocity_excess": _beyond(plan.v, plan.description.velocity_limit, rows, moving),
        "position_excess": Trace.of(beyond / span, limited, places),
    }


def _beyond(
    values: np.ndarray,
    limit: np.ndarray | None,
    names: list[str],
    counts: np.ndarray | bool = True,
    least: Sequence[float] = (),
) -> Trace:
    """|x| / limit - 1 of the limited columns; where the limit is zero, |x| itself."""
    bound = np.full(values.shape[1], np.inf) if limit is None else limit
    limited = np.isfinite(bound)
    unit, most = np.where(limited & (bound > 0), bound, 1.0), np.where(limited, bound, 0.0)
    beyond, last = np.where(limited, np.abs(values) - most, -np.inf), values.shape[1] - len(least)
    beyond[:, last:] = np.maximum(beyond[:, last:], least - values[:, last:])
    limited[last:] = True
    return Trace.of(beyond / unit, limited & counts, names)


def drive_traces(plan: Solution) -> Traces:
    """Motor torque and voltage over their limits, minus one, from ``tau``, ``v`` and the drives."""
    rates, torque = plan.actuation.rates(plan.v), plan.drive_torque
    names = names_of_inputs(plan)
    current, voltage = np.zeros(torque.shape), np.zeros(torque.shape)
    limited, wound = np.zeros(torque.shape[1], dtype=bool), np.zeros(torque.shape[1], dtype=bool)
    for i, drive in enumerate(plan.drives):
        if drive is not None and np.isfinite(drive.torque_limit):
            limited[i], current[:, i] = True, torque[:, i] / drive.joint_torque_limit
        if drive is not None and np.isfinite(drive.stall_torque):
            wound[i], voltage[:, i] = True, drive.voltage_use(torque[:, i], rates[:, i])
    return {
        "drive_torque_excess": Trace.of(np.abs(current) - 1, limited, names),
        "drive_voltage_excess": Trace.of(np.abs(voltage) - 1, wound, names),
    }
