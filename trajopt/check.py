"""The check of a solution: everything it claims, recomputed with numeric Pinocchio alone."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from trajopt.consistency import interval_gaps
from trajopt.drive import Drive
from trajopt.flight import flight_errors
from trajopt.model_quantities import gravity_of, mass_of
from trajopt.reintegration import OpenLoopError, open_loop
from trajopt.report import PhaseReport, Report
from trajopt.robot_building import position_limits
from trajopt.robot_drives import drive_torque_values
from trajopt.samples import Plane, Samples, evaluate, terrain_plane
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
    terrain = terrain_plane(plan.meta["terrain"])
    samples = evaluate(plan)
    gaps = interval_gaps(plan)
    phases = _phases(plan)
    return Report(
        **_dynamics(plan, samples),
        **_forces(plan, samples, terrain),
        **_limits(plan),
        **_drives(plan),
        **_contacts(plan, samples, terrain),
        quaternion_error=_quaternion_error(given),
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


def _least(values: np.ndarray) -> float | None:
    return float(np.min(values)) if values.size else None


def _weight(plan: Solution) -> float:
    """Weight of the moving bodies in N, the unit of forces and, times one metre, of moments."""
    return mass_of(plan.model) * gravity_of(plan.model)


def _dynamics(plan: Solution, samples: Samples) -> dict[str, float | None]:
    points, base = plan.collocation, plan.n_unactuated
    force = samples.generalized_force[points] / _weight(plan)
    acceleration = samples.acceleration[points][plan.active[points]] / gravity_of(plan.model)
    soles = np.broadcast_to(_is_sole(plan), plan.active.shape)[points][plan.active[points]]
    acceleration[~soles, 3:] = 0.0
    return {
        "base_residual": _largest(np.abs(force[:, :base])),
        "actuated_residual": _largest(np.abs(force[:, base:] - plan.tau[points] / _weight(plan))),
        "contact_acceleration": _largest(np.abs(acceleration)),
    }


def _is_sole(plan: Solution) -> np.ndarray:
    return np.array([kind == "surface" for kind in plan.meta["contact_kinds"]], dtype=bool)


def _forces(plan: Solution, samples: Samples, terrain: Plane | None) -> dict[str, float | None]:
    weight, points = _weight(plan), plan.collocation[:, None]
    normal_axis = np.array([0.0, 0.0, 1.0]) if terrain is None else terrain.normal
    force = plan.f[..., :3] / weight
    normal = force @ normal_axis
    tangential = np.linalg.norm(force - normal[..., None] * normal_axis, axis=-1)
    margin = np.array(plan.meta["friction"], dtype=float) * normal - tangential
    return {
        "friction_margin": _least(margin[plan.active & points]),
        "friction_margin_between": _least(margin[plan.active & ~points]),
        "unilateral_margin": _least(normal[plan.active & points]),
        "sole_margin": _sole_margin(plan, samples, normal, weight),
        "inactive_force": _largest(np.abs(plan.f[~plan.active]) / weight),
    }


def _sole_margin(plan: Solution, samples: Samples, normal: np.ndarray, weight: float) -> float | None:
    """Least of half_size f_n - |m| over roll, pitch and yaw in the sole's axes, weight times metre.

    Half sizes [half_length, half_width] come from the optional key ``contact_sizes`` of meta (null
    for a point); yaw is held by friction at their mean.
    """
    sizes = plan.meta.get("contact_sizes")
    if not isinstance(sizes, list) or len(sizes) != plan.f.shape[1]:
        return None
    found = []
    for index in np.flatnonzero(_is_sole(plan)):
        rows = plan.active[:, index] & plan.collocation
        if sizes[index] is None or not rows.any():
            continue
        length, width = sizes[index]
        arms = np.array([width, length, plan.meta["friction"][index] * (length + width) / 2])
        moment = np.einsum("kji,kj->ki", samples.rotation[rows, index], plan.f[rows, index, 3:]) / weight
        found.append(float((arms * normal[rows, index, None] - np.abs(moment)).min()))
    return min(found) if found else None


def _limits(plan: Solution) -> dict[str, float | None]:
    effort = _beyond(plan.tau, plan.meta["effort_limit"])
    velocity = _beyond(plan.v, plan.meta["velocity_limit"])
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


def _contacts(plan: Solution, samples: Samples, terrain: Plane | None) -> dict[str, float | None]:
    drift, turn, landing = [], [], []
    for phase in plan.phases:
        for index in np.flatnonzero(plan.active[phase.start]):
            rows = slice(phase.start, phase.stop)
            place = samples.position[rows, index]
            drift.append(np.linalg.norm(place - place[0], axis=1).max())
            if terrain is not None:
                landing.append(abs(float(terrain.height(place[0]))))
            if _is_sole(plan)[index]:
                turn.append(_turn(samples.rotation[rows, index]))
    speed = np.linalg.norm(samples.velocity[plan.active][:, :3], axis=1)
    depth = np.zeros(0) if terrain is None else np.maximum(-terrain.height(samples.position), 0.0)
    return {
        "contact_velocity": _largest(speed),
        "penetration": _largest(depth),
        "landing_height": _largest(np.array(landing)),
        "foot_drift": _largest(np.array(drift)),
        "foot_turn": _largest(np.array(turn)),
    }


def _turn(rotation: np.ndarray) -> float:
    """Largest angle (rad) between rotations (n, 3, 3) and the first, exact for small angles."""
    chord = np.linalg.norm(rotation - rotation[0], axis=(1, 2)).max() / np.sqrt(8)
    return float(2 * np.arcsin(min(chord, 1.0)))


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
