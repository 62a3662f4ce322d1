"""Running costs at collocation points, and the cost of impulses at impacts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.arguments import checked
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.schedule.schedule import Schedule
from trajopt.terms.context import Context
from trajopt.terms.interfaces import Cost


@checked
@dataclass(frozen=True, kw_only=True)
class TorqueCost(Cost):
    """Joint torques over weight times length."""

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        return context.torque / units.torque


@checked
@dataclass(frozen=True, kw_only=True)
class AccelerationCost(Cost):
    """Second derivatives of the local coordinates over g and g / length.

    Args:
        weight: dimensionless.
        joints_only: whether the unactuated rows are left out.
    """

    joints_only: bool = False

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        first = context.robot.n_unactuated if self.joints_only else 0
        return (context.ddxi / units.acceleration)[first:]


@checked
@dataclass(frozen=True, kw_only=True)
class VelocityCost(Cost):
    """Rates of the local coordinates over sqrt(g length) and sqrt(g / length).

    Args:
        weight: dimensionless.
        joints_only: whether the unactuated rows are left out.
    """

    joints_only: bool = False

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        first = context.robot.n_unactuated if self.joints_only else 0
        return (context.dxi / units.velocity)[first:]


@checked
@dataclass(frozen=True, kw_only=True)
class PostureCost(Cost):
    """Distance of the actuated joints from a posture ``q`` (nq,), default the robot's reference."""

    q: np.ndarray | None = None

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        robot, coordinates = context.robot, context.coordinates
        q = robot.reference if self.q is None else context.posture(self.q)
        node = coordinates.node_from_pinocchio(q, np.zeros(robot.nv))
        n4 = 4 * coordinates.n_rotations
        additive = coordinates.additive_index
        joints = [(i, node[n4 + row]) for row, i in enumerate(additive) if i >= robot.n_unactuated]
        target = context.parameter(np.array([value for _, value in joints]))
        selected = ca.vertcat(*[context.xi[int(i)] for i, _ in joints])
        return (selected - target) / units.position[[i for i, _ in joints]]


@checked
@dataclass(frozen=True, kw_only=True)
class WrenchCost(Cost):
    """Contact forces over weight, moments over weight times length; zero in flight."""

    acts_on_forces: ClassVar[bool] = True

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        return _scaled_wrenches(context, units)


@checked
@dataclass(frozen=True, kw_only=True)
class TimeCost(Cost):
    """Time itself, over sqrt(l / g): with free durations, minimum time."""

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        return ca.SX(1)


@checked
@dataclass(frozen=True, kw_only=True)
class ImpulseCost(Cost):
    """Impulses over weight times sqrt(l / g), once at every impact.

    It makes landings soft and the impulses of redundant contacts unique.
    """

    acts_at_points: ClassVar[bool] = False
    acts_at_impacts: ClassVar[bool] = True

    @override
    def idle(self, robot: Robot, schedule: Schedule) -> str:
        impacts = any(phase.impact for phase in schedule.phases if self.acts_in(phase.name))
        return "" if impacts or self.phases is None else f"no impact begins phases {', '.join(self.phases)}"

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        return _scaled_wrenches(context, units)


def _scaled_wrenches(context: Context, units: Units) -> ca.SX:
    """All contact wrenches (or impulses) in one column, over their units."""
    parts = [w / units.wrench[: w.numel()] for w in context.wrenches.values()]
    return ca.vertcat(ca.SX(0, 1), *parts)
