"""The check of a solution: everything it claims, recomputed with numeric Pinocchio alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from trajopt.arguments import checked
from trajopt.certify.accuracy.local_errors import LocalErrors, local_errors
from trajopt.certify.closing import periodicity_error
from trajopt.certify.consistency import interval_gaps
from trajopt.certify.contact_figures import ContactStarts, inactive_force, landing_height
from trajopt.certify.dense import dense_motion, figures_at
from trajopt.certify.flight import FIGURES as FLIGHT
from trajopt.certify.flight import flight_errors
from trajopt.certify.impact_figures import impact_figures
from trajopt.certify.reintegration import RELATIVE_ERROR, ROUGH_ERROR, OpenLoopError, open_loop
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
from trajopt.dynamics.virtual_base import gimbal_margin_along
from trajopt.motion.body_distances import FileBodies, missing_shapes
from trajopt.motion.dynamics_rows import dynamics_traces
from trajopt.motion.samples import largest, largest_known, sample_quantities
from trajopt.motion.touched import TouchedSurfaces, touched_surfaces
from trajopt.motion.traces import Found, Occurrence, Traces, worst_of
from trajopt.robot.natural_units import NaturalUnits
from trajopt.solution.input import SolutionOrFile, consistent_solution
from trajopt.solution.solution import Solution

# Worst of all phases in the report.
PHASE_FIGURES = (*FLIGHT, *OPEN_LOOP, "local_position", "local_joints")
# Rows of the NLP hold at the collocation points, or at all samples of the file; the same figures at any time
# have the suffix.
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
# Figures that grow along a phase: a finer mesh there mends them, wherever they are largest.
DRIFTS = ("foot_drift", "stance_drift", "foot_turn")
# Figures that a finer mesh does not mend.
BODIES = ("link_depth", "obstacle_distance", "self_distance", "clearance_margin")


@checked
def check(solution: SolutionOrFile, *, integrate: bool = True) -> CheckReport:
    """Recompute every figure of a solution from its arrays and its model with numeric Pinocchio.

    Nothing of the transcription is used.

    Args:
        solution: the solution, or the path of its file.
        integrate: the open loop of every phase; False leaves out phases that are within its tolerances by
            their local errors, integrates others as a verdict needs it, and saves most of the time.

    Raises:
        SolutionFileError: for a file that is inconsistent or not finite.
        InputError: for such a solution.
    """
    return examine(consistent_solution(solution), integrate=integrate).report


@dataclass(frozen=True, kw_only=True)
class Examination:
    """A check with what a finer mesh follows from.

    local: errors of the intervals. broken: (I,) the largest figure at any time in each interval, over its
    tolerance. drift: (n_phases,) the same of contacts that must stay where they are.
    """

    report: CheckReport
    local: LocalErrors
    broken: np.ndarray
    drift: np.ndarray


def examine(given: Solution, tolerances: Tolerances = GRADE, *, integrate: bool = False) -> Examination:
    """Check a consistent solution, and compare intervals and phases with ``tolerances``; see `check`."""
    plan = given.normalized()  # the norm error of rotations has its own figure and must not affect others
    motion, samples = plan.polynomials, sample_quantities(plan)
    surfaces, local = touched_surfaces(plan, samples.position), local_errors(plan, motion)
    starts = ContactStarts.of(plan, samples, surfaces)
    bodies, apart = FileBodies.of(plan)
    here = figures_at(plan, samples, surfaces, starts, apart)
    dense = dense_motion(plan, motion, here, starts, bodies)
    phases = tuple(_phases(plan, local, integrate))
    own: Traces = {
        **dynamics_traces(plan, samples, surfaces),
        **{name: here[name].at(plan.collocation) for name in AT_POINTS},
        **{name: here[name] for name in (*AT_SAMPLES, "contact_velocity")},
        "inactive_force": inactive_force(plan),
        "landing_height": landing_height(plan, samples, surfaces, starts),
    }
    anywhere = {
        f"{name}{BETWEEN}" if name in (*AT_POINTS, *AT_SAMPLES) else name: trace
        for name, trace in dense.traces.items()
        if name not in own or name in (*AT_POINTS, *AT_SAMPLES)
    }
    found = {
        **{name: worst_of((plan, trace)) for name, trace in own.items()},
        **{name: worst_of((dense.plan, trace)) for name, trace in anywhere.items()},
    }
    steady = {name: trace for name, trace in anywhere.items() if name in DRIFTS}
    moving = {name: trace for name, trace in anywhere.items() if name not in (*DRIFTS, *BODIES)}
    return Examination(
        report=_report(given, plan, surfaces, found, phases),
        local=local,
        broken=_largest_ratio(moving, tolerances, dense.plan.interval, plan.n_intervals),
        drift=_largest_ratio(steady, tolerances, dense.plan.phase, len(phases)),
    )


def _largest_ratio(traces: Traces, tolerances: Tolerances, group: np.ndarray, count: int) -> np.ndarray:
    """Largest ratio of judged figures to their tolerances in each of ``count`` groups of samples."""
    largest = np.zeros(count)
    for name, trace in traces.items():
        key = FIGURES[name].tolerance
        limit = None if key is None else getattr(tolerances, key)
        if limit is not None:
            np.maximum.at(largest, group, trace.badness.max(axis=1, initial=0.0) / limit)
    return largest


def _report(
    given: Solution,
    plan: Solution,
    surfaces: TouchedSurfaces,
    found: dict[str, Found | None],
    phases: tuple[PhaseReport, ...],
) -> CheckReport:
    gaps = interval_gaps(plan)
    return CheckReport(
        **{name: None if own is None else own.value for name, own in found.items()},
        **impact_figures(plan, surfaces),
        periodicity_error=periodicity_error(plan),
        quaternion_error=_quaternion_error(given),
        gimbal_margin=gimbal_margin_along(plan.model, plan.t, plan.q, plan.v),
        position_gap=gaps.position,
        velocity_gap=gaps.velocity,
        **{name: largest_known(getattr(phase, name) for phase in phases) for name in PHASE_FIGURES},
        phases=phases,
        notes=missing_shapes(plan),
        places={
            **{name: own.place for name, own in found.items() if own is not None},
            **_places_of_phases(phases),
        },
    )


def _places_of_phases(phases: tuple[PhaseReport, ...]) -> dict[str, Occurrence]:
    """The phase in which its figures are worst, and its start."""
    found = {}
    for name in PHASE_FIGURES:
        known = [phase for phase in phases if getattr(phase, name) is not None]
        if known:
            worst = max(known, key=lambda phase: getattr(phase, name))
            found[name] = Occurrence(time=worst.start, phase=worst.name)
    return found


def _quaternion_error(plan: Solution) -> float | None:
    """Largest | |x| - 1 | over unit quaternions and (cos, sin) pairs."""
    errors = []
    for joint in list(plan.model.joints)[1:]:
        units = {"JointModelFreeFlyer": 4, "JointModelSpherical": 4, "JointModelPlanar": 2}
        size = units.get(joint.shortname(), 2 if joint.nq == 2 and joint.nv == 1 else 0)
        if size:
            end = joint.idx_q + joint.nq
            errors.append(np.abs(np.linalg.norm(plan.q[:, end - size : end], axis=1) - 1).max())
    return largest(np.array(errors))


def _phases(plan: Solution, local: LocalErrors, integrate: bool) -> Iterator[PhaseReport]:
    names, reach = plan.phase_names, NaturalUnits.of(plan.model).length
    for index, phase in enumerate(plan.phases):
        inside = slice(plan.intervals_of(index).start, plan.intervals_of(index).stop)
        sums = float(local.position[inside].sum()), float(local.joints[inside].sum())
        error = None
        if integrate or _may_miss(sums):
            error = open_loop(plan, index, RELATIVE_ERROR if integrate else ROUGH_ERROR)
        yield PhaseReport(
            index=int(plan.phase[phase.start]),
            name=names[index],
            start=float(plan.t[phase.start]),
            end=float(plan.t[phase.stop - 1]),
            contacts=tuple(plan.contact_frames[i] for i in np.flatnonzero(plan.active[phase.start])),
            local_position=sums[0] / reach,
            local_joints=sums[1],
            open_loop_position=None if error is None else error.position,
            open_loop_orientation=None if error is None else error.orientation,
            open_loop_joints=None if error is None else error.joints,
            stable=None if error is None else _is_stable(error, sums),
            **flight_errors(plan, phase),
        )


def _may_miss(local: tuple[float, float]) -> bool:
    """Whether a stable phase with these sums of local errors, m and rad, may be beyond a tolerance."""
    turn = min(OPEN_LOOP_ORIENTATION, OPEN_LOOP_JOINTS)
    return STABLE_GROWTH * local[0] > OPEN_LOOP_POSITION or STABLE_GROWTH * local[1] > turn


def _is_stable(error: OpenLoopError, local: tuple[float, float]) -> bool:
    """Whether the open loop of a phase amplifies the sums of its local errors, m and rad, little."""
    turn = max(error.joints, error.orientation or 0.0)
    return (error.position or 0.0) <= STABLE_GROWTH * local[0] and turn <= STABLE_GROWTH * local[1]
