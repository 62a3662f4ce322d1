"""The check of a solution: everything it claims, recomputed with numeric Pinocchio alone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from trajopt.certify.closing import periodicity_error
from trajopt.certify.consistency import interval_gaps
from trajopt.certify.contact_figures import force_figures, place_figures
from trajopt.certify.dynamics_figures import dynamics_figures
from trajopt.certify.flight import FIGURES, flight_errors
from trajopt.certify.impact_figures import impact_figures
from trajopt.certify.limit_figures import drive_figures, limit_figures
from trajopt.certify.reintegration import open_loop
from trajopt.certify.report import CheckReport, PhaseReport
from trajopt.certify.samples import largest, largest_known, sample_quantities
from trajopt.dynamics.virtual_base import gimbal_margin_along
from trajopt.solution.clearance import clearance_figures, missing_shapes
from trajopt.solution.input import SolutionOrFile, consistent_solution
from trajopt.solution.solution import Solution
from trajopt.solution.touched import touched_surfaces

# Worst of all phases in the report.
PHASE_FIGURES = (*FIGURES, "open_loop_position", "open_loop_orientation")


def check(solution: SolutionOrFile) -> CheckReport:
    """Recompute every figure of a solution from its arrays and its model with numeric Pinocchio.

    Nothing of the transcription is used.

    Args:
        solution: the solution, or the path of its file.

    Raises:
        SolutionFileError: for a file that is inconsistent or not finite.
        InputError: for such a solution.
    """
    given = consistent_solution(solution)
    plan = given.normalized()  # the norm error of rotations has its own figure and must not affect others
    samples = sample_quantities(plan)
    surfaces = touched_surfaces(plan, samples.position)
    gaps = interval_gaps(plan)
    phases = tuple(_phases(plan))
    return CheckReport(
        **dynamics_figures(plan, samples, surfaces),
        **force_figures(plan, samples, surfaces),
        **limit_figures(plan),
        **drive_figures(plan),
        **place_figures(plan, samples, surfaces),
        **impact_figures(plan, surfaces),
        **clearance_figures(plan),
        periodicity_error=periodicity_error(plan),
        quaternion_error=_quaternion_error(given),
        gimbal_margin=gimbal_margin_along(plan.model, plan.t, plan.q, plan.v),
        position_gap=gaps.position,
        velocity_gap=gaps.velocity,
        **{name: largest_known(getattr(phase, name) for phase in phases) for name in PHASE_FIGURES},
        open_loop_joints=max(phase.open_loop_joints for phase in phases),
        phases=phases,
        notes=missing_shapes(plan),
    )


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


def _phases(plan: Solution) -> Iterator[PhaseReport]:
    for phase, error in zip(plan.phases, open_loop(plan), strict=True):
        yield PhaseReport(
            index=int(plan.phase[phase.start]),
            start=float(plan.t[phase.start]),
            end=float(plan.t[phase.stop - 1]),
            contacts=tuple(plan.contact_frames[i] for i in np.flatnonzero(plan.active[phase.start])),
            open_loop_position=error.position,
            open_loop_orientation=error.orientation,
            open_loop_joints=error.joints,
            **flight_errors(plan, phase),
        )
