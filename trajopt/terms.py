"""Costs and constraints: a name, a small function, bounds, a scale, and where it acts.

Costs are dimensionless: each is the mean square of a quantity over its natural unit (weight m g,
length l of the robot, and what follows from them), so that a weight means the same on any robot;
the running cost is their integral over time in units of sqrt(l/g).

A term acts in the phases it names (``phases=None``: in all). Constraint rows are divided by their
natural unit before the solver sees them.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import casadi as ca
import numpy as np

from trajopt.context import Context
from trajopt.errors import InputError
from trajopt.manifold import Coordinates
from trajopt.robot import Contact, Robot
from trajopt.units import Units


@dataclass(frozen=True, kw_only=True)
class Term(ABC):
    """What costs and constraints share: the phases in which they act."""

    phases: tuple[str, ...] | None = None

    @property
    def name(self) -> str:
        """Name in reports, for example ``torque_cost``."""
        letters = type(self).__name__
        return "".join(f"_{c.lower()}" if c.isupper() and i else c.lower() for i, c in enumerate(letters))

    def acts_in(self, phase: str) -> bool:
        """Whether the term acts in the phase of that name."""
        return self.phases is None or phase in self.phases


@dataclass(frozen=True, kw_only=True)
class Cost(Term):
    """A running cost at collocation points; ``weight`` is dimensionless, finite and >= 0."""

    weight: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.weight) and self.weight >= 0):
            raise InputError(f"weight of {self.name} is {self.weight:g}", "allowed: finite and >= 0")

    @abstractmethod
    def residual(self, context: Context, units: Units) -> ca.SX:
        """Quantity over its unit, (n,); the cost is the weighted mean of its squares."""

    def value(self, context: Context, units: Units) -> ca.SX:
        """Cost rate at one point."""
        residual = self.residual(context, units)
        if residual.numel() == 0:
            return ca.SX(0)
        return context.parameter(self.weight) * ca.sumsqr(residual) / residual.numel()


@dataclass(frozen=True, kw_only=True)
class TorqueCost(Cost):
    """Joint torques over weight times length."""

    def residual(self, context: Context, units: Units) -> ca.SX:
        return context.torque / units.torque


@dataclass(frozen=True, kw_only=True)
class AccelerationCost(Cost):
    """Second derivatives of the local coordinates over g and g / length."""

    def residual(self, context: Context, units: Units) -> ca.SX:
        return context.ddxi / units.acceleration


@dataclass(frozen=True, kw_only=True)
class VelocityCost(Cost):
    """Rates of the local coordinates over sqrt(g length) and sqrt(g / length)."""

    def residual(self, context: Context, units: Units) -> ca.SX:
        return context.dxi / units.velocity


@dataclass(frozen=True, kw_only=True)
class PostureCost(Cost):
    """Actuated joints' distance from a posture ``q`` (nq,); default: the robot's reference."""

    q: np.ndarray | None = None

    def residual(self, context: Context, units: Units) -> ca.SX:
        robot, coordinates = context.robot, context.coordinates
        q = robot.reference if self.q is None else self.q
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


@dataclass(frozen=True)
class Rows:
    """Rows of a constraint at one place: expression (n,), bounds and unit of each row."""

    expression: ca.SX
    lower: np.ndarray
    upper: np.ndarray
    unit: np.ndarray

    @classmethod
    def create(cls, expression: ca.SX, lower: object, upper: object, unit: object) -> Rows:
        """Rows with scalars broadcast to the expression's length."""
        n = expression.numel()
        return cls(
            expression, *(np.broadcast_to(np.asarray(b, dtype=float), n).copy() for b in (lower, upper, unit))
        )


@dataclass(frozen=True, kw_only=True)
class PointConstraint(Term):
    """A constraint at every collocation point of its phases."""

    @abstractmethod
    def rows(self, context: Context, units: Units) -> Rows | None:
        """Rows at one point, or None where there is nothing to constrain."""

    def node_bounds(self, robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
        """Simple bounds at nodes on the local positions and rates: four arrays (nv,), or None."""
        return None

    def limits(self, robot: Robot) -> dict[str, np.ndarray]:
        """Limits that the term replaces in the solution's description, by name; default: none."""
        return {}


@dataclass(frozen=True, kw_only=True)
class EffortLimits(PointConstraint):
    """Joint torques within ``limit`` (nu,) N m, joint side; default: the robot's limits."""

    limit: np.ndarray | None = None

    def rows(self, context: Context, units: Units) -> Rows | None:
        limit = context.robot.effort_limit if self.limit is None else self.limit
        bound = [] if limit is None else np.flatnonzero(np.asarray(limit) < units.unreachable_torque)
        if len(bound) == 0:
            return None
        torque = ca.vertcat(*[context.torque[int(i)] for i in bound])
        return Rows.create(torque, -np.asarray(limit)[bound], np.asarray(limit)[bound], units.torque)

    def limits(self, robot: Robot) -> dict[str, np.ndarray]:
        return {} if self.limit is None else {"effort_limit": np.asarray(self.limit, dtype=float)}


@dataclass(frozen=True, kw_only=True)
class VelocityLimits(PointConstraint):
    """Joint rates within the robot's limits, at points and nodes."""

    def _limits(self, robot: Robot) -> np.ndarray:
        limit = np.where(
            robot.velocity_limit < Units(robot).unreachable_velocity, robot.velocity_limit, np.inf
        )
        limit[: robot.n_unactuated] = np.inf
        return limit

    def rows(self, context: Context, units: Units) -> Rows | None:
        limit = self._limits(context.robot)
        bound = np.flatnonzero(np.isfinite(limit))
        if len(bound) == 0:
            return None
        rates = ca.vertcat(*[context.dxi[int(i)] for i in bound])
        return Rows.create(rates, -limit[bound], limit[bound], units.velocity[bound])

    def node_bounds(self, robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        limit, free = self._limits(robot), np.full(robot.nv, np.inf)
        return -free, free, -limit, limit


@dataclass(frozen=True, kw_only=True)
class PositionLimits(PointConstraint):
    """Joint positions within the robot's limits, at points and nodes.

    A limit more than a full turn (2 pi) away from the reference posture is not imposed: no useful
    motion winds a joint that far, and ``check`` still verifies it.
    """

    def _limits(self, robot: Robot, context: Context) -> tuple[np.ndarray, np.ndarray]:
        lower, upper = np.full(robot.nv, -np.inf), np.full(robot.nv, np.inf)
        for joint in context.coordinates.joints:
            if joint.kind != "plain" or joint.v.start < robot.n_unactuated:
                continue
            near_lower = robot.position_lower[joint.q] > robot.reference[joint.q] - 2 * math.pi
            near_upper = robot.position_upper[joint.q] < robot.reference[joint.q] + 2 * math.pi
            lower[joint.v] = np.where(near_lower, robot.position_lower[joint.q], -np.inf)
            upper[joint.v] = np.where(near_upper, robot.position_upper[joint.q], np.inf)
        return lower, upper

    def rows(self, context: Context, units: Units) -> Rows | None:
        lower, upper = self._limits(context.robot, context)
        bound = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
        if len(bound) == 0:
            return None
        positions = ca.vertcat(*[context.xi[int(i)] for i in bound])
        return Rows.create(positions, lower[bound], upper[bound], units.position[bound])

    def node_bounds(self, robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        lower, upper = self._limits(robot, Context(robot, Coordinates(robot.model), (), node=True))
        free = np.full(robot.nv, np.inf)
        return lower, upper, -free, free


def contact_force(context: Context, contact: Contact) -> ca.SX:
    """Force (3,) of an active contact, world axes, N."""
    return context.wrenches[contact.name][:3]


@dataclass(frozen=True, kw_only=True)
class FrictionPyramid(PointConstraint):
    """Unilateral force inside a pyramid inscribed in the Coulomb cone: |f_x|, |f_y| <= mu f_z / sqrt 2."""

    friction: float

    def rows(self, context: Context, units: Units) -> Rows | None:
        mu = context.parameter(self.friction / math.sqrt(2))
        parts = []
        for contact in context.contacts:
            f = contact_force(context, contact)
            parts += [f[2], mu * f[2] - f[0], mu * f[2] + f[0], mu * f[2] - f[1], mu * f[2] + f[1]]
        return Rows.create(ca.vertcat(*parts), 0, np.inf, units.force) if parts else None


@dataclass(frozen=True, kw_only=True)
class FrictionCone(PointConstraint):
    """Unilateral force inside the smooth exact Coulomb cone: f_x^2 + f_y^2 <= (mu f_z)^2, f_z >= 0.

    The squared form has no kink at the apex; the row is divided by the weight squared.
    """

    friction: float

    def rows(self, context: Context, units: Units) -> Rows | None:
        mu = context.parameter(self.friction)
        parts = []
        for contact in context.contacts:
            f = contact_force(context, contact) / units.force
            parts += [f[2], (mu * f[2]) ** 2 - f[0] ** 2 - f[1] ** 2]
        return Rows.create(ca.vertcat(*parts), 0, np.inf, 1.0) if parts else None


@dataclass(frozen=True, kw_only=True)
class SoleLimits(PointConstraint):
    """Centre of pressure of surface contacts inside the sole, and yaw moment within friction.

    |m_x| <= half_width f_z, |m_y| <= half_length f_z in the sole's axes, and the yaw moment within
    mu f_z times the mean half size (Caron, Pham, Nakamura, ICRA 2015, give the exact cone).
    """

    friction: float

    def rows(self, context: Context, units: Units) -> Rows | None:
        mu = context.parameter(self.friction)
        parts = []
        for contact in context.contacts:
            if contact.dimension == 6:
                rotation = context.frame(contact.frame).rotation
                force, moment = contact_force(context, contact), context.wrenches[contact.name][3:]
                local, fz = ca.mtimes(rotation.T, moment), force[2]
                arm = (
                    contact.half_width,
                    contact.half_length,
                    mu * (contact.half_width + contact.half_length) / 2,
                )
                for i in range(3):
                    parts += [arm[i] * fz - local[i], arm[i] * fz + local[i]]
        return Rows.create(ca.vertcat(*parts), 0, np.inf, units.torque) if parts else None


@dataclass(frozen=True, kw_only=True)
class BaseDynamics(PointConstraint):
    """Unactuated rows of the dynamics vanish: nobody pushes the base (Newton-Euler of the whole body)."""

    def rows(self, context: Context, units: Units) -> Rows | None:
        n = context.robot.n_unactuated
        if n == 0:
            return None
        unit = np.where(units.position[:n] == 1.0, units.torque, units.force)
        return Rows.create(context.base_rows, 0, 0, unit)


@dataclass(frozen=True, kw_only=True)
class ContactAcceleration(PointConstraint):
    """Active contacts do not accelerate: J a + Jdot v = 0, linear (and for a sole angular), world axes."""

    def rows(self, context: Context, units: Units) -> Rows | None:
        parts, scales = [], []
        for contact in context.contacts:
            parts.append(context.contact_acceleration(contact))
            scales += ([units.gravity] * 3 + [units.gravity / units.length] * 3)[: contact.dimension]
        return Rows.create(ca.vertcat(*parts), 0, 0, np.array(scales)) if parts else None
