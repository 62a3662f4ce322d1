"""Dynamics residuals by interval and constraint violations by phase of a solution, between its points.

The violations are those of the check (`certify.dense`), in natural units.
"""

from dataclasses import dataclass

import numpy as np

from trajopt.certify.contact_figures import ContactStarts
from trajopt.certify.dense import DenseMotion, dense_motion, figures_at
from trajopt.motion.configurations import resampled
from trajopt.motion.quantities import MotionQuantities
from trajopt.robot.natural_units import NaturalUnits

# Fractions of an interval at which residuals are evaluated: at least two between points of degree four.
FRACTIONS = np.linspace(0.0, 1.0, 11)

_Figures = dict[str, float | None]


# Figures of the check by the name of the constraint.
VIOLATIONS = {
    "friction": "friction_margin",
    "unilateral": "unilateral_margin",
    "sole": "sole_margin",
    "sliding": "sliding_friction",
    "effort": "effort_excess",
    "drive_torque": "drive_torque_excess",
    "drive_voltage": "drive_voltage_excess",
    "velocity": "velocity_excess",
    "position": "position_excess",
    "penetration": "penetration",
    "link_depth": "link_depth",
    "obstacle": "obstacle_distance",
    "self_collision": "self_distance",
    "patch": "patch_margin",
}
# Violations that are divided by the reach (soles: weight times reach). The others are already over the weight
# (forces), the limit (torques, velocities, drives) or the joint's range (positions).
OVER_REACH = ("sole", "penetration", "link_depth", "obstacle", "self_collision", "patch")


@dataclass(frozen=True, kw_only=True)
class IntervalResiduals:
    """Largest residuals of the interpolated motion in each interval (I,), in natural units; 0 without rows.

    Args:
        base: Base rows of RNEA(q, v, a) - sum J^T f - S^T tau, over m g (rotational rows: m g l).
        actuated: The same for the actuated rows.
        contact: Acceleration of active contacts over g (angular: g / l); with velocity sources, velocity over
            sqrt(g l) (angular: sqrt(g / l)).
    """

    base: np.ndarray
    actuated: np.ndarray
    contact: np.ndarray

    @property
    def worst(self) -> np.ndarray:
        """The largest of the three (I,)."""
        return np.maximum(np.maximum(self.base, self.actuated), self.contact)


@dataclass(frozen=True, kw_only=True)
class BetweenPoints:
    """Residuals by interval; violations (0 if satisfied) and drift of active contacts (m) by phase.

    A violation or drift is None if the phase has no such constraint or contact.
    """

    residuals: IntervalResiduals
    violations: tuple[_Figures, ...]
    foot_drift: tuple[float | None, ...]


def figures_between_points(motion: MotionQuantities) -> BetweenPoints:
    """Return the figures of a motion between its points."""
    starts = ContactStarts.of(motion)
    dense = dense_motion(motion, figures_at(motion, starts), starts)
    units, phases = motion.units, range(len(motion.solution.phases))
    return BetweenPoints(
        residuals=_residuals(MotionQuantities(resampled(motion.solution, FRACTIONS)), units),
        violations=tuple(_violations(dense, phase, units) for phase in phases),
        foot_drift=tuple(_worst(dense, "foot_drift", phase) for phase in phases),
    )


def _residuals(motion: MotionQuantities, units: NaturalUnits) -> IntervalResiduals:
    dense, rows = motion.solution, motion.residuals
    force = units.generalized_force(dense.model)
    free, actuated = force[dense.unactuated_rows], force[dense.actuated_rows]
    turning = np.array([1.0] * 3 + [1.0 / units.length] * 3)
    if motion.moved_by_rates:
        contact = rows.contact / (np.sqrt(units.gravity * units.length) * turning)
    else:
        contact = rows.contact / (units.gravity * turning)
    worst = [
        np.abs(part.reshape(dense.n_intervals, -1)).max(axis=1, initial=0.0)
        for part in (rows.base / free, rows.actuated / actuated, contact)
    ]
    return IntervalResiduals(base=worst[0], actuated=worst[1], contact=worst[2])


def _worst(dense: DenseMotion, figure: str, phase: int) -> float | None:
    worst = dense.traces[figure].at(dense.plan.phase == phase).worst()
    return None if worst is None else worst[0]


def _violations(dense: DenseMotion, phase: int, units: NaturalUnits) -> _Figures:
    violations: _Figures = {}
    for name, figure in VIOLATIONS.items():
        value = _worst(dense, figure, phase)
        sign = -1.0 if dense.traces[figure].margin else 1.0
        unit = units.length if name in OVER_REACH else 1.0
        violations[name] = None if value is None else max(sign * value / unit, 0.0)
    return violations
