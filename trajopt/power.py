"""What drives draw: mechanical power of the joints, heat in the windings, energy and cost of transport.

A joint's mechanical power is p = tau rate, tau what its drive delivers (with joint friction). Of power that
flows back a part ``recovered`` counts: 1 all of it (a lossless battery), 0 none, and -1 means that braking
costs as much as driving, |p|, as in most figures of cost of transport:

    drawn(p) = (1 + recovered) / 2 p + (1 - recovered) / 2 |p|

Windings heat by R i^2 (three phases in amplitudes: 3/2 R i^2), which a drive's voltage line tells: with
stall torque k_t V / R and no-load speed V / k_e it is tau_m^2 no_load_speed / stall_torque.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pinocchio as pin

from trajopt.actuators.drive import Drive
from trajopt.actuators.on_robot import drive_torque_values
from trajopt.context import Context
from trajopt.errors import InputError
from trajopt.mesh import interval_schemes
from trajopt.model_quantities import gravity_of, mass_of
from trajopt.solution import Solution
from trajopt.term_interfaces import Cost
from trajopt.units import Units

# Width over which |p| is rounded at zero, in natural units of power: a tenth as wide takes Newton's method
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


def _require_recovered(recovered: float) -> None:
    if not -1 <= recovered <= 1:
        raise InputError(f"recovered part of power is {recovered:g}", "allowed: -1 to 1")


@dataclass(frozen=True, kw_only=True)
class PowerCost(Cost):
    """Power that all joints draw over weight times sqrt(g length); integrated it is energy / (weight length).

    ``recovered`` part of the power that flows back, -1 to 1, see `power`; ``smoothing`` > 0 in natural units
    of power, sqrt(p^2 + smoothing^2) - smoothing in place of |p|. Drives with a voltage line add their heat.
    """

    recovered: float = -1.0
    smoothing: float = SMOOTHING

    def __post_init__(self) -> None:
        super().__post_init__()
        _require_recovered(self.recovered)
        if not (math.isfinite(self.smoothing) and self.smoothing > 0):
            raise InputError(f"smoothing of {self.name} is {self.smoothing:g}", "allowed: finite and > 0")

    def residual(self, context: Context, units: Units) -> ca.SX:
        """Power of each joint (nu,), and then the heat of each drive, over the unit of power."""
        drawn = self._drawn(*self._power(context, units))
        heat = self._heat(context, units)
        return drawn if heat is None else ca.vertcat(drawn, heat * context.torque**2)

    def value(self, context: Context, units: Units) -> ca.SX:
        """Weighted sum over the joints: no mean of squares, energies add up.

        Gauss-Newton keeps the curvature of |p| as a function of p, and that of the heat in the torques.
        """
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


def energy(solution: Solution, *, recovered: float = -1.0) -> float:
    """Energy that the drives of a solution draw, J: the integral of `power` by the scheme's quadrature.

    From the file alone: torques, rates and drives at the collocation points. Raises InputError unless
    ``recovered`` is within -1 to 1.
    """
    _require_recovered(recovered)
    entries = solution.meta.get("drives") or []
    drives = tuple(None if entry is None else Drive.from_meta(entry) for entry in entries)
    rates = solution.v[:, solution.n_unactuated :]
    torque = drive_torque_values(drives, solution.tau, rates) if drives else solution.tau
    power = torque * rates
    drawn = (1 + recovered) / 2 * power + (1 - recovered) / 2 * np.abs(power)
    heat = torque**2 * heat_coefficients(drives, solution.tau.shape[1])
    return float(np.dot(_quadrature(solution), (drawn + heat).sum(axis=1)))


def _quadrature(solution: Solution) -> np.ndarray:
    """Weight of every sample (K,), s: zero at those that are no collocation points."""
    weights = np.zeros(solution.n_samples)
    schemes = interval_schemes(solution)
    for rows, (start, end), method in zip(solution.intervals, solution.interval_t, schemes, strict=True):
        weights[[row for row in rows if solution.collocation[row]]] = method.b1 * (end - start)
    return weights


def cost_of_transport(solution: Solution, *, recovered: float = -1.0) -> float:
    """Energy over weight times horizontal way of the centre of mass, dimensionless.

    See `energy`; the way is the straight line from the first sample to the last. Infinite on the spot, and
    for robots that go nowhere: with a fixed base, or without contacts.
    """
    model = solution.model
    if not (solution.n_unactuated and solution.contact_frames):
        return math.inf
    start, end = (pin.centerOfMass(model, model.createData(), solution.q[row]).copy() for row in (0, -1))
    upwards = -model.gravity.linear / (np.linalg.norm(model.gravity.linear) or 1.0)
    way = end - start
    distance = float(np.linalg.norm(way - upwards * (upwards @ way)))
    used = energy(solution, recovered=recovered)
    weight = mass_of(model) * gravity_of(model)
    return used / (weight * distance) if distance > 0 else math.inf
