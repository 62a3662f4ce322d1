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
    """The unactuated rows of the dynamics vanish: the Newton-Euler equations of the whole robot.

        [M(q) v' + h(q, v) - sum_c J_c^T f_c]_unactuated = 0

    with the wrenches f_c of the active contacts in world axes. Rows are over m g or m g l.
    """

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        n = context.robot.n_unactuated
        if n == 0:
            return None
        return Rows.create(context.base_rows, 0, 0, units.generalized_force[:n])


@dataclass(frozen=True, kw_only=True)
class ContactAcceleration(PointConstraint):
    """Active contacts do not accelerate.

        J a + J' v = 0           held contacts: linear and for a sole angular, 3 or 6 rows
        n^T (J a + J' v) = 0     sliding contacts: along the normal n of their surface

    Rows are over g or g / l. Axes are the base's for a free-flyer, the world's otherwise.
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
    """Active contacts do not move: for velocity sources, in place of `ContactAcceleration`.

        J v = 0

    linear and for a sole angular, in world axes. Rows are over sqrt(g l) or sqrt(g / l).
    """

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        parts, scales = [], []
        for contact in context.contacts:
            parts.append(context.frame(contact.frame).velocity[list(context.held_rows(contact))])
            scales += units.twist[list(context.held_rows(contact))].tolist()
        return Rows.create(ca.vertcat(*parts), 0, 0, np.array(scales)) if parts else None


@dataclass(frozen=True, kw_only=True)
class ImpactDynamics(PointConstraint):
    """A rigid impact: only contact impulses change velocities.

        M(q) (v+ - v-) - sum_c J_c^T Lambda_c = 0

    over all rows, base and joints: joint torques stay finite and have no impulse. Together with J v+ = 0,
    which `ContactLanding` imposes at the node after the impact, the impact is inelastic (Featherstone, "Rigid
    Body Dynamics Algorithms", 2008, sec. 11.7).
    """

    @override
    def rows(self, context: Context, units: Units) -> Rows:
        return Rows.create(context.generalized_forces, 0, 0, units.generalized_force)
