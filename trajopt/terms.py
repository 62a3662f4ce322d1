"""Costs, constraints at collocation points, and what all terms share, in one place to import from."""

from __future__ import annotations

from trajopt.contact_terms import FrictionCone, FrictionPyramid, SoleCone, SoleLimits
from trajopt.costs import (
    AccelerationCost,
    PostureCost,
    TorqueCost,
    VelocityCost,
    WrenchCost,
)
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
    "Cost",
    "EffortLimits",
    "FrictionCone",
    "FrictionPyramid",
    "PointConstraint",
    "PositionLimits",
    "PostureCost",
    "Rows",
    "SoleCone",
    "SoleLimits",
    "Term",
    "TorqueCost",
    "VelocityCost",
    "VelocityLimits",
    "WrenchCost",
]
