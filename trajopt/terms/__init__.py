"""Costs and constraints, one idea per file.

Dynamics: `BaseDynamics`, `ContactAcceleration`, `ContactVelocity`, `ImpactDynamics`.
Limits: `PositionLimits`, `VelocityLimits`, `TorqueLimits`, `DriveLimits`, `AccelerationLimits`, `JerkLimits`,
    `TorqueRateLimits`.
Contact forces: `FrictionCone`, `FrictionPyramid`, `NormalForce`, `SoleCone`, `SoleLimits`, `SlidingFriction`.
Running costs: `AccelerationCost`, `VelocityCost`, `PostureCost`, `TorqueCost`, `MotorTorqueCost`,
    `WrenchCost`, `PowerCost`, `TrackingCost`, `TimeCost`, `JerkCost`, `TorqueRateCost`, `CentreOfMassCost`,
    `MomentumCost`; `ImpulseCost` at impacts.
Constraints at nodes: `ContactLanding`; `FramePose`, `FrameHeight`, `FrameVelocity`, `FrameDirection`,
    `FramesAbove`; `CentreOfMass`, `Momentum`; `TerminalState`, `TerminalRest`, `TerminalVelocity`,
    `TerminalPosture`.
Swings: `SwingClearance` within phases and `SwingArc` across phases, over flat or smooth ground; `SwingOver`
    ground with edges; `swing_arcs` and `swing_clearance` create them for a whole schedule.
Costs at nodes: `FrameHeightCost`, `DistanceCost`.
Obstacles: `Clearance`.
Goals as terms: `goal_terms`, `effort_costs`.
Interfaces for user-defined terms: `Term`, `Cost`, `PointConstraint`, `NodeConstraint`, `NodeCost`, with
    `Context`, `NodePlace` and `Rows`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
