"""Limits of joint torques, rates and positions at collocation points (and nodes)."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.arguments import checked
from trajopt.dynamics.base_joint import BASE_ROWS
from trajopt.dynamics.manifold import Coordinates
from trajopt.errors import InputError
from trajopt.kinds import ArrayShape
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.interfaces import PointConstraint, Rows


def _rows_within(
    values: Callable[[], ca.SX], lower: np.ndarray, upper: np.ndarray, unit: np.ndarray
) -> Rows | None:
    """Rows of the ``values`` with a finite limit; the other values are not built."""
    bound = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
    if len(bound) == 0:
        return None
    return Rows.create(values()[bound.tolist()], lower[bound], upper[bound], unit[bound])


@checked
@dataclass(frozen=True, kw_only=True)
class TorqueLimits(PointConstraint):
    """Joint torques within limits.

        |tau_j| <= limit_j,      least_j <= u_j <= limit_j of a thruster

    with tau (nu,) the torques that the drives deliver, joint side. Rows are over m g l. Limits of 30 m g l or
    more cannot bind and have no row; the check verifies them.

    Args:
        limit: (nu,), joint side, N m or N, inf where there is none; default the robot's limits.

    Raises:
        InputError: for limits that are negative or NaN.
    """

    limit: Annotated[np.ndarray, ArrayShape((None,), infinite=True)] | None = None

    def __post_init__(self) -> None:
        given = np.atleast_1d(np.asarray(0.0 if self.limit is None else self.limit, dtype=float))
        if not np.all(given >= 0):
            wrong = given[~(given >= 0)][0]
            raise InputError(f"limit of {self.name} holds {wrong:g}", "allowed: numbers >= 0, or inf, N m")

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        limit = context.robot.torque_limit if self.limit is None else context.actuated(self.limit)
        if limit is None:
            return None
        upper = np.where(limit < units.unreachable_torque, limit, np.inf)
        lower = context.robot.least_torque(upper)
        return _rows_within(lambda: context.torque, lower, upper, np.full(len(upper), units.torque))

    @override
    def limits(self, robot: Robot) -> dict[str, np.ndarray]:
        return {} if self.limit is None else {"effort_limit": np.asarray(self.limit, dtype=float)}


@checked
@dataclass(frozen=True, kw_only=True)
class VelocityLimits(PointConstraint):
    """Joint rates within the robot's limits, at points and nodes.

        |xi_j'| <= velocity_limit_j

    Rows are over sqrt(g l) or sqrt(g / l). Limits of 30 sqrt(g / l) or more cannot bind and have no row; the
    check verifies them.
    """

    def _limits(self, robot: Robot) -> np.ndarray:
        limit = np.where(
            robot.velocity_limit < Units(robot).unreachable_velocity, robot.velocity_limit, np.inf
        )
        limit[: BASE_ROWS[robot.base]] = np.inf
        return limit

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        limit = self._limits(context.robot)
        return _rows_within(lambda: context.dxi, -limit, limit, units.velocity)

    @override
    def node_bounds(self, robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        limit, free = self._limits(robot), np.full(robot.nv, np.inf)
        return -free, free, -limit, limit


@checked
@dataclass(frozen=True, kw_only=True)
class PositionLimits(PointConstraint):
    """Joint positions within the robot's limits, at points and nodes.

        position_lower_j <= q_j <= position_upper_j

    Rows are over l or 1 rad. A limit more than a full turn (2 pi) away from the reference posture is not
    imposed: no useful motion winds a joint that far. The check verifies it all the same.
    """

    def _limits(self, robot: Robot, context: Context) -> tuple[np.ndarray, np.ndarray]:
        lower, upper = np.full(robot.nv, -np.inf), np.full(robot.nv, np.inf)
        for joint in context.coordinates.joints:
            if joint.kind != "plain" or joint.v.start < BASE_ROWS[robot.base]:
                continue
            near_lower = robot.position_lower[joint.q] > robot.reference[joint.q] - 2 * math.pi
            near_upper = robot.position_upper[joint.q] < robot.reference[joint.q] + 2 * math.pi
            lower[joint.v] = np.where(near_lower, robot.position_lower[joint.q], -np.inf)
            upper[joint.v] = np.where(near_upper, robot.position_upper[joint.q], np.inf)
        return lower, upper

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        lower, upper = self._limits(context.robot, context)
        return _rows_within(lambda: context.xi, lower, upper, units.position)

    @override
    def node_bounds(self, robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        lower, upper = self._limits(robot, Context(robot, Coordinates(robot.model), (), node=True))
        free = np.full(robot.nv, np.inf)
        return lower, upper, -free, free
