"""Measure the accuracy of a solution independently: with numeric Pinocchio and the file's arrays alone."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from typing_extensions import override

from trajopt.certify.accuracy.between import BetweenPoints, figures_between_points
from trajopt.certify.accuracy.comparison import Comparison, compare
from trajopt.certify.accuracy.open_loop import OpenLoopDrift, interval_drifts, motion_drift, phase_drifts
from trajopt.certify.figures import FigureReport, figure
from trajopt.motion.input import SolutionOrFile, consistent_solution
from trajopt.motion.quantities import MotionQuantities
from trajopt.motion.samples import largest_known


@dataclass(frozen=True, kw_only=True)
class PhaseAccuracy:
    """Accuracy of one phase; names and units as in `Accuracy`.

    ``motion`` is the drift within this phase if the whole motion is integrated at once; ``distance`` (m) is
    from the reference, None without one.
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

    def __str__(self) -> str:
        parts = [
            f"open loop {self.open_loop.position:.1e} m",
            f"in the whole motion {self.motion.position:.1e} m",
            f"local {self.interval_error:.1e} m",
            f"rows between {self.collocation_error:.1e}",
        ]
        if self.distance is not None:
            parts.append(f"from the reference {self.distance:.1e} m")
        return f"phase '{self.name}' ({self.start:.3f} to {self.end:.3f} s): {', '.join(parts)}"


@dataclass(frozen=True, kw_only=True)
class Accuracy(FigureReport):
    """Accuracy of a solution.

    Attributes:
        open_loop: Position error of the worst phase, m, each integrated from its planned start with the
            planned torques: of the base, or with a fixed base of the farthest-off named point. Its variants
            are ``_orientation`` (base, rad), ``_joints`` (rad or m) and ``_farthest`` (named point, m). inf
            if a motion diverges.
        open_loop_motion: The same for the whole motion in one integration, through its impacts.
        interval_errors: Local errors (I,), m, see `open_loop.interval_drifts`.
        collocation_errors: Largest residual (I,) of the interpolated motion in dynamics and contacts in each
            interval, natural units (weight, weight times reach, g).
        base_error, actuated_error, contact_error: Its maximum by kind of row.
        position_gap: q against the integral of v, m or rad, see `motion.integration_gaps.interval_gaps`.
        velocity_gap: v against the integral of a, m/s or rad/s.
        foot_drift: Drift of active contacts since the start of their phase, m; None without contacts.
        violations: Violations by name (`between.VIOLATIONS`), natural units: 0 if the constraint also holds
            between the points, None without such a constraint.
        comparison: Comparison with a reference, or None.
    """

    DERIVED: ClassVar[tuple[str, ...]] = (
        *("interval_error", "collocation_error", "violation_between", "objective_gap", "distance"),
    )
    FORM: ClassVar[tuple[int, str, str]] = (46, ".3e", ".0e")

    open_loop: float = figure("open loop by phase, position", "m")
    open_loop_orientation: float | None = figure("open loop by phase, base orientation", "rad")
    open_loop_joints: float = figure("open loop by phase, joints", "rad, m")
    open_loop_farthest: float = figure("open loop by phase, farthest-off point", "m")
    open_loop_motion: float = figure("open loop, whole motion, position", "m")
    open_loop_motion_orientation: float | None = figure("open loop, whole motion, base orientation", "rad")
    open_loop_motion_joints: float = figure("open loop, whole motion, joints", "rad, m")
    open_loop_motion_farthest: float = figure("open loop, whole motion, farthest-off point", "m")
    interval_errors: np.ndarray = figure("local error of one interval", "m")
    collocation_errors: np.ndarray
    base_error: float = figure("base rows of the dynamics between points", "weight, reach")
    actuated_error: float = figure("actuated rows of the dynamics between points", "weight, reach")
    contact_error: float = figure("acceleration of contacts between points", "g, reach")
    position_gap: float
    velocity_gap: float
    foot_drift: float | None = figure("drift of active contacts between points", "m")
    violations: dict[str, float | None] = figure("violation between points", "natural")
    phases: tuple[PhaseAccuracy, ...]
    comparison: Comparison | None = figure("")

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
        """Signed relative difference of the objective from the reference's; None without a reference."""
        return None if self.comparison is None else self.comparison.objective_gap

    @property
    def distance(self) -> float | None:
        """Largest distance of the motion from the reference's, m; None without a reference."""
        return None if self.comparison is None else self.comparison.distance

    @override
    def table(self) -> str:
        """Figures with units, and the phases."""
        worst = f"interval {int(np.argmax(self.interval_errors))} of {len(self.interval_errors)}"
        lines = [super().table(), f"{worst} has the largest local error"]
        return "\n".join([*lines, *map(str, self.phases)])


def measure(solution: SolutionOrFile, reference: SolutionOrFile | None = None) -> Accuracy:
    """Measure the accuracy of a solution without the NLP, and compare it with a reference.

    Args:
        solution: The solution, or the path of its file.
        reference: Converged solution of the same problem, or the path of its file.

    Raises:
        SolutionFileError: For a file that is inconsistent or not finite.
        InputError: For such a solution, and for a reference with another robot, actuation or phases.
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
    """Return the local error (I,) in m of each interval from its own planned start, see `interval_drifts`.

    Raises as `measure` does.
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
