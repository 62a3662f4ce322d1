"""The check of a solution: everything it claims, recomputed with numeric Pinocchio alone."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from trajopt.actuators.drive import Drive
from trajopt.actuators.on_robot import drive_torque_values
from trajopt.bases.virtual_base import gimbal_margin_along
from trajopt.certify.clearance import clearance_figures
from trajopt.certify.closing import periodicity_error
from trajopt.certify.consistency import interval_gaps
from trajopt.certify.contact_figures import force_figures, is_sole, place_figures
from trajopt.certify.flight import flight_errors
from trajopt.certify.impact_figures import impact_figures
from trajopt.certify.reintegration import OpenLoopError, open_loop
from trajopt.certify.report import PhaseReport, Report
from trajopt.certify.samples import Samples, evaluate
from trajopt.certify.sliding import held_part
from trajopt.certify.touched import Touched, touched
from trajopt.model_quantities import gravity_of, mass_of
from trajopt.robot_building import position_limits
from trajopt.solution import Solution
from trajopt.solution_file import consistent_meta


def check(solution: Solution | str | Path) -> Report:
    """Recompute every figure of ``solution``, or of the file at that path.

    Nothing of the transcription takes part: only the file's arrays, its model, and numeric
    Pinocchio. Raises `SolutionFileError` for a file, `InputError` for a solution, that is
    inconsistent or not finite.
    """
    given = _trusted(solution)
    plan = _on_manifold(given)
    samples = evaluate(plan)
    surfaces = touched(plan, samples.position)
    gaps = interval_gaps(plan)
    phases = _phases(plan)
    return Report(
        **_dynamics(plan, samples, surfaces),
        **force_figures(plan, samples, surfaces),
        **_limits(plan),
        **_drives(plan),
        **place_figures(plan, samples, surfaces),
        **impact_figures(plan, surfaces),
        **clearance_figures(plan),
        periodicity_error=periodicity_error(plan),
        quaternion_error=_quaternion_error(given),
        gimbal_margin=gimbal_margin_along(plan.model, plan.t, plan.q, plan.v),
        position_gap=gaps.position,
        velocity_gap=gaps.velocity,
        ballistic_error=_worst([phase.ballistic_error for phase in phases]),
        momentum_error=_worst([phase.momentum_error for phase in phases]),
        ballistic_error_between=_worst([phase.ballistic_error_between for phase in phases]),
        momentum_error_between=_worst([phase.momentum_error_between for phase in phases]),
        open_loop_position=_worst([phase.open_loop_position for phase in phases]),
        open_loop_orientation=_worst([phase.open_loop_orientation for phase in phases]),
        open_loop_joints=max(phase.open_loop_joints for phase in phases),
        phases=phases,
    )


def _trusted(solution: Solution | str | Path) -> Solution:
    if not isinstance(solution, Solution):
        return Solution.load(solution)
    return replace(solution, meta=json.loads(consistent_meta(solution)))


def _on_manifold(plan: Solution) -> Solution:
    """Rotations of unit norm: their error is a figure of its own and shall not disturb the others."""
    q = np.array([pin.normalize(plan.model, row) for row in plan.q])
    return replace(plan, q=q)


def _worst(values: list[float | None]) -> float | None:
    found = [value for value in values if value is not None]
    return max(found) if found else None


def _largest(values: np.ndarray) -> float | None:
    return float(np.max(values)) if values.size else None


def _weight(plan: Solution) -> float:
    """Weight of the moving bodies in N, the unit of forces and, times one metre, of moments."""
    return mass_of(plan.model) * gravity_of(plan.model)


def _dynamics(plan: Solution, samples: Samples, surfaces: Touched) -> dict[str, float | None]:
    points, base, gravity = plan.collocation, plan.n_unactuated, gravity_of(plan.model)
    force = samples.generalized_force[points] / _weight(plan)
    balance = force[:, :base]
    held = samples.acceleration / gravity
    if plan.meta.get("actuation") == "velocity":  # rows of statics and of velocities, not of motion
        still = replace(plan, v=np.zeros_like(plan.v), a=np.zeros_like(plan.a))
        balance = evaluate(still).generalized_force[points, :base] / _weight(plan) if base else balance
        held = samples.velocity / np.sqrt(gravity)
    held = np.concatenate([held_part(held[..., :3], surfaces), held[..., 3:]], axis=-1)
    acceleration = held[points][plan.active[points]]
    soles = np.broadcast_to(is_sole(plan), plan.active.shape)[points][plan.active[points]]
    acceleration[~soles, 3:] = 0.0
    return {
        "base_residual": _largest(np.abs(balance)),
        "actuated_residual": _largest(np.abs(force[:, base:] - plan.tau[points] / _weight(plan))),
        "contact_acceleration": _largest(np.abs(acceleration)),
    }


def _limits(plan: Solution) -> dict[str, float | None]:
    effort = _beyond(plan.tau, plan.meta["effort_limit"])
    # Rates that are inputs have values at points; those of motions have them everywhere.
    moving = plan.collocation if plan.meta.get("actuation") == "velocity" else slice(None)
    velocity = _beyond(plan.v[moving], plan.meta["velocity_limit"])
    lower, upper = position_limits(plan.model)
    beyond = np.maximum(plan.q - upper, lower - plan.q)
    limited = np.isfinite(lower) | np.isfinite(upper)
    span = np.where(np.isfinite(upper - lower) & (upper > lower), upper - lower, 1.0)
    return {
        "effort_excess": _largest(effort[plan.collocation]),
        "effort_excess_between": _largest(effort[~plan.collocation]),
        "velocity_excess": _largest(velocity),
        "position_excess": _largest((beyond / span)[:, limited]),
    }


def _beyond(values: np.ndarray, limit: list[float | None] | None) -> np.ndarray:
    """|x| / limit - 1 of the limited columns; a limit of zero counts in units of x itself."""
    if limit is None:
        return np.zeros((len(values), 0))
    bound = np.array([np.inf if entry is None else entry for entry in limit], dtype=float)
    columns = np.isfinite(bound)
    unit = np.where(bound[columns] > 0, bound[columns], 1.0)
    return np.asarray((np.abs(values[:, columns]) - bound[columns]) / unit)


def _drives(plan: Solution) -> dict[str, float | None]:
    """Motor torque and voltage over their limits, minus one, from ``tau``, ``v`` and the drives of meta."""
    entries = plan.meta.get("drives") or []
    drives = tuple(None if entry is None else Drive.from_meta(entry) for entry in entries)
    rates = plan.v[:, plan.n_unactuated :]
    torque = drive_torque_values(drives, plan.tau, rates) if drives else plan.tau
    found = [(row, drive) for row, drive in enumerate(drives) if drive is not None]
    current = [torque[:, i] / d.joint_torque_limit for i, d in found if np.isfinite(d.torque_limit)]
    voltage = [d.voltage_use(torque[:, i], rates[:, i]) for i, d in found if np.isfinite(d.stall_torque)]
    points = plan.collocation
    return {
        "drive_torque_excess": _largest(np.abs([row[points] for row in current]) - 1),
        "drive_voltage_excess": _largest(np.abs([row[points] for row in voltage]) - 1),
        "drive_voltage_excess_between": _largest(np.abs([row[~points] for row in voltage]) - 1),
    }


def _quaternion_error(plan: Solution) -> float | None:
    """Largest | |x| - 1 | over unit quaternions and (cos, sin) pairs."""
    errors = []
    for joint in list(plan.model.joints)[1:]:
        units = {"JointModelFreeFlyer": 4, "JointModelSpherical": 4, "JointModelPlanar": 2}
        size = units.get(joint.shortname(), 2 if joint.nq == 2 and joint.nv == 1 else 0)
        if size:
            end = joint.idx_q + joint.nq
            errors.append(np.abs(np.linalg.norm(plan.q[:, end - size : end], axis=1) - 1).max())
    return _largest(np.array(errors))


def _phases(plan: Solution) -> tuple[PhaseReport, ...]:
    return tuple(
        _phase(plan, phase, error) for phase, error in zip(plan.phases, open_loop(plan), strict=True)
    )


def _phase(plan: Solution, phase: range, error: OpenLoopError) -> PhaseReport:
    flight = flight_errors(plan, phase)
    names = [plan.contact_frames[index] for index in np.flatnonzero(plan.active[phase.start])]
    return PhaseReport(
        index=int(plan.phase[phase.start]),
        start=float(plan.t[phase.start]),
        end=float(plan.t[phase.stop - 1]),
        contacts=tuple(names),
        open_loop_position=error.position,
        open_loop_orientation=error.orientation,
        open_loop_joints=error.joints,
        ballistic_error=None if flight is None else flight.ballistic,
        momentum_error=None if flight is None else flight.momentum,
        ballistic_error_between=None if flight is None else flight.ballistic_between,
        momentum_error_between=None if flight is None else flight.momentum_between,
    )
