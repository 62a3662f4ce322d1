"""Costs at single nodes: how high a frame is at one moment, how far it is at the end.

They are linear in a quantity over its natural unit, negative for a quantity to maximise: with a weight
of one, a rise by the robot's length is worth as much as torques of weight times length for sqrt(l/g).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.arguments import NonNegative, checked
from trajopt.errors import require_not_negative, unit_vector
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.interfaces import Term
from trajopt.terms.node_interfaces import AtMoment, NodePlace


@checked
@dataclass(frozen=True, kw_only=True)
class NodeCost(Term, ABC):
    """A cost at some nodes (a Mayer term), ``w`` times its `quantity`.

    Args:
        weight: w, dimensionless, finite and at least zero.

    Raises:
        InputError: for another weight.
    """

    acts_at_points: ClassVar[bool] = False

    weight: NonNegative

    def __post_init__(self) -> None:
        require_not_negative(f"weight of {self.name}", self.weight)

    def acts_at(self, place: NodePlace) -> bool:
        """Whether the cost acts at this node; default: at the end of the schedule."""
        return place.last

    @abstractmethod
    def quantity(self, context: Context, units: Units, place: NodePlace) -> ca.SX:
        """Quantity over its unit, to be weighted; only parameter values may depend on ``place``."""

    def value(self, context: Context, units: Units, place: NodePlace) -> ca.SX:
        """Cost at one node."""
        return context.parameter(self.weight) * self.quantity(context, units, place)


@checked
@dataclass(frozen=True, kw_only=True)
class FrameHeightCost(AtMoment, NodeCost):
    """As high as possible: minus the height of a frame at one moment.

        -w p_z / l

    with p the frame's origin in the world.

    Args:
        weight: w, dimensionless.
        frame: name of the frame.
        at: the moment; the middle of a ballistic flight is its apex.

    Raises:
        InputError: for a negative weight.
    """

    frame: str

    def __post_init__(self) -> None:
        NodeCost.__post_init__(self)
        AtMoment.__post_init__(self)

    @override
    def quantity(self, context: Context, units: Units, place: NodePlace) -> ca.SX:
        return -context.frame(self.frame).position[2] / units.length


@checked
@dataclass(frozen=True, kw_only=True)
class DistanceCost(AtMoment, NodeCost):
    """As far as possible: minus a frame's coordinate along a direction at one moment.

        -w direction . p / l

    with p the frame's origin in the world.

    Args:
        weight: w, dimensionless.
        frame: name of the frame.
        direction: in the world (3,), normalised.
        at: the moment; default the end of the motion.

    Raises:
        InputError: for a zero vector.
    """

    frame: str
    direction: tuple[float, float, float] = (1.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        NodeCost.__post_init__(self)
        AtMoment.__post_init__(self)
        direction = unit_vector(f"direction of {self.name}", self.direction)
        object.__setattr__(self, "direction", tuple(direction.tolist()))

    @override
    def quantity(self, context: Context, units: Units, place: NodePlace) -> ca.SX:
        direction = context.parameter(np.array(self.direction))
        return -ca.dot(direction, context.frame(self.frame).position) / units.length
