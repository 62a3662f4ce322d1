"""Costs, constraints at collocation points, and what all terms share, in one place to import from."""

from __future__ import annotations

from trajopt.terms.costs import AccelerationCost, PostureCost, TimeCost, TorqueCost, VelocityCost, WrenchCost
from trajopt.terms.dynamics import ContactVelocity, ImpactDynamics, ImpulseCost
from trajopt.terms.friction import FrictionCone, FrictionPyramid, NormalForce, SoleCone, SoleLimits
from trajopt.terms.interfaces import Cost, PointConstraint, Rows, Term
from trajopt.terms.limits import (
    BaseDynamics,
    ContactAcceleration,
    EffortLimits,
    PositionLimits,
    VelocityLimits,
)

__all__ = [
    "AccelerationCost",
    "BaseDynamics",
    "ContactAcceleration",
    "ContactVelocity",
    "Cost",
    "EffortLimits",
    "FrictionCone",
    "FrictionPyramid",
    "ImpactDynamics",
    "ImpulseCost",
    "NormalForce",
    "PointConstraint",
    "PositionLimits",
    "PostureCost",
    "Rows",
    "SoleCone",
    "SoleLimits",
    "Term",
    "TimeCost",
    "TorqueCost",
    "VelocityCost",
    "VelocityLimits",
    "WrenchCost",
]
