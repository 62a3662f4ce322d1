"""Power drawn by drives: mechanical power of the joints, heat in the windings, energy and cost of transport.

The mechanical power of a joint is p = tau rate, where tau is what its drive delivers (with joint friction). A
fraction ``recovered`` of the power that flows back counts: 1 all of it (a lossless battery), 0 none, and -1
means that braking costs as much as driving, |p|, as in most figures of cost of transport:

    drawn(p) = (1 + recovered) / 2 p + (1 - recovered) / 2 |p|

Windings heat by R i^2 (three phases in amplitudes: 3/2 R i^2). In terms of a drive's voltage line, with stall
torque k_t V / R and no-load speed V / k_e, this is tau_m^2 no_load_speed / stall_torque.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.arguments import checked
from trajopt.errors import InputError, require_positive
from trajopt.robot.actuators.drive import Drive
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.interfaces import Cost

# Width over which |p| is rounded at zero, in natural units of power: with a tenth of it Newton's method needs
# three times the iterations for a cost of transport 3 % lower (docs/modelling/objectives.md). The rounded |p|
# is too small by at most this.
SMOOTHING = 0.1


def heat_coefficients(drives: Sequence[Drive | None] | None, nu: int) -> np.ndarray:
    """Heat per squared torque (nu,), W / (N m)^2, joint side; zero without a voltage line."""
    return np.array([0.0 if drive is None else _heat(drive) for drive in drives or (None,) * nu])


def _heat(drive: Drive) -> float:
    if not math.isfinite(drive.stall_torque):
        return 0.0
    return drive.no_load_speed / drive.stall_torque / drive.gear_ratio**2


def require_recovered(recovered: float) -> None:
    """Raise `InputError` for a recovered fraction of power outside -1 to 1."""
    if not -1 <= recovered <= 1:
        raise InputError(f"recovered part of power is {recovered:g}", "allowed: -1 to 1")


@checked
@dataclass(frozen=True, kw_only=True)
class PowerCost(Cost):
    """Cost on the power that all joints draw; integrated, energy over m g l.

        w sum_j ((1 + r) / 2 p_j + (1 - r) / 2 (sqrt(p_j^2 + s^2) - s) + h_j tau_j^2)

    with the mechanical power p_j = tau_j xi_j' of each joint and the heat h_j tau_j^2 of a drive with a
    voltage line, both over m g sqrt(g l), r = ``recovered`` and s = ``smoothing``. Powers are added, without
    a mean of squares: energies add up. Gauss-Newton keeps the curvature of |p| as a function of p, and that
    of the heat in the torques.

    Args:
        weight: w, dimensionless.
        recovered: fraction of the power that flows back, -1 to 1, see this module.
        smoothing: > 0 in natural units of power: sqrt(p^2 + smoothing^2) - smoothing replaces |p|.

    Raises:
        InputError: for numbers out of range.
    """

    recovered: float = -1.0
    smoothing: float = SMOOTHING

    def __post_init__(self) -> None:
        super().__post_init__()
        require_recovered(self.recovered)
        require_positive(f"smoothing of {self.name}", self.smoothing)

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        drawn = self._drawn(*self._power(context, units))
        heat = self._heat(context, units)
        return drawn if heat is None else ca.vertcat(drawn, heat * context.torque**2)

    @override
    def value(self, context: Context, units: Units) -> ca.SX:
        weight = context.parameter(self.weight)
        power, rounded = self._power(context, units)
        bend = (1 - self.recovered) / 2 * self.smoothing**2 / rounded**3
        context.square(power, weight * bend / 2)
        drawn, heat = self._drawn(power, rounded), self._heat(context, units)
        if heat is None:
            return weight * ca.sum1(drawn)
        context.square(context.torque, weight * heat)
        return weight * (ca.sum1(drawn) + ca.dot(heat, context.torque**2))

    def _power(self, context: Context, units: Units) -> tuple[ca.SX, ca.SX]:
        """Power p of each joint over its unit, and sqrt(p^2 + smoothing^2)."""
        power = context.torque * context.v[context.robot.n_unactuated :] * (units.time / units.torque)
        return power, ca.sqrt(power**2 + self.smoothing**2)

    def _drawn(self, power: ca.SX, rounded: ca.SX) -> ca.SX:
        return (1 + self.recovered) / 2 * power + (1 - self.recovered) / 2 * (rounded - self.smoothing)

    def _heat(self, context: Context, units: Units) -> ca.SX | None:
        """Heat over squared torque of each drive, in the unit of power, or None."""
        heat = heat_coefficients(context.robot.drives, context.robot.nu)
        return context.parameter(heat) * (units.time / units.torque) if heat.any() else None
