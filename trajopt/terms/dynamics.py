"""The dynamics as constraints: balance of the base, contacts that stay in place, and impacts."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.interfaces import PointConstraint, Rows


@dataclass(frozen=True, kw_only=True)
class BaseDynamics(PointConstraint):
    """The unactuated rows of the dynamics vanish: the Newton-Euler equations of the whole robot."""

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        n = context.robot.n_unactuated
        if n == 0:
            return None
        return Rows.create(context.base_rows, 0, 0, units.generalized_force[:n])


@dataclass(frozen=True, kw_only=True)
class ContactAcceleration(PointConstraint):
    """Active contacts do not accelerate: J a + J' v = 0, linear and for a sole angular, world axes.

    A sliding contact does not accelerate along the normal of its surface.
    """

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        parts, scales = [], []
        for contact in context.contacts:
            acceleration, surface = context.contact_acceleration(contact), context.slides_on(contact)
            if surface is not None:
                parts.append(ca.mtimes(context.parameter(surface.normal).T, acceleration))
                scales.append(units.contact_acceleration[0])
                continue
            parts.append(acceleration)
            scales += units.contact_acceleration[list(context.held_rows(contact))].tolist()
        return Rows.create(ca.vertcat(*parts), 0, 0, np.array(scales)) if parts else None


@dataclass(frozen=True, kw_only=True)
class ContactVelocity(PointConstraint):
    """Active contacts do not move, J v = 0: for velocity sources, in place of `ContactAcceleration`."""

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        parts, scales = [], []
        for contact in context.contacts:
            parts.append(context.frame(contact.frame).velocity[list(context.held_rows(contact))])
            scales += units.twist[list(context.held_rows(contact))].tolist()
        return Rows.create(ca.vertcat(*parts), 0, 0, np.array(scales)) if parts else None


@dataclass(frozen=True, kw_only=True)
class ImpactDynamics(PointConstraint):
    """A rigid impact, M (v+ - v-) = J^T Lambda: only contact impulses change velocities.

    All rows, base and joints: joint torques stay finite and have no impulse. Together with J v+ = 0, which
    `ContactLanding` imposes at the node after the impact, the impact is inelastic (Featherstone, "Rigid Body
    Dynamics Algorithms", 2008, sec. 11.7).
    """

    @override
    def rows(self, context: Context, units: Units) -> Rows:
        return Rows.create(context.generalized_forces, 0, 0, units.generalized_force)
