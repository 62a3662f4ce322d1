"""Constraints and costs on drives: voltage, current and copper losses of the motor, and the power drawn.

The mechanical power of a joint is p = tau rate, where tau is what its drive delivers (with joint friction).
The fraction ``recovered`` of the power that flows back is regained: 1 for all of it (a lossless battery), 0
for none; -1 makes braking cost as much as driving, |p|, as in most figures for the cost of transport:

    drawn(p) = (1 + recovered) / 2 p + (1 - recovered) / 2 |p|

Windings heat by R i^2 (three phases in amplitudes: 3/2 R i^2). In terms of a drive's voltage line, with stall
torque k_t V / R and no-load speed V / k_e, this is tau_m^2 no_load_speed / stall_torque.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.arguments import Positive, SignedFraction, checked
from trajopt.errors import InputError
from trajopt.robot.actuators.drive import Drive
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.interfaces import Cost, PointConstraint, Rows

# Width over which |p| is rounded at zero, in natural units of power. With a tenth of it, Newton's method
# needs three times the iterations for a cost of transport 3 % lower (docs/modelling/objectives.md). The
# rounded |p| is too small by at most this width.
SMOOTHING = 0.1


def _driven_rows(robot: Robot) -> list[tuple[int, Drive]]:
    """Actuated rows that have a drive; raises `InputError` where there is none."""
    rows = [(row, drive) for row, drive in enumerate(robot.drives or ()) if drive is not None]
    if not rows:
        raise InputError(
            f"a term asks for drives, and robot '{robot.name}' has none", "allowed: Robot.with_drives"
        )
    return rows


@checked
@dataclass(frozen=True, kw_only=True)
class DriveLimits(PointConstraint):
    """Voltage and current of every drive stay within their limits; replaces `TorqueLimits`.

    For a joint with a drive, on the motor side,

        |tau_m / stall_torque + omega_m / no_load_speed| <= 1        |tau_m / torque_limit| <= 1

    with tau_m the motor torque in N m for what the drive delivers, friction included, and omega_m its speed
    in rad/s; for a joint without a drive, with tau on the joint side,

        |tau / torque_limit of the robot| <= 1

    Together with `TorqueLimits`, the same row would appear twice. Rows that `Units` judges out of reach are
    left out; the check verifies them.
    """

    checked_by_file: ClassVar[bool] = True

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        robot = context.robot
        driven = dict(_driven_rows(robot))
        parts: list[ca.SX] = []
        for row in range(robot.nu):
            torque = context.torque[row]
            if row in driven:
                rate = context.input_rates[row]
                parts += [
                    ca.dot(context.parameter(factors), ca.vertcat(torque, rate))
                    for factors in _drive_rows(driven[row], units)
                ]
            elif robot.torque_limit is not None and 0 < robot.torque_limit[row] < units.unreachable_torque:
                parts.append(context.parameter(1 / robot.torque_limit[row]) * torque)
        return Rows.create(ca.vertcat(*parts), -1.0, 1.0, 1.0) if parts else None


def _drive_rows(drive: Drive, units: Units) -> list[np.ndarray]:
    """Factors of (torque, rate), joint side, that give voltage and current as fractions of their limits.

    Limits out of reach have none. The factors are parameters, so that another voltage needs no new code.
    """
    reach = min(drive.torque_limit, units.unreachable_torque / abs(drive.gear_ratio))
    speed = abs(drive.gear_ratio) * units.unreachable_velocity
    rows = []
    if reach / drive.stall_torque + speed / drive.no_load_speed > 1:
        rows.append(np.array([drive.voltage_use(1.0, 0.0), drive.voltage_use(0.0, 1.0)]))
    # Below its no-load speed, a motor on its voltage line has at most twice the stall torque, when braking.
    if drive.joint_torque_limit < units.unreachable_torque and drive.torque_limit < 2 * drive.stall_torque:
        rows.append(np.array([drive.motor_torque(1.0) / drive.torque_limit, 0.0]))
    return rows


@checked
@dataclass(frozen=True, kw_only=True)
class MotorTorqueCost(Cost):
    """Cost on motor torques, as fractions of the copper losses at the limit.

        w |tau_m / tau_0|^2 / n

    over the n joints with a drive, with tau_m the motor torque and tau_0 the lesser of its torque limit and
    its stall torque, N m. A motor with neither limit has tau_0 = m g l / |gear ratio|. The losses of a motor
    are R (tau_m / k_t)^2, so the mean square is the mean fraction of the losses at the limit.

    Args:
        weight: w, dimensionless.
    """

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        driven = _driven_rows(context.robot)
        torque = ca.vertcat(*[context.torque[row] for row, _ in driven])
        factors = []
        for _, drive in driven:
            limit = min(drive.torque_limit, drive.stall_torque)
            largest = limit if math.isfinite(limit) else float(np.abs(units.torque / drive.gear_ratio))
            factors.append(drive.motor_torque(1.0) / largest)
        return context.parameter(np.array(factors)) * torque


def heat_coefficients(drives: Sequence[Drive | None] | None, nu: int) -> np.ndarray:
    """Heat per squared torque (nu,), W / (N m)^2, joint side; zero without a voltage line."""
    heat = np.zeros(nu)
    for row, drive in enumerate(drives or ()):
        if drive is not None and math.isfinite(drive.stall_torque):
            heat[row] = drive.no_load_speed / drive.stall_torque / drive.gear_ratio**2
    return heat


@checked
@dataclass(frozen=True, kw_only=True)
class PowerCost(Cost):
    """Cost on the power that all joints draw; integrated, energy over m g l.

        w sum_j ((1 + r) / 2 p_j + (1 - r) / 2 (sqrt(p_j^2 + s^2) - s) + h_j tau_j^2)

    with the mechanical power p_j = tau_j xi_j' of each joint and the heat h_j tau_j^2 of a drive with a
    voltage line, both over m g sqrt(g l), r = ``recovered`` and s = ``smoothing``. Powers are summed, not
    averaged as squares, because energies add up. Gauss-Newton keeps the curvature of |p| as a function of p,
    and that of the heat in the torques.

    Args:
        weight: w, dimensionless.
        recovered: fraction of the power that flows back, -1 to 1, see this module.
        smoothing: > 0 in natural units of power: sqrt(p^2 + smoothing^2) - smoothing replaces |p|.

    Raises:
        InputError: for numbers out of range.
    """

    recovered: SignedFraction = -1.0
    smoothing: Positive = SMOOTHING

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
        power = context.torque * context.input_rates * (units.time / units.torque)
        return power, ca.sqrt(power**2 + self.smoothing**2)

    def _drawn(self, power: ca.SX, rounded: ca.SX) -> ca.SX:
        return (1 + self.recovered) / 2 * power + (1 - self.recovered) / 2 * (rounded - self.smoothing)

    def _heat(self, context: Context, units: Units) -> ca.SX | None:
        """Heat over squared torque of each drive, in the unit of power, or None."""
        heat = heat_coefficients(context.robot.drives, context.robot.nu)
        return context.parameter(heat) * (units.time / units.torque) if heat.any() else None
