"""Limits at a tick: torques of drives, and accelerations that keep joints within their ranges."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import UNLIMITED, position_limits
from trajopt.robot.actuators.actuation import least_inputs
from trajopt.robot.actuators.drive import Drive
from trajopt.solution.description import PlanDescription


def torque_limits(about: PlanDescription, nu: int) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest inputs (nu,); unlimited if the control inputs are not torques."""
    limit = np.full(nu, np.inf)
    if about.effort_limit is not None and about.actuation == "torque":
        limit = _numbers(about.effort_limit)
    return least_inputs(limit, about.thrusters), limit


def limits_with_drives(
    drives: tuple[Drive | None, ...], rate: np.ndarray, low: np.ndarray, high: np.ndarray
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


class JointRange:
    """Bounds on accelerations of actuated joints that keep positions and rates in range for ``horizon`` s.

    At constant acceleration a, q + v T + a T^2 / 2 and v + a T are in range after T. If ``critical``, a joint
    approaches the end of its range like a critically damped spring, a <= (q_max - q) / T^2 - 2 v / T, without
    overshoot. A joint that cannot return in time is braked by at most |v| / T, or 2 |v| / T if ``critical``.
    """

    def __init__(
        self,
        model: pin.Model,
        actuated: np.ndarray,
        fastest: np.ndarray | None,
        horizon: float,
        *,
        critical: bool = False,
    ) -> None:
        self.horizon, size = horizon, len(actuated)
        self.stiff, self.damped = (1.0, 2.0) if critical else (2.0, 1.0)
        self.index = np.full(size, -1)
        self.low, self.high = np.full(size, -np.inf), np.full(size, np.inf)
        lower, upper = position_limits(model)
        for joint in list(model.joints)[1:]:
            if joint.nq == joint.nv == 1 and joint.idx_v in actuated:
                row = np.searchsorted(actuated, joint.idx_v)
                self.index[row] = joint.idx_q
                self.low[row] = lower[joint.idx_q]
                self.high[row] = upper[joint.idx_q]
        whole = np.full(model.nv, np.inf) if fastest is None else _numbers(fastest)
        self.fastest = whole[actuated]

    def bounds(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest accelerations of the actuated joints at q (nq,) and their rates v."""
        time, known = self.horizon, self.index >= 0
        low, high = (-self.fastest - v) / time, (self.fastest - v) / time
        ahead = np.where(known, q[np.maximum(self.index, 0)], 0.0) + self.damped * v * time
        low = np.where(known, np.maximum(low, self.stiff * (self.low - ahead) / time**2), low)
        high = np.where(known, np.minimum(high, self.stiff * (self.high - ahead) / time**2), high)
        brake = self.damped * np.abs(v) / time
        high = np.maximum(high, -brake)
        return np.minimum(np.minimum(low, brake), high), high


def _numbers(limit: np.ndarray) -> np.ndarray:
    """The limits, with infinity for those that stand for none."""
    return np.where(limit > UNLIMITED, np.inf, limit)
