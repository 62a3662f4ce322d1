"""Residuals of the dynamics and constraint violations of a solution between its collocation points.

Every figure is the check's, evaluated on the interpolated motion (`solution.interpolation`) at
``FRACTIONS`` of every interval, its ends among them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trajopt.certify.accuracy.natural_units import NaturalUnits
from trajopt.certify.contact_figures import force_figures, place_figures
from trajopt.certify.dynamics_figures import DynamicsRows, dynamics_rows
from trajopt.certify.limit_figures import drive_figures, limit_figures
from trajopt.certify.samples import SampleQuantities, sample_quantities
from trajopt.solution.arrays import SAMPLED, rows_of
from trajopt.solution.clearance import distance_figures
from trajopt.solution.interpolation import resampled
from trajopt.solution.solution import Solution
from trajopt.solution.touched import TouchedSurfaces, touched_surfaces

# Eleven per interval: between the points of a scheme of degree four lie at least two of them.
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


def figures_between_points(plan: Solution) -> BetweenPoints:
    """Figures of a plan whose rotations are of unit norm, at ``FRACTIONS`` of its intervals."""
    dense = resampled(plan, FRACTIONS)
    samples = sample_quantities(dense)
    surfaces = touched_surfaces(dense, samples.position)
    units = NaturalUnits.of(plan.model)
    phases = [slice(rows.start, rows.stop) for rows in dense.phases]
    parts = [_part(dense, samples, surfaces, rows) for rows in phases]
    found = [_violations(part, units) for part in parts]
    return BetweenPoints(
        residuals=_residuals(dense, dynamics_rows(dense, samples, surfaces), units),
        violations=tuple(violations for violations, _ in found),
        foot_drift=tuple(drift for _, drift in found),
    )


def _residuals(dense: Solution, rows: DynamicsRows, units: NaturalUnits) -> IntervalResiduals:
    force = units.generalized_force(dense.model)
    base = dense.n_unactuated
    turning = np.array([1.0] * 3 + [1.0 / units.length] * 3)
    if dense.meta.get("actuation") == "velocity":
        contact = rows.contact / (np.sqrt(units.gravity * units.length) * turning)
    else:
        contact = rows.contact / (units.gravity * turning)
    worst = [
        np.abs(part.reshape(dense.n_intervals, -1)).max(axis=1, initial=0.0)
        for part in (rows.base / force[:base], rows.actuated / force[base:], contact)
    ]
    return IntervalResiduals(base=worst[0], actuated=worst[1], contact=worst[2])


def _part(
    dense: Solution, samples: SampleQuantities, surfaces: TouchedSurfaces, rows: slice
) -> tuple[Solution, SampleQuantities, TouchedSurfaces]:
    """The samples of one phase."""
    plan = dense.with_arrays(**{name: getattr(dense, name)[rows] for name in SAMPLED})
    return plan, rows_of(samples, rows), rows_of(surfaces, rows)


def _violations(
    part: tuple[Solution, SampleQuantities, TouchedSurfaces], units: NaturalUnits
) -> tuple[_Figures, float | None]:
    plan, samples, surfaces = part
    places = place_figures(plan, samples, surfaces)
    figures = {
        **force_figures(plan, samples, surfaces),
        **limit_figures(plan),
        **drive_figures(plan),
        **places,
        **distance_figures(plan, plan.q),
    }
    found: _Figures = {}
    for name, bound in VIOLATIONS.items():
        value = figures[bound.figure]
        found[name] = None if value is None else max(bound.sign * value / bound.unit(units), 0.0)
    return found, places["foot_drift"]
