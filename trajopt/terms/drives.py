"""Constraints and costs on the motor's side of drives: voltage, current, copper losses."""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.arguments import checked
from trajopt.errors import InputError
from trajopt.robot.actuators.drive import Drive
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.interfaces import Cost, PointConstraint, Rows


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

    with tau_m the motor torque of what the drive delivers, friction included, in N m, and omega_m its speed
    in rad/s; for a joint without a drive, with tau on the joint side,

        |tau / torque_limit of the robot| <= 1

    Together with `TorqueLimits` the same row would appear twice. Rows that cannot bind, as judged by `Units`,
    are left out; the check verifies them.
    """

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        robot = context.robot
        driven = dict(_driven_rows(robot))
        parts: list[ca.SX] = []
        for row in range(robot.nu):
            torque = context.torque[row]
            if row in driven:
                rate = context.dxi[robot.n_unactuated + row]
                parts += [
                    ca.dot(context.parameter(factors), ca.vertcat(torque, rate))
                    for factors in _drive_rows(driven[row], units)
                ]
            elif robot.torque_limit is not None and 0 < robot.torque_limit[row] < units.unreachable_torque:
                parts.append(context.parameter(1 / robot.torque_limit[row]) * torque)
        return Rows.create(ca.vertcat(*parts), -1.0, 1.0, 1.0) if parts else None


def _drive_rows(drive: Drive, units: Units) -> list[np.ndarray]:
    """Factors of (torque, rate), joint side, that give voltage and current as fractions of their limits.

    Only for limits that can be reached. Factors are parameters: another voltage needs no new code.
    """
    reach = min(drive.torque_limit, units.unreachable_torque / abs(drive.gear_ratio))
    speed = abs(drive.gear_ratio) * units.unreachable_velocity
    rows = []
    if reach / drive.stall_torque + speed / drive.no_load_speed > 1:
        rows.append(np.array([drive.voltage_use(1.0, 0.0), drive.voltage_use(0.0, 1.0)]))
    # Below its no-load speed a motor on its voltage line has at most twice the stall torque, braking.
    if drive.joint_torque_limit < units.unreachable_torque and drive.torque_limit < 2 * drive.stall_torque:
        rows.append(np.array([drive.motor_torque(1.0) / drive.torque_limit, 0.0]))
    return rows


@checked
@dataclass(frozen=True, kw_only=True)
class MotorTorqueCost(Cost):
    """Cost on motor torques: the share of copper losses.

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
        factors = [drive.motor_torque(1.0) / _largest_motor_torque(drive, units) for _, drive in driven]
        return context.parameter(np.array(factors)) * torque


def _largest_motor_torque(drive: Drive, units: Units) -> float:
    limit = min(drive.torque_limit, drive.stall_torque)
    return limit if math.isfinite(limit) else float(np.abs(units.torque / drive.gear_ratio))
