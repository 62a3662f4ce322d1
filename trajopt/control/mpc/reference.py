"""The reference of a horizon: motion of the base, joints and feet at its points, as parameters of one cost.

In natural units (see `trajopt.robot.Units`) the running cost of a horizon is

    sum_i w_i e_i^2,      e = (p - p*) / l,  turn(R*, R),  (p' - v*) / sqrt(g l),  (omega - w*) sqrt(l / g),
                              q_j - q_j*,  q_j' sqrt(l / g),  s (p_f - p_f*) / l of feet in the air, and the
                              tilt of soles in the air and their heading relative to R*

plus the costs of torques, forces and accelerations, with a factor s for each axis of each foot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.arguments import NonNegative, checked
from trajopt.control.mpc.horizon import Numbers
from trajopt.dynamics.rotations import quaternion_product, rotation_matrix
from trajopt.robot.legs import wheel_rows
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.costs import AccelerationCost, TorqueCost, WrenchCost
from trajopt.terms.friction import contact_cones
from trajopt.terms.interfaces import Cost, Term
from trajopt.terms.limits import PositionLimits, TorqueLimits, VelocityLimits

REFERENCE = "reference"


class Reference(Protocol):
    """The reference that a plan follows, from now on."""

    def rows(self, times: np.ndarray) -> np.ndarray:
        """The reference (n, `ReferenceLayout.size`) at times (n,) from now, s."""
        ...

    def landing_height(self, name: str, time: float) -> float:
        """Height of the frame of a contact that lands about ``time`` s from now, m."""
        ...


@checked
@dataclass(frozen=True, kw_only=True)
class HorizonWeights:
    """Weights of a horizon's cost, dimensionless.

    For the base, ``position`` and ``height`` weigh its level position and height, ``tilt`` roll and pitch,
    ``heading`` yaw, ``velocity`` and ``rise`` the level and vertical velocity, ``spin`` the angular velocity.
    ``joints`` and ``rates`` weigh joint positions and rates, ``feet`` the positions of feet in the air,
    ``soles`` their tilt and heading, and ``acceleration`` only the accelerations of joints.
    """

    position: NonNegative = 0.0
    height: NonNegative = 20.0
    tilt: NonNegative = 10.0
    heading: NonNegative = 10.0
    velocity: NonNegative = 20.0
    rise: NonNegative = 1.0
    spin: NonNegative = 0.5
    joints: NonNegative = 0.05
    rates: NonNegative = 0.01
    feet: NonNegative = 10.0
    soles: NonNegative = 1.0
    torque: NonNegative = 0.02
    wrench: NonNegative = 0.02
    acceleration: NonNegative = 0.002


@dataclass(frozen=True)
class ReferenceLayout:
    """Layout of the reference at one point: base (13,), joints (nj,), place and factors (6,) of each foot."""

    joints: int
    contacts: int

    @cached_property
    def size(self) -> int:
        """Size of the reference at one point."""
        return 13 + self.joints + 6 * self.contacts

    position = slice(0, 3)
    quaternion = slice(3, 7)
    velocity = slice(7, 10)
    spin = slice(10, 13)

    @property
    def posture(self) -> slice:
        """The posture of the joints."""
        return slice(13, 13 + self.joints)

    def foot(self, contact: int) -> slice:
        """Place and factors of a foot."""
        first = 13 + self.joints + 6 * contact
        return slice(first, first + 6)


@dataclass(frozen=True, kw_only=True)
class ReferenceCost(Cost):
    """The module's weighted squared errors; the reference is the `Numbers` named `REFERENCE`."""

    weights: HorizonWeights

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        robot, w = context.robot, self.weights
        at = reference_layout(robot)
        r = context.varying(Numbers(REFERENCE, at.size), at.size)
        conjugate = r[at.quaternion] * ca.SX([-1, -1, -1, 1])
        turn = 2 * quaternion_product(conjugate, context.q[3:7])[:3]
        level, spin = [w.velocity, w.velocity, w.rise], [w.spin] * 3
        held = np.ones(at.joints)
        held[[row - 6 for row in wheel_rows(robot).values()]] = 0.0  # wheels turn freely
        parts: list[tuple[ca.SX, list[float]]] = [
            ((context.xi[:3] - r[at.position]) / units.length, [w.position, w.position, w.height]),
            (turn, [w.tilt, w.tilt, w.heading]),
            ((context.dxi[:3] - r[at.velocity]) / units.velocity[0], level),
            ((context.dxi[3:6] - r[at.spin]) * units.time, spin),
            (context.xi[6:] - r[at.posture], list(w.joints * held)),
            (context.dxi[6:] * units.time, list(w.rates * held)),
        ]
        for number, contact in enumerate(robot.contacts):
            if contact not in context.contacts:
                goal, factor = ca.vertsplit(r[at.foot(number)], 3)
                frame = context.frame(contact.frame)
                away = factor * (frame.position - goal) / units.length
                parts.append((away, [w.feet] * 3))
                if contact.kind == "surface":
                    left = rotation_matrix(r[at.quaternion])[:, 1]
                    twisted = ca.vertcat(frame.rotation[2, :2].T, ca.dot(left, frame.rotation[:, 0]))
                    parts.append((factor[2] * twisted, [w.soles] * 3))
        weights = context.parameter(np.concatenate([weights for _, weights in parts]))
        return ca.sqrt(weights) * ca.vertcat(*[error for error, _ in parts])

    @override
    def value(self, context: Context, units: Units) -> ca.SX:
        residual = self.residual(context, units)
        context.square(residual, ca.SX(self.weight))
        return self.weight * ca.sumsqr(residual)


def leg_terms(
    robot: Robot,
    weights: HorizonWeights,
    contacts: Sequence[Sequence[str]],
    *,
    torque_rows: bool = True,
) -> tuple[Term, ...]:
    """Costs and hard limits of a legged robot, with the names of the ``contacts`` of each phase."""
    touching = [robot.contact(name) for names in contacts for name in names]
    return (
        ReferenceCost(weight=1.0, weights=weights),
        TorqueCost(weight=weights.torque),
        *([WrenchCost(weight=weights.wrench)] if touching else []),
        AccelerationCost(weight=weights.acceleration, joints_only=True),
        *contact_cones(touching),
        *([TorqueLimits()] if torque_rows else []),
        VelocityLimits(),
        PositionLimits(),
    )


def reference_layout(robot: Robot) -> ReferenceLayout:
    """Layout of the reference of a robot with a free base."""
    return ReferenceLayout(robot.nv - 6, len(robot.contacts))
