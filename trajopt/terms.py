"""Costs, constraints at collocation points, and what all terms share, in one place to import from."""

from __future__ import annotations

from trajopt.contact_terms import FrictionCone, FrictionPyramid, NormalForce, SoleCone, SoleLimits
from trajopt.costs import (
    AccelerationCost,
    PostureCost,
    TimeCost,
    TorqueCost,
    VelocityCost,
    WrenchCost,
)
from trajopt.motion_terms import ContactVelocity, ImpactDynamics, ImpulseCost
from trajopt.point_terms import (
    BaseDynamics,
    ContactAcceleration,
    EffortLimits,
    PositionLimits,
    VelocityLimits,
)
from trajopt.term_interfaces import (
    Cost,
    PointConstraint,
    Rows,
    Term,
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
