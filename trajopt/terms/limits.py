"""Limits of joint torques, rates and positions at collocation points (and nodes)."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.arguments import checked
from trajopt.dynamics.base_joint import BASE_ROWS
from trajopt.dynamics.manifold import Coordinates
from trajopt.errors import InputError
from trajopt.kinds import ArrayShape
from trajopt.robot.actuators.joint_limits import HigherLimit
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.schedule.schedule import Schedule
from trajopt.terms.context import Context
from trajopt.terms.interfaces import NodeConstraint, NodePlace, PointConstraint, Rows, Term

# Share of a limit of torque rates that is left for the times between points: what the verdict allows there.
BETWEEN = 1e-2


def _rows_within(
    values: Callable[[], ca.SX], lower: np.ndarray, upper: np.ndarray, unit: np.ndarray
) -> Rows | None:
    """Rows of the ``values`` with a finite limit; without any limit the values are not built."""
    bound = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
    if len(bound) == 0:
        return None
    return Rows.create(values()[bound.tolist()], lower[bound], upper[bound], unit[bound])


@checked
@dataclass(frozen=True, kw_only=True)
class TorqueLimits(PointConstraint):
    """Joint torques within limits.

        |tau_j| <= limit_j,      for a thruster:  least_j <= u_j <= limit_j

    with tau (nu,) the torques that the drives deliver, joint side. Rows are over m g l. Limits of 30 m g l or
    more are out of reach and have no row, unless ``far``: see `with_far_limits`.

    Args:
        limit: (nu,), joint side, N m or N, inf where there is none; default the robot's limits.
        far: whether limits that seem out of reach have rows, too.

    Raises:
        InputError: for limits that are negative or NaN.
    """

    checked_by_file: ClassVar[bool] = True

    limit: Annotated[np.ndarray, ArrayShape((None,), infinite=True)] | None = None
    far: bool = False

    def __post_init__(self) -> None:
        _require_limits(self.name, self.limit, "N m")

    def left_out(self, robot: Robot) -> np.ndarray:
        """Mask (nu,) of the limits that have no row because they seem out of reach."""
        limit = robot.torque_limit if self.limit is None else np.asarray(self.limit)
        return np.zeros(0, dtype=bool) if limit is None else self._far(limit, Units(robot))

    def _far(self, limit: np.ndarray, units: Units) -> np.ndarray:
        return np.isfinite(limit) & (limit >= units.unreachable_torque) & (not self.far)

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        limit = context.robot.torque_limit if self.limit is None else context.actuated(self.limit)
        if limit is None:
            return None
        upper = np.where(self._far(limit, units), np.inf, limit)
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

    Rows are over sqrt(g l) or sqrt(g / l). Limits of 30 sqrt(g / l) or more are out of reach and have no row,
    unless ``far``: see `with_far_limits`.

    Args:
        far: whether limits that seem out of reach have rows, too.
    """

    checked_by_file: ClassVar[bool] = True

    far: bool = False

    def left_out(self, robot: Robot) -> np.ndarray:
        """Mask (nv,) of the limits that have no row because they seem out of reach."""
        limit = robot.velocity_limit
        far = np.isfinite(limit) & (limit >= Units(robot).unreachable_velocity) & (not self.far)
        far[: BASE_ROWS[robot.base]] = False
        return far

    def _limits(self, robot: Robot) -> np.ndarray:
        limit = np.where(self.left_out(robot), np.inf, robot.velocity_limit)
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

    Rows are over l or 1 rad. A limit more than a full turn (2 pi) away from the reference posture is out of
    reach and has no row, unless ``far``: see `with_far_limits`.

    Args:
        far: whether limits that seem out of reach have rows, too.
    """

    checked_by_file: ClassVar[bool] = True

    far: bool = False

    def left_out(self, robot: Robot) -> np.ndarray:
        """Mask (2, nq) of the lower and upper limits that have no row because they seem out of reach."""
        limits = np.array([robot.position_lower, robot.position_upper])
        away = np.array([robot.reference - limits[0], limits[1] - robot.reference])
        return np.isfinite(limits) & (away >= 2 * math.pi) & (not self.far)

    def _limits(self, robot: Robot, context: Context) -> tuple[np.ndarray, np.ndarray]:
        low, high = np.where(
            self.left_out(robot), [[-np.inf], [np.inf]], [robot.position_lower, robot.position_upper]
        )
        lower, upper = np.full(robot.nv, -np.inf), np.full(robot.nv, np.inf)
        for joint in context.coordinates.joints:
            if joint.kind != "plain" or joint.v.start < BASE_ROWS[robot.base]:
                continue
            lower[joint.v], upper[joint.v] = low[joint.q], high[joint.q]
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


@checked
@dataclass(frozen=True, kw_only=True)
class HigherLimits(PointConstraint, ABC):
    """Derivatives of joint motions or torques within limits, those given or else `Robot.joint_limits`."""

    kind: ClassVar[HigherLimit]
    unit: ClassVar[str]
    share: ClassVar[float] = 1.0

    limit: Annotated[np.ndarray, ArrayShape((None,), infinite=True)] | None = None

    def __post_init__(self) -> None:
        _require_limits(self.name, self.limit, self.unit, least=np.nextafter(0, 1))

    @abstractmethod
    def quantity(self, context: Context) -> ca.SX:
        """What is limited (nv,)."""

    def _limits(self, robot: Robot) -> np.ndarray:
        limit = robot.joint_limit(self.kind) if self.limit is None else np.array(self.limit, dtype=float)
        if limit.shape != (robot.nv,):
            raise InputError(f"limit of {self.name} has shape {limit.shape}", f"allowed: ({robot.nv},)")
        return self.share * limit

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        limit = self._limits(context.robot)
        return _rows_within(lambda: self.quantity(context), -limit, limit, getattr(units, self.kind))

    @override
    def idle(self, robot: Robot, schedule: Schedule) -> str:
        if np.isfinite(self._limits(robot)).any():
            return super().idle(robot, schedule)
        return f"robot '{robot.name}' has no limit of {self.kind.replace('_', ' ')}"


@checked
@dataclass(frozen=True, kw_only=True)
class AccelerationLimits(HigherLimits):
    """Joint accelerations within limits, at points, and at nodes where jerks are the input.

        |xi_j''| <= limit_j

    Rows are over g or g / l.

    Args:
        limit: (nv,), rad/s^2 or m/s^2, inf where there is none; default `Robot.joint_limits`.

    Raises:
        InputError: for limits that are not above 0.
    """

    kind, unit = "acceleration", "rad/s^2"

    @override
    def quantity(self, context: Context) -> ca.SX:
        return context.ddxi


@dataclass(frozen=True, kw_only=True)
class LimitsAtNodes(NodeConstraint):
    """Rows of `AccelerationLimits` at the nodes of its phases, where accelerations are part of the state."""

    limits: AccelerationLimits

    @property
    @override
    def name(self) -> str:
        return self.limits.name

    @override
    def acts_at(self, place: NodePlace) -> bool:
        return self.limits.acts_in(place.phase.name)

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        return self.limits.rows(context, units) or Rows.create(ca.SX(0, 1), 0, 0, 1)


@checked
@dataclass(frozen=True, kw_only=True)
class JerkLimits(HigherLimits):
    """Joint jerks within limits at points, where jerks are the input.

        |d3 xi_j / dt3| <= limit_j

    Rows are over g sqrt(g / l) or (g / l)^(3/2).

    Args:
        limit: (nv,), rad/s^3 or m/s^3, inf where there is none; default `Robot.joint_limits`.

    Raises:
        InputError: for limits that are not above 0, and for another input than jerks.
    """

    kind, unit = "jerk", "rad/s^3"

    @override
    def quantity(self, context: Context) -> ca.SX:
        return context.dddxi


@checked
@dataclass(frozen=True, kw_only=True)
class TorqueRateLimits(HigherLimits):
    """Rates of joint torques within limits at points, where jerks are the input.

        |d tau_j / dt| <= 0.99 limit_j

    with tau the torques that the drives deliver, joint side. The rates vary between points, where one in a
    hundred of the limit may be missed. Rows are over m g sqrt(g l).

    Args:
        limit: (nv,), N m/s or N/s, inf where there is none; default `Robot.joint_limits`.

    Raises:
        InputError: for limits that are not above 0, and for another input than jerks.
    """

    kind, unit, share = "torque_rate", "N m/s", 1 - BETWEEN

    @override
    def quantity(self, context: Context) -> ca.SX:
        rows, rates = context.robot.actuated_rows.tolist(), ca.SX.zeros(context.robot.nv)
        rates[rows] = context.rate(context.torque)[: len(rows)]
        return rates


def _require_limits(term: str, limit: np.ndarray | None, unit: str, least: float = 0.0) -> None:
    given = np.atleast_1d(np.asarray(np.inf if limit is None else limit, dtype=float))
    if not np.all(given >= least):
        allowed = f"allowed: numbers {'>' if least else '>='} 0, or inf, {unit}"
        raise InputError(f"limit of {term} holds {given[~(given >= least)][0]:g}", allowed)


def with_far_limits(terms: Sequence[Term], robot: Robot) -> tuple[Term, ...]:
    """The terms, with rows also for a robot's limits that seem out of reach; unchanged if there are none.

    Such limits normally have no row, because barriers for placeholder values in descriptions cost iterations.
    If a motion exceeds one all the same, it is solved again with these terms (`trajopt.solving.refinement`).
    """
    limits = TorqueLimits | VelocityLimits | PositionLimits
    return tuple(
        replace(term, far=True) if isinstance(term, limits) and term.left_out(robot).any() else term
        for term in terms
    )
