"""Rows of the motion itself: contacts that must not slide, and what an impact does to velocities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np

from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.interfaces import Cost, PointConstraint, Rows


@dataclass(frozen=True, kw_only=True)
class ContactVelocity(PointConstraint):
    """Active contacts do not move, J v = 0: what a velocity source needs in place of accelerations."""

    def rows(self, context: Context, units: Units) -> Rows | None:
        parts, scales = [], []
        for contact in context.contacts:
            parts.append(context.frame(contact.frame).velocity[list(context.held_rows(contact))])
            scales += units.twist[list(context.held_rows(contact))].tolist()
        return Rows.create(ca.vertcat(*parts), 0, 0, np.array(scales)) if parts else None


@dataclass(frozen=True, kw_only=True)
class ImpactDynamics(PointConstraint):
    """M (v+ - v-) = J^T Lambda: contacts alone change velocities, joint torques stay finite.

    All rows, base and joints; with J v+ = 0, which the landing asks for at the node after the impact, it is
    the rigid inelastic impact (Featherstone, "Rigid Body Dynamics Algorithms", 2008, sec. 11.7).
    """

    def rows(self, context: Context, units: Units) -> Rows:
        return Rows.create(context.generalized_forces, 0, 0, units.generalized_force)


@dataclass(frozen=True, kw_only=True)
class ImpulseCost(Cost):
    """Impulses over weight times sqrt(l / g), once at every impact: soft landings, and none undetermined."""

    acts_at_points: ClassVar[bool] = False
    acts_at_impacts: ClassVar[bool] = True

    def residual(self, context: Context, units: Units) -> ca.SX:
        parts = [w / units.wrench[: w.numel()] for w in context.wrenches.values()]
        return ca.vertcat(*parts) if parts else ca.SX(0, 1)
