"""Running costs at collocation points."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.interfaces import Cost


@dataclass(frozen=True, kw_only=True)
class TorqueCost(Cost):
    """Joint torques over weight times length."""

    def residual(self, context: Context, units: Units) -> ca.SX:
        return context.torque / units.torque


@dataclass(frozen=True, kw_only=True)
class AccelerationCost(Cost):
    """Second derivatives of the local coordinates over g and g / length; of the actuated ``joints_only``."""

    joints_only: bool = False

    def residual(self, context: Context, units: Units) -> ca.SX:
        first = context.robot.n_unactuated if self.joints_only else 0
        return (context.ddxi / units.acceleration)[first:]


@dataclass(frozen=True, kw_only=True)
class VelocityCost(Cost):
    """Rates of the local coordinates over sqrt(g length) and sqrt(g / length); of the ``joints_only``."""

    joints_only: bool = False

    def residual(self, context: Context, units: Units) -> ca.SX:
        first = context.robot.n_unactuated if self.joints_only else 0
        return (context.dxi / units.velocity)[first:]


@dataclass(frozen=True, kw_only=True)
class PostureCost(Cost):
    """Actuated joints' distance from a posture ``q`` (nq,); default: the robot's reference."""

    q: np.ndarray | None = None

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


@dataclass(frozen=True, kw_only=True)
class WrenchCost(Cost):
    """Contact forces over weight, moments over weight times length; zero in flight."""

    def residual(self, context: Context, units: Units) -> ca.SX:
        parts = [w / units.wrench[: w.numel()] for w in context.wrenches.values()]
        return ca.vertcat(*parts) if parts else ca.SX(0, 1)


@dataclass(frozen=True, kw_only=True)
class TimeCost(Cost):
    """Time itself, over sqrt(l / g): with free durations, minimum time."""

    def residual(self, context: Context, units: Units) -> ca.SX:
        return ca.SX(1)
