"""The accuracy of a solution, by independent means: numeric Pinocchio and the file's arrays alone."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from trajopt.certify.accuracy.between import BetweenPoints, figures_between_points
from trajopt.certify.accuracy.comparison import Comparison, compare
from trajopt.certify.accuracy.open_loop import OpenLoopDrift, interval_drifts, motion_drift, phase_drifts
from trajopt.motion.quantities import MotionQuantities
from trajopt.motion.samples import largest_known
from trajopt.solution.input import SolutionOrFile, consistent_solution
from trajopt.solution.meta import jsonable


@dataclass(frozen=True, kw_only=True)
class PhaseAccuracy:
    """Accuracy of one phase; names and units as in `Accuracy`.

    ``motion`` is the drift within this phase of the whole motion in one integration; ``distance`` m is from
    the reference, None without one.
    """

    name: str
    start: float
    end: float
    open_loop: OpenLoopDrift
    motion: OpenLoopDrift
    interval_error: float
    collocation_error: float
    violation: float
    foot_drift: float | None
    distance: float | None


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """How accurate a solution is.

    open_loop: m, worst phase, each integrated from its planned start with the planned torques;
        ``..._orientation`` rad and ``..._joints`` rad or m of the same integrations. Positions are of the
        base, with a fixed base of the farthest-off point that the model names; ``..._farthest`` m is of that
        point for every robot. inf where a motion diverged.
    open_loop_motion: m, the whole motion in one integration, through its impacts.
    interval_error: m, largest of ``interval_errors``, the local errors (I,), see `open_loop.interval_drifts`.
    collocation_error: largest residual of the interpolated motion in dynamics and contacts between points,
    natural units (weight, weight times reach, g), ``base_error``, ``actuated_error`` and
        ``contact_error`` its kinds, ``collocation_errors`` (I,) by interval. position_gap (m, rad) and
        velocity_gap (m/s, rad/s): q against the integral of v, v against that of a, see
        `motion.integration_gaps.interval_gaps`.
    foot_drift: m, of active contacts from where they are at their phase's start; None without contacts.
    violation_between: largest of ``violations``, by name in natural units (`between.VIOLATIONS`): 0 where the
        constraint holds between the points too, None without such a constraint.
    comparison: against a reference, or None.
    """

    open_loop: float
    open_loop_orientation: float | None
    open_loop_joints: float
    open_loop_farthest: float
    open_loop_motion: float
    open_loop_motion_orientation: float | None
    open_loop_motion_joints: float
    open_loop_motion_farthest: float
    interval_errors: np.ndarray
    collocation_errors: np.ndarray
    base_error: float
    actuated_error: float
    contact_error: float
    position_gap: float
    velocity_gap: float
    foot_drift: float | None
    violations: dict[str, float | None]
    phases: tuple[PhaseAccuracy, ...]
    comparison: Comparison | None = None

    @property
    def interval_error(self) -> float:
        """Largest local error of an interval, m."""
        return float(self.interval_errors.max())

    @property
    def collocation_error(self) -> float:
        """Largest residual between points, natural units."""
        return float(self.collocation_errors.max())

    @property
    def violation_between(self) -> float:
        """Largest violation between points, natural units."""
        return max((value for value in self.violations.values() if value is not None), default=0.0)

    @property
    def objective_gap(self) -> float | None:
        """Relative difference of the objective from the reference's, signed; None without a reference."""
        return None if self.comparison is None else self.comparison.objective_gap

    @property
    def distance(self) -> float | None:
        """Largest distance of the motion from the reference's, m; None without a reference."""
        return None if self.comparison is None else self.comparison.distance

    def to_dict(self) -> dict[str, Any]:
        """JSON-able figures by name, with lists by interval and by phase; inf and NaN become None."""
        derived = ("interval_error", "collocation_error", "violation_between", "objective_gap", "distance")
        return jsonable({name: getattr(self, name) for name in derived} | asdict(self))


def measure(solution: SolutionOrFile, reference: SolutionOrFile | None = None) -> Accuracy:
    """Measure the accuracy of a solution without the NLP, and compare it with a reference.

    Args:
        solution: the solution, or the path of its file.
        reference: a converged solution of the same problem, or the path of its file.

    Raises:
        SolutionFileError: for a file that is inconsistent or not finite.
        InputError: for such a solution, and for a reference of another robot or of other phases.
    """
    motion = MotionQuantities.normalized(consistent_solution(solution))
    comparison = None
    if reference is not None:
        comparison = compare(motion.solution, consistent_solution(reference).normalized())
    local, dense = interval_drifts(motion), figures_between_points(motion)
    phases = _phases(motion, local, dense, comparison)
    return Accuracy(
        **_worst("open_loop", [phase.open_loop for phase in phases]),
        **_worst("open_loop_motion", [phase.motion for phase in phases]),
        interval_errors=local,
        collocation_errors=dense.residuals.worst,
        base_error=float(dense.residuals.base.max()),
        actuated_error=float(dense.residuals.actuated.max()),
        contact_error=float(dense.residuals.contact.max()),
        position_gap=motion.integration_gaps.position,
        velocity_gap=motion.integration_gaps.velocity,
        foot_drift=largest_known(phase.foot_drift for phase in phases),
        violations={
            name: largest_known(of_phase[name] for of_phase in dense.violations)
            for name in dense.violations[0]
        },
        phases=phases,
        comparison=comparison,
    )


def interval_errors(solution: SolutionOrFile) -> np.ndarray:
    """Local error (I,) in m that each interval makes from its own planned start, see `interval_drifts`.

    Raises as `measure`.
    """
    return interval_drifts(MotionQuantities.normalized(consistent_solution(solution)))


def _phases(
    motion: MotionQuantities, local: np.ndarray, dense: BetweenPoints, comparison: Comparison | None
) -> tuple[PhaseAccuracy, ...]:
    plan = motion.solution
    alone, through = phase_drifts(motion), motion_drift(motion)
    phases = []
    for number, rows in enumerate(plan.phases):
        numbers = plan.intervals_of(number)
        inside = slice(numbers.start, numbers.stop)
        violations = [value for value in dense.violations[number].values() if value is not None]
        phases.append(
            PhaseAccuracy(
                name=plan.phase_names[number],
                start=float(plan.t[rows.start]),
                end=float(plan.t[rows.stop - 1]),
                open_loop=alone[number],
                motion=through[number],
                interval_error=float(local[inside].max()),
                collocation_error=float(dense.residuals.worst[inside].max()),
                violation=max(violations, default=0.0),
                foot_drift=dense.foot_drift[number],
                distance=None if comparison is None else comparison.by_phase[number],
            )
        )
    return tuple(phases)


def _worst(name: str, drifts: list[OpenLoopDrift]) -> dict[str, Any]:
    return {
        name: max(drift.position for drift in drifts),
        f"{name}_orientation": largest_known(drift.orientation for drift in drifts),
        f"{name}_joints": max(drift.joints for drift in drifts),
        f"{name}_farthest": max(drift.farthest for drift in drifts),
    }
