"""Limits at a tick: torques of drives, and accelerations that keep joints within their ranges."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import UNLIMITED, position_limits
from trajopt.motion.description import TORQUE_INPUTS, PlanDescription
from trajopt.robot.actuators.actuation import Actuation, least_inputs
from trajopt.robot.actuators.drive import Drive
from trajopt.robot.robot import Robot


@dataclass(frozen=True, kw_only=True)
class TickLimits:
    """Limits at a tick.

    Args:
        torque: least and largest inputs (nu,), N m or N.
        acceleration: least and largest accelerations of the actuated joints, rad/s^2 or m/s^2.
        friction: friction torques of the drives (nu,), N m.
    """

    torque: tuple[np.ndarray, np.ndarray]
    acceleration: tuple[np.ndarray, np.ndarray]
    friction: np.ndarray


def torque_limits(about: PlanDescription, nu: int) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest inputs (nu,); unlimited if the control inputs are not torques."""
    limit = np.full(nu, np.inf)
    if about.effort_limit is not None and about.actuation in TORQUE_INPUTS:
        limit = _numbers(about.effort_limit)
    return least_inputs(limit, about.thrusters), limit


def limits_with_drives(
    drives: Sequence[Drive | None], rate: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The limits (nu,), where a drive's voltage and current at its rate replace them in rows with a drive."""
    low, high = low.copy(), high.copy()
    for row, drive in enumerate(drives):
        if drive is not None:
            torques = drive.torque_range(float(rate[row]))
            low[row], high[row] = float(torques[0]), float(max(torques[0], torques[1]))
    return low, high


def friction_of_drives(drives: Sequence[Drive | None], rate: np.ndarray) -> np.ndarray:
    """Friction torques (nu,) that drives overcome at rates (nu,), 0 without a drive."""
    return np.array(
        [0.0 if d is None else float(d.friction_torque(r)) for d, r in zip(drives, rate, strict=True)]
    )


class RobotLimits:
    """Limits of a robot's inputs and joints at any state, which keep joints in range for ``horizon`` s.

    At constant acceleration a, q + v T + a T^2 / 2 and v + a T are in range after T. If ``critical``, a joint
    approaches the end of its range like a critically damped spring, a <= (q_max - q) / T^2 - 2 v / T, without
    overshoot. A joint that cannot return in time is braked by at most |v| / T, or 2 |v| / T if ``critical``.

    Args:
        model: model with the position limits.
        actuation: actuation of the robot.
        drives: drive of each input (nu,), None where there is none.
        torque: least and largest inputs (nu,).
        fastest: velocity limits (nv,), None if there are none.
        horizon: T, s.
        critical: whether joints approach the ends of their ranges without overshoot.
    """

    def __init__(
        self,
        model: pin.Model,
        actuation: Actuation,
        drives: Sequence[Drive | None],
        torque: tuple[np.ndarray, np.ndarray],
        fastest: np.ndarray | None,
        horizon: float,
        *,
        critical: bool = False,
    ) -> None:
        self.torque, self._actuation, self._drives = torque, actuation, drives
        self._horizon, rows, size = horizon, actuation.rows, len(actuation.rows)
        self._stiff, self._damped = (1.0, 2.0) if critical else (2.0, 1.0)
        self._index = np.full(size, -1)
        self._low, self._high = np.full(size, -np.inf), np.full(size, np.inf)
        lower, upper = position_limits(model)
        for joint in list(model.joints)[1:]:
            if joint.nq == joint.nv == 1 and joint.idx_v in rows:
                row = np.searchsorted(rows, joint.idx_v)
                self._index[row] = joint.idx_q
                self._low[row] = lower[joint.idx_q]
                self._high[row] = upper[joint.idx_q]
        whole = np.full(model.nv, np.inf) if fastest is None else _numbers(fastest)
        self._fastest = whole[rows]

    @classmethod
    def of(cls, robot: Robot, horizon: float, *, critical: bool = False) -> Self:
        """Limits of a robot."""
        high = np.full(robot.nu, np.inf) if robot.torque_limit is None else robot.torque_limit
        return cls(
            robot.limited_model(),
            robot.actuation,
            robot.drives or (None,) * robot.nu,
            (robot.least_torque(high), high),
            robot.velocity_limit,
            horizon,
            critical=critical,
        )

    def at(self, q: np.ndarray, v: np.ndarray) -> TickLimits:
        """Limits at a state (nq,), (nv,)."""
        rate = self._actuation.rates(v)
        return TickLimits(
            torque=limits_with_drives(self._drives, rate, *self.torque),
            acceleration=self._accelerations(q, rate[: len(self._index)]),
            friction=friction_of_drives(self._drives, rate),
        )

    def _accelerations(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest accelerations of the actuated joints at q (nq,) and their rates v."""
        time, known = self._horizon, self._index >= 0
        low, high = (-self._fastest - v) / time, (self._fastest - v) / time
        ahead = np.where(known, q[np.maximum(self._index, 0)], 0.0) + self._damped * v * time
        low = np.where(known, np.maximum(low, self._stiff * (self._low - ahead) / time**2), low)
        high = np.where(known, np.minimum(high, self._stiff * (self._high - ahead) / time**2), high)
        brake = self._damped * np.abs(v) / time
        high = np.maximum(high, -brake)
        return np.minimum(np.minimum(low, brake), high), high


def _numbers(limit: np.ndarray) -> np.ndarray:
    """The limits, with infinity for those that stand for none."""
    return np.where(limit > UNLIMITED, np.inf, limit)
