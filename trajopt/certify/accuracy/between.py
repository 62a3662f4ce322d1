"""Residuals of the dynamics and constraint violations of a solution at any time, by interval and phase.

The violations are those of the check (`certify.dense`), in natural units.
"""

from dataclasses import dataclass

import numpy as np

from trajopt.certify.contact_figures import ContactStarts
from trajopt.certify.dense import DenseMotion, dense_motion, figures_at
from trajopt.motion.quantities import MotionQuantities
from trajopt.motion.resampling import resampled
from trajopt.robot.natural_units import NaturalUnits

# Fractions of an interval for its residuals: between the points of a scheme of degree four lie two at least.
FRACTIONS = np.linspace(0.0, 1.0, 11)

_Figures = dict[str, float | None]


# Figures of the check by the name of the constraint that they violate.
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
# Those over the reach (of soles: weight times reach). Others are over the weight (forces), the limit
# (torques, velocities, drives) and the joint's range (positions), as the figures are.
OVER_REACH = ("sole", "penetration", "link_depth", "obstacle", "self_collision", "patch")


@dataclass(frozen=True, kw_only=True)
class IntervalResiduals:
    """Largest residuals of the interpolated motion in each interval (I,), in natural units.

    base, actuated: RNEA(q, v, a) - sum J^T f - S^T tau over m g (rotational rows: m g l). contact:
    acceleration of active contacts over g (angular: g / l); with velocity sources, velocities over sqrt(g l),
    sqrt(g / l). Zero where there is no such row.
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
    """Residuals by interval; by phase, violations (0 where satisfied) and the drift of active contacts, m.

    A violation or drift is None where the phase has no such constraint or contact.
    """

    residuals: IntervalResiduals
    violations: tuple[_Figures, ...]
    foot_drift: tuple[float | None, ...]


def figures_between_points(motion: MotionQuantities) -> BetweenPoints:
    """Figures of a motion at any time."""
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
