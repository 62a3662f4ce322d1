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
from typing import ClassVar

import casadi as ca
import numpy as np

from trajopt.errors import InputError
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.schedule.targets import Target
from trajopt.terms.context import Context


@dataclass(frozen=True, kw_only=True)
class Term:
    """What costs and constraints share: the phases in which they act, and where.

    A term about contact forces may act on the impulses of an impact that begins one of its phases too.
    """

    acts_at_points: ClassVar[bool] = True
    acts_at_impacts: ClassVar[bool] = False

    phases: tuple[str, ...] | None = None

    @property
    def name(self) -> str:
        """Name in reports, for example ``torque_cost``."""
        letters = type(self).__name__
        return "".join(f"_{c.lower()}" if c.isupper() and i else c.lower() for i, c in enumerate(letters))

    def acts_in(self, phase: str) -> bool:
        """Whether the term acts in the phase of that name."""
        return self.phases is None or phase in self.phases

    def targets(self) -> tuple[Target, ...]:
        """Places and postures that the term asks for at a moment, for pictures; default: none."""
        return ()


@dataclass(frozen=True, kw_only=True)
class Cost(Term, ABC):
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
        weight = context.parameter(self.weight)
        context.square(residual, weight / residual.numel())
        return weight * ca.sumsqr(residual) / residual.numel()


@dataclass(frozen=True)
class Rows:
    """Rows of a constraint at one place: expression (n,), bounds and unit of each row."""

    expression: ca.SX
    lower: np.ndarray
    upper: np.ndarray
    unit: np.ndarray

    @classmethod
    def create(cls, expression: ca.SX, lower: object, upper: object, unit: object) -> Rows:
        """Rows with scalars broadcast to the expression's length. Raises InputError for what bounds nothing.

        Bounds are numbers, or infinite on the side that is free; the lower ones are not above the upper ones.
        """
        n = expression.numel()
        low, high, size = (
            np.broadcast_to(np.asarray(given, dtype=float), n).copy() for given in (lower, upper, unit)
        )
        wrong = ~((low <= high) & (low < np.inf) & (high > -np.inf))
        if wrong.any():
            row = int(np.argmax(wrong))
            raise InputError(
                f"row {row} is bounded by {low[row]:g} and {high[row]:g}", "allowed: lower <= upper, no NaN"
            )
        return cls(expression, low, high, size)


@dataclass(frozen=True, kw_only=True)
class PointConstraint(Term, ABC):
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
