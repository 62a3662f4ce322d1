"""Check a solution: recompute everything that it claims with numeric Pinocchio alone."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, get_args

import numpy as np
import pinocchio as pin

from trajopt.arguments import checked
from trajopt.certify.accuracy.local_errors import LocalErrors, local_errors
from trajopt.certify.contact_figures import ContactStarts, inactive_force, landing_height
from trajopt.certify.dense import dense_motion, figures_at
from trajopt.certify.impact_figures import impact_figures
from trajopt.certify.reintegration import ROUGH_ERROR, OpenLoopError, open_loop
from trajopt.certify.report import (
    FIGURES,
    GRADE,
    OPEN_LOOP,
    OPEN_LOOP_JOINTS,
    OPEN_LOOP_ORIENTATION,
    OPEN_LOOP_POSITION,
    STABLE_GROWTH,
    CheckReport,
    PhaseReport,
    Tolerances,
)
from trajopt.motion.input import SolutionOrFile, consistent_solution
from trajopt.motion.quantities import MotionQuantities
from trajopt.motion.samples import largest, largest_known
from trajopt.motion.solution import Solution
from trajopt.motion.statistics import TermExcess
from trajopt.motion.traces import Occurrence, Trace, Traces, names_of_inputs, names_of_rows
from trajopt.robot.actuators.joint_limits import HigherLimit, limits_by_row

# Smallest scale of angular momentum, as a fraction of m l sqrt(g l) for a robot of mass m and reach l.
QUIET_MOMENTUM = 1e-2
# Smallest travel of the centre of mass (m) that ballistic errors are relative to.
LEAST_TRAVEL = 1e-6
# Figures of free motion in flight: its parabola and its angular momentum.
FLIGHT = ("ballistic_error", "momentum_error", "ballistic_error_between", "momentum_error_between")
# Figures of phases, of which the report has the worst.
PHASE_FIGURES = (*FLIGHT, *OPEN_LOOP, "local_position", "local_joints")
# Rows of the NLP hold at the collocation points, or at all samples of the file; the same figures at all times
# have the suffix BETWEEN.
AT_POINTS = (
    "friction_margin",
    "unilateral_margin",
    "sole_margin",
    "sliding_friction",
    "effort_excess",
    "drive_torque_excess",
    "drive_voltage_excess",
)
AT_SAMPLES = ("velocity_excess", "position_excess")
BETWEEN = "_between"
# Figures of contacts that stay in place, and of the whole-body dynamics: not judged for other dynamics.
HELD = (
    *("contact_acceleration", "contact_velocity", "landing_height", "penetration", "patch_margin"),
    *("foot_drift", "stance_drift", "foot_turn", "sole_tilt"),
)
WHOLE_BODY = ("base_residual", "actuated_residual", "local_position", "local_joints")
# A torque turns where it reverses by more than this fraction of its limit.
LEAST_TURN = 0.01
# Fractions of an interval at which accelerations, jerks and rates of torques are compared with limits.
WITHIN = np.linspace(0.0, 1.0, 9)
# Figures that grow along a phase: a finer mesh in the whole phase reduces them.
DRIFTS = ("foot_drift", "stance_drift", "foot_turn")
# Figures that a finer mesh does not reduce.
BODIES = ("link_depth", "obstacle_distance", "self_distance", "clearance_margin")


@checked
def check(solution: SolutionOrFile, *, integrate: bool = True) -> CheckReport:
    """Recompute every figure of a solution from its arrays and its model with numeric Pinocchio.

    No code of the transcription is used.

    Args:
        solution: The solution, or the path of its file.
        integrate: Integrate the open loop of every phase. If False, phases whose local errors are small
            enough are skipped and the others are integrated roughly; this saves most of the time.

    Raises:
        SolutionFileError: For a file that is inconsistent or not finite.
        InputError: For a solution that is inconsistent or not finite.
    """
    return examine(consistent_solution(solution), integrate=integrate).report


@dataclass(frozen=True, kw_only=True)
class Examination:
    """A check, with the errors by interval and phase that guide mesh refinement.

    Args:
        report: Figures of the check.
        local: Local errors of the intervals.
        broken: Largest ratio (I,) of a figure to its tolerance at all times in each interval.
        drift: Largest ratio (n_phases,) of contact drift or turn to its tolerance in each phase.
        motion: The motion that is checked.
    """

    report: CheckReport
    local: LocalErrors
    broken: np.ndarray
    drift: np.ndarray
    motion: MotionQuantities = field(repr=False)

    def integrated(self) -> CheckReport:
        """Return the report with the open loop of every phase, see `check`."""
        phases = tuple(_phases(self.motion, self.local, True))
        places = {**self.report.places, **_places_of_phases(phases)}
        return replace(self.report, phases=phases, places=places, **_worst_of(phases))


def examine(given: Solution, tolerances: Tolerances = GRADE, *, integrate: bool = False) -> Examination:
    """Check a consistent solution, and compare its intervals and phases with ``tolerances``; see `check`."""
    # The norm error of rotations has its own figure and must not affect the others.
    motion = MotionQuantities.normalized(given)
    dynamics, starts = motion.dynamics_traces, ContactStarts.of(motion)
    samples = figures_at(motion, starts)
    local, dense = local_errors(motion), dense_motion(motion, samples, starts)
    phases = tuple(_phases(motion, local, integrate))
    at_samples: Traces = {
        **dynamics,
        **{name: samples[name].at(motion.solution.collocation) for name in AT_POINTS},
        **{name: samples[name] for name in (*AT_SAMPLES, "contact_velocity")},
        "inactive_force": inactive_force(motion),
        "landing_height": landing_height(motion, starts),
    }
    anywhere = {
        f"{name}{BETWEEN}" if name in (*AT_POINTS, *AT_SAMPLES) else name: trace
        for name, trace in dense.traces.items()
        if name not in at_samples or name in (*AT_POINTS, *AT_SAMPLES)
    }
    worst = {
        **{name: _worst(motion.solution, trace) for name, trace in at_samples.items()},
        **{name: _worst(dense.plan, trace) for name, trace in anywhere.items()},
    }
    steady = {name: trace for name, trace in anywhere.items() if name in DRIFTS}
    unjudged = () if given.description.dynamics == "held" else HELD
    moving = {name: t for name, t in anywhere.items() if name not in (*DRIFTS, *BODIES, *unjudged)}
    examination = Examination(
        report=_report(motion, _quaternion_error(given), worst, phases),
        local=local,
        broken=np.maximum(
            _largest_ratio(moving, tolerances, dense.plan.interval, motion.solution.n_intervals),
            _term_ratios(motion.solution, tolerances),
        ),
        drift=_largest_ratio(steady, tolerances, dense.plan.phase, len(phases)),
        motion=motion,
    )
    return examination if given.description.dynamics == "held" else _without_contacts(examination)


def _without_contacts(examination: Examination) -> Examination:
    """Leave out the figures that dynamics of the problem's own do not need to meet, and say so."""
    report, own = examination.report, examination.motion.solution.description.dynamics == "own"
    unknown = (*HELD, *(WHOLE_BODY if own else ()))
    nothing: dict[str, Any] = dict.fromkeys(unknown)
    notes = [*report.notes, "contacts are moved by rows of the problem's own, so their motion is not judged"]
    if own:
        notes.append("the dynamics are the problem's own and are not judged")
    report = replace(
        report,
        **nothing,
        places={name: place for name, place in report.places.items() if name not in unknown},
        phases=() if own else report.phases,
        notes=tuple(notes),
    )
    return replace(examination, report=report, drift=np.zeros_like(examination.drift))


def _worst(plan: Solution, trace: Trace) -> tuple[float, Occurrence] | None:
    """Return the worst value of a figure over the samples of a plan, and its place; None if it has none."""
    worst = trace.worst()
    if worst is None:
        return None
    value, row, column = worst
    phase = plan.phase_names[int(plan.phase[row])]
    return value, Occurrence(time=float(plan.t[row]), phase=phase, name=trace.names[column])


def _largest_ratio(traces: Traces, tolerances: Tolerances, group: np.ndarray, count: int) -> np.ndarray:
    """Return the largest ratio of judged figures to their tolerances in each of ``count`` sample groups."""
    largest = np.zeros(count)
    for name, trace in traces.items():
        key = FIGURES[name].tolerance
        limit = None if key is None else getattr(tolerances, key)
        if limit is not None:
            np.maximum.at(largest, group, trace.badness.max(axis=1, initial=0.0) / limit)
    return largest


def _term_ratios(solution: Solution, tolerances: Tolerances) -> np.ndarray:
    """Return the ratio (I,) to their tolerance of terms that only the solve could evaluate."""
    stated, count = np.array(solution.statistics.excess_by_interval), solution.n_intervals
    if tolerances.between is None or len(stated) != count:
        return np.zeros(count)
    return stated / tolerances.between


def _report(
    motion: MotionQuantities,
    quaternion_error: float | None,
    worst: dict[str, tuple[float, Occurrence] | None],
    phases: tuple[PhaseReport, ...],
) -> CheckReport:
    worst |= _smoothness(motion.solution) | _joint_use(motion.solution)
    stated = motion.solution.statistics.terms_between
    term = max(stated, key=lambda entry: entry.excess, default=None)
    place = None if term is None else Occurrence(time=term.time, phase=term.phase, name=term.term)
    worst["term_excess"] = None if term is None or place is None else (term.excess, place)
    return CheckReport(
        **{name: None if known is None else known[0] for name, known in worst.items()},
        **impact_figures(motion),
        periodicity_error=motion.periodicity_error,
        quaternion_error=quaternion_error,
        gimbal_margin=motion.gimbal_margin,
        position_gap=motion.integration_gaps.position,
        velocity_gap=motion.integration_gaps.velocity,
        **_worst_of(phases),
        phases=phases,
        notes=(*motion.missing_shapes, *_notes_of_terms(stated)),
        simulated=motion.solution.statistics.simulated,
        places={
            **{name: known[1] for name, known in worst.items() if known is not None},
            **_places_of_phases(phases),
        },
    )


def _smoothness(plan: Solution) -> dict[str, tuple[float, Occurrence] | None]:
    """Return the largest sum of changes of a torque, over its limit, and the number of its turns."""
    limits = plan.description.effort_limit
    rows: np.ndarray = (
        np.zeros(0, int) if limits is None else np.flatnonzero(np.isfinite(limits) & (limits > 0))
    )
    if limits is None or not len(rows) or not len(plan.tau):
        return dict.fromkeys(("torque_variation", "torque_reversals"))
    shares = plan.tau[:, rows] / limits[rows]
    changes = np.abs(np.diff(shares, axis=0))
    worst = int(np.argmax(changes.sum(axis=0)))
    at = int(np.argmax(changes[:, worst], axis=0)) if len(changes) else 0
    name = names_of_inputs(plan)[int(rows[worst])]
    place = Occurrence(time=float(plan.t[at]), phase=plan.phase_names[int(plan.phase[at])], name=name)
    turns, extreme, direction = 0, float(shares[0, worst]), 0.0
    for share in shares[1:, worst].tolist():
        if (share - extreme) * direction > 0 or (direction == 0 and abs(share - extreme) > LEAST_TURN):
            direction, extreme = math.copysign(1.0, share - extreme), share
        elif direction and abs(share - extreme) > LEAST_TURN:
            turns, direction, extreme = turns + 1, -direction, share
    sums = float(changes[:, worst].sum())
    return {"torque_variation": (sums, place), "torque_reversals": (float(turns), place)}


def _joint_use(plan: Solution) -> dict[str, tuple[float, Occurrence] | None]:
    """Return largest accelerations, and of jerk inputs jerks and torque rates, over the limits of joints."""
    used: dict[str, tuple[float, Occurrence] | None] = {f"{kind}_use": None for kind in get_args(HigherLimit)}
    numbers, fractions = (
        np.repeat(np.arange(plan.n_intervals), len(WITHIN)),
        np.tile(WITHIN, plan.n_intervals),
    )
    if not plan.description.joint_limits:
        return used
    jerk, torque_rate = plan.polynomials.rates(numbers, fractions)
    values: dict[HigherLimit, np.ndarray] = {"acceleration": plan.polynomials.at(numbers, fractions).a}
    if plan.order == 3:
        values |= {"jerk": jerk, "torque_rate": plan.actuation.force(torque_rate)}
    for kind, value in values.items():
        shares = np.abs(value) / limits_by_row(plan.model, plan.description.joint_limits, kind)
        row, column = np.unravel_index(int(np.argmax(shares)), shares.shape)
        begin, end = plan.interval_t[numbers[row]]
        place = Occurrence(
            time=float(begin + fractions[row] * (end - begin)),
            phase=plan.phase_names[int(plan.phase[plan.intervals[numbers[row]].start])],
            name=names_of_rows(plan)[column],
        )
        used[f"{kind}_use"] = (float(shares[row, column]), place) if shares.any() else None
    return used


def _notes_of_terms(stated: Sequence[TermExcess]) -> Iterator[str]:
    if stated:
        each = ", ".join(f"{entry.term} {entry.excess:.1e} at {entry.time:.3f} s" for entry in stated)
        yield f"terms that the file does not contain were judged between points by the solve: {each}"


def _worst_of(phases: tuple[PhaseReport, ...]) -> dict[str, Any]:
    return {name: largest_known(getattr(phase, name) for phase in phases) for name in PHASE_FIGURES}


def _places_of_phases(phases: tuple[PhaseReport, ...]) -> dict[str, Occurrence]:
    """Return, for each figure of phases, the phase in which it is worst, and that phase's start."""
    places = {}
    for name in PHASE_FIGURES:
        known = [phase for phase in phases if getattr(phase, name) is not None]
        if known:
            worst = max(known, key=lambda phase: getattr(phase, name))
            places[name] = Occurrence(time=worst.start, phase=worst.name)
    return places


def _quaternion_error(plan: Solution) -> float | None:
    """Return the largest | |x| - 1 | over unit quaternions and (cos, sin) pairs."""
    errors = []
    for joint in list(plan.model.joints)[1:]:
        units = {"JointModelFreeFlyer": 4, "JointModelSpherical": 4, "JointModelPlanar": 2}
        size = units.get(joint.shortname(), 2 if joint.nq == 2 and joint.nv == 1 else 0)
        if size:
            end = joint.idx_q + joint.nq
            errors.append(np.abs(np.linalg.norm(plan.q[:, end - size : end], axis=1) - 1).max())
    return largest(np.array(errors))


def _phases(motion: MotionQuantities, local: LocalErrors, integrate: bool) -> Iterator[PhaseReport]:
    plan = motion.solution
    held = plan.description.dynamics == "held"
    for index, phase in enumerate(plan.phases):
        inside = slice(plan.intervals_of(index).start, plan.intervals_of(index).stop)
        sums = float(local.position[inside].sum()), float(local.joints[inside].sum())
        error, integrated = None, held and (integrate or _may_miss(sums))
        if held and integrate:
            error = open_loop(motion, index)
        elif integrated:
            error = open_loop(motion, index, ROUGH_ERROR, (STABLE_GROWTH * sums[0], STABLE_GROWTH * sums[1]))
        yield PhaseReport(
            index=int(plan.phase[phase.start]),
            name=plan.phase_names[index],
            start=float(plan.t[phase.start]),
            end=float(plan.t[phase.stop - 1]),
            contacts=tuple(plan.contact_frames[i] for i in np.flatnonzero(plan.active[phase.start])),
            local_position=sums[0] / motion.units.length,
            local_joints=sums[1],
            open_loop_position=None if error is None else error.position,
            open_loop_orientation=None if error is None else error.orientation,
            open_loop_joints=None if error is None else error.joints,
            stable=error is not None and _is_stable(error, sums) if integrated else None,
            **flight_errors(motion, phase),
        )


def _may_miss(local: tuple[float, float]) -> bool:
    """Return whether a stable phase with these summed local errors, m and rad, may exceed a tolerance."""
    turn = min(OPEN_LOOP_ORIENTATION, OPEN_LOOP_JOINTS)
    return STABLE_GROWTH * local[0] > OPEN_LOOP_POSITION or STABLE_GROWTH * local[1] > turn


def _is_stable(error: OpenLoopError, local: tuple[float, float]) -> bool:
    """Return whether the open loop amplifies summed local errors, m and rad, by up to `STABLE_GROWTH`."""
    turn = max(error.joints, error.orientation or 0.0)
    return (error.position or 0.0) <= STABLE_GROWTH * local[0] and turn <= STABLE_GROWTH * local[1]


def flight_errors(motion: MotionQuantities, phase: range) -> dict[str, float | None]:
    """Return the ``FLIGHT`` of free motion in ``phase``; None with contacts, other forces or a fixed base.

    Ballistic: max |c - c_0 - c'_0 t - g t^2 / 2| over the phase's max |c - c_0|.
    Momentum: max |h - h_0| over max(|h|, ``QUIET_MOMENTUM`` m l sqrt(g l)), with h the angular momentum about
    the centre of mass and l the reach. For a planar base only the free components count. Both are given at
    nodes, where a scheme has its full order, and at the collocation points between them.
    """
    solution, base = motion.solution, motion.base
    samples = slice(phase.start, phase.stop)
    pushed = solution.description.thrusters or solution.description.wrenches
    if base == "fixed" or pushed or solution.active[samples].any():
        return dict.fromkeys(FLIGHT)
    t = solution.t[samples] - solution.t[phase.start]
    com, velocity, momentum, mass = _centroidal(solution, phase)
    gravity = np.asarray(solution.model.gravity.linear)
    deviation = com - com[0] - np.outer(t, velocity[0]) - 0.5 * np.outer(t**2, gravity)
    if base == "planar":
        axes = solution.model.jointPlacements[1].rotation
        deviation, momentum = deviation @ axes[:, :2], momentum @ axes[:, 2:]
    travel = max(float(np.linalg.norm(com - com[0], axis=1).max()), LEAST_TRAVEL)
    length, fall = motion.reach, float(np.linalg.norm(gravity)) or 1.0
    quiet = QUIET_MOMENTUM * mass * length * np.sqrt(fall * length)
    scale = max(float(np.linalg.norm(momentum, axis=1).max()), quiet)
    ballistic = np.linalg.norm(deviation, axis=1) / travel
    change = np.linalg.norm(momentum - momentum[0], axis=1) / scale
    node = ~solution.collocation[samples]
    errors = (part[at].max() for at in (node, ~node) for part in (ballistic, change))
    return dict(zip(FLIGHT, map(float, errors), strict=True))


def _centroidal(solution: Solution, phase: range) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return the centre of mass (n, 3), its velocity (n, 3), angular momentum about it (n, 3), mass (kg)."""
    model = solution.model
    data = model.createData()
    com, velocity, momentum = [], [], []
    for row in phase:
        total = pin.computeCentroidalMomentum(model, data, solution.q[row], solution.v[row])
        mass = pin.computeTotalMass(model, data)
        com.append(pin.centerOfMass(model, data, solution.q[row]).copy())
        velocity.append(total.linear / mass)
        momentum.append(total.angular.copy())
    return np.array(com), np.array(velocity), np.array(momentum), float(mass)
