"""Residuals of the dynamics and constraint violations of a solution at any time, by interval and phase.

The violations are those of the check (`certify.dense`), in natural units.
"""

from __future__ import annotations

from collections.abc import Callable
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


@dataclass(frozen=True, kw_only=True)
class _Bound:
    """How a constraint's violation follows from a figure of the check: its sign, and its unit."""

    figure: str
    sign: float = 1.0
    unit: Callable[[NaturalUnits], float] = lambda _: 1.0


def _length(units: NaturalUnits) -> float:
    return units.length


# Violations are over the weight (forces), weight times reach (moments of soles), the limit (torques,
# velocities, drives), the joint's range (positions) and the reach (depths, distances).
VIOLATIONS = {
    "friction": _Bound(figure="friction_margin", sign=-1.0),
    "unilateral": _Bound(figure="unilateral_margin", sign=-1.0),
    "sole": _Bound(figure="sole_margin", sign=-1.0, unit=_length),
    "sliding": _Bound(figure="sliding_friction"),
    "effort": _Bound(figure="effort_excess"),
    "drive_torque": _Bound(figure="drive_torque_excess"),
    "drive_voltage": _Bound(figure="drive_voltage_excess"),
    "velocity": _Bound(figure="velocity_excess"),
    "position": _Bound(figure="position_excess"),
    "penetration": _Bound(figure="penetration", unit=_length),
    "link_depth": _Bound(figure="link_depth", unit=_length),
    "obstacle": _Bound(figure="obstacle_distance", sign=-1.0, unit=_length),
    "self_collision": _Bound(figure="self_distance", sign=-1.0, unit=_length),
    "patch": _Bound(figure="patch_margin", sign=-1.0, unit=_length),
}


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
    base = dense.n_unactuated
    turning = np.array([1.0] * 3 + [1.0 / units.length] * 3)
    if motion.moved_by_rates:
        contact = rows.contact / (np.sqrt(units.gravity * units.length) * turning)
    else:
        contact = rows.contact / (units.gravity * turning)
    worst = [
        np.abs(part.reshape(dense.n_intervals, -1)).max(axis=1, initial=0.0)
        for part in (rows.base / force[:base], rows.actuated / force[base:], contact)
    ]
    return IntervalResiduals(base=worst[0], actuated=worst[1], contact=worst[2])


def _worst(dense: DenseMotion, figure: str, phase: int) -> float | None:
    worst = dense.traces[figure].at(dense.plan.phase == phase).worst()
    return None if worst is None else worst[0]


def _violations(dense: DenseMotion, phase: int, units: NaturalUnits) -> _Figures:
    violations: _Figures = {}
    for name, bound in VIOLATIONS.items():
        value = _worst(dense, bound.figure, phase)
        violations[name] = None if value is None else max(bound.sign * value / bound.unit(units), 0.0)
    return violations
