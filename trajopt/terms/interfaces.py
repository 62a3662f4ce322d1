"""Costs and constraints: a name, a small function, bounds, a scale, and where it acts.

Costs are dimensionless. Each is the mean square of a quantity over its natural unit, so that a weight means
the same on any robot. With w the weight and r (n,) the quantity over its unit, the objective is

    sum over costs of the integral of  w |r|^2 / n  over time in units of sqrt(l / g)

Natural units follow from the robot's mass m, its length l and gravity g (see `Units`). The symbols m, l, g, w
have this meaning in the docstrings of all terms.

A term acts in the phases it names (``during``, by default in all), or at a moment (``at``, see `AtMoment`).
Constraint rows are divided by their natural unit before the solver sees them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.arguments import NonNegative, checked
from trajopt.errors import InputError, numbers_of, shown
from trajopt.kinds import ArrayShape
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.schedule.moment import END, Moment, Target
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.terms.context import Context

# Of two nodes equally far from a fraction, up to rounding, the earlier one is the nearest.
SAME_FRACTION = 1e-9


@checked
@dataclass(frozen=True, kw_only=True)
class Term:
    """Common interface of costs and constraints.

    A term on contact forces may also act on the impulses of an impact with which one of its phases begins.
    """

    acts_at_points: ClassVar[bool] = True
    acts_at_impacts: ClassVar[bool] = False
    # Whether a function created it for a schedule, in which it may have no node to act at.
    made_for_schedule: ClassVar[bool] = False
    # Whether the check of a file judges the rows at all times without knowing the term.
    checked_by_file: ClassVar[bool] = False
    # Whether it concerns the forces of active contacts, without which it has no effect.
    acts_on_forces: ClassVar[bool] = False

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        if "rows" in vars(cls) and "checked_by_file" not in vars(cls):
            cls.checked_by_file = False  # rows of one's own are not those of the parent

    @property
    def name(self) -> str:
        """Name in reports, for example ``torque_cost``."""
        letters = type(self).__name__
        return "".join(f"_{c.lower()}" if c.isupper() and i else c.lower() for i, c in enumerate(letters))

    @property
    def in_check(self) -> bool:
        """Whether the check of a file judges the term at all times; others are judged by the solve."""
        return self.checked_by_file

    @property
    def phases(self) -> tuple[str, ...] | None:
        """Names of the phases in which the term acts; None if it names none and acts wherever it can."""
        return None

    def acts_in(self, phase: str) -> bool:
        """Whether the term acts in the phase of that name."""
        return self.phases is None or phase in self.phases

    def idle(self, robot: Robot, schedule: Schedule) -> str:
        """Why the term would have no effect with this robot and schedule; empty if it can act.

        This covers what names of phases, contacts and frames do not reveal. A problem rejects a term that
        gives a reason. A term that names no phases may concern contacts that the schedule does not use.
        """
        if self.acts_on_forces and self.phases is not None:
            touching = [phase.contacts for phase in schedule.phases if self.acts_in(phase.name)]
            if not any(touching):
                return f"no contact is active in phases {', '.join(self.phases)}"
        return ""

    def targets(self) -> tuple[Target, ...]:
        """Goals of the term at single moments, for guesses, checks and drawings; default: none."""
        return ()


@checked
@dataclass(frozen=True, kw_only=True)
class DuringPhases(Term):
    """A term that acts over time.

    Args:
        during: name of the phase in which it acts, or names of several; default all phases.
    """

    during: str | Sequence[str] | None = None

    @property
    @override
    def phases(self) -> tuple[str, ...] | None:
        if self.during is None:
            return None
        return (self.during,) if isinstance(self.during, str) else tuple(self.during)


@checked
@dataclass(frozen=True, kw_only=True)
class Cost(DuringPhases, ABC):
    """A running cost at collocation points, ``w |r|^2 / n`` of its `residual` r (n,), or another `value`.

    Args:
        weight: w, dimensionless, finite and at least zero.
        during: name of the phase in which it acts, or names of several; default all phases.

    Raises:
        InputError: for a weight that is negative or not finite.
    """

    weight: NonNegative

    def __init_subclass__(cls, **settings: Any) -> None:
        """Take the value of a class that has no residual for its whole cost."""
        super().__init_subclass__(**settings)
        if "value" in vars(cls) and getattr(cls.residual, "__isabstractmethod__", False):
            cls.residual = _no_residual  # type: ignore[assignment]

    def residual(self, context: Context, units: Units) -> ca.SX:
        """Quantity over its unit, (n,); the cost is the weighted mean of its squares.

        Args:
            context: symbols of one collocation point; see `Context` for names, frames and units.
            units: natural units of the robot, see `Units`.

        Returns:
            Expression (n,) of type SX.
        """
        return _no_residual(self, context, units)

    if not TYPE_CHECKING:  # for checkers a class with a value alone is whole
        residual = abstractmethod(residual)

    def value(self, context: Context, units: Units) -> ca.SX:
        """Cost rate ``w |r|^2 / n`` at one point; zero where the residual has no entry."""
        residual = column("result of residual()", self.residual(context, units))
        if residual.numel() == 0:
            return ca.SX(0)
        weight = context.parameter(self.weight)
        context.square(residual, weight / residual.numel())
        return weight * ca.sumsqr(residual) / residual.numel()


@checked
@dataclass(frozen=True)
class Rows:
    """Rows of a constraint at one place: expression (n,), bounds and unit of each row."""

    expression: ca.SX
    lower: Annotated[np.ndarray, ArrayShape((None,), infinite=True)]
    upper: Annotated[np.ndarray, ArrayShape((None,), infinite=True)]
    unit: Annotated[np.ndarray, ArrayShape((None,))]

    @classmethod
    @checked
    def create(cls, expression: ca.SX | ca.DM, lower: object, upper: object, unit: object) -> Rows:
        """Rows with scalars broadcast to the expression's length.

        Args:
            expression: the rows (n,).
            lower: lower bounds, -inf where there is none, not above ``upper``.
            upper: upper bounds, inf where there is none.
            unit: natural unit of each row.

        Raises:
            InputError: for bounds that are NaN, or lower above upper.
        """
        rows = column("expression of Rows", expression)
        named = {"lower": lower, "upper": upper, "unit": unit}
        low, high, size = (_each(f"{name} of Rows", given, rows.numel()) for name, given in named.items())
        wrong = ~((low <= high) & (low < np.inf) & (high > -np.inf))
        if wrong.any():
            row = int(np.argmax(wrong))
            raise InputError(
                f"row {row} is bounded by {low[row]:g} and {high[row]:g}", "allowed: lower <= upper, no NaN"
            )
        return cls(rows, low, high, size)


def _no_residual(cost: Cost, context: Context, units: Units) -> ca.SX:
    raise InputError(f"cost {type(cost).__name__} has no residual", "allowed: its value")


def column(what: str, expression: Any) -> ca.SX:
    """An expression as a column (n,). Raises `InputError`, beginning with ``what``, for anything else."""
    if isinstance(expression, ca.DM):
        return ca.SX(expression)
    if not isinstance(expression, ca.SX) or expression.shape[1] > 1:
        raise InputError(
            f"{what} is {shown(expression)}",
            "allowed: a column (n,) of type casadi.SX, made of symbols of the context",
        )
    return expression


def _each(what: str, given: object, n: int) -> np.ndarray:
    """A number for each of n rows, from one or n. Raises `InputError`."""
    numbers = np.array(given, dtype=float) if isinstance(given, np.ndarray) else numbers_of(given)
    if numbers.shape not in ((), (1,), (n,)) or (given is None and n):
        raise InputError(f"{what} is {shown(given)}", f"allowed: one number, or {n}, one for each row")
    return np.broadcast_to(numbers, n).copy()


@checked
@dataclass(frozen=True, kw_only=True)
class PointConstraint(DuringPhases, ABC):
    """A constraint at every collocation point of its phases.

    Args:
        during: name of the phase in which it acts, or names of several; default all phases.
    """

    @abstractmethod
    def rows(self, context: Context, units: Units) -> Rows | None:
        """Rows at one point, or None where there is nothing to constrain.

        Args:
            context: symbols of one collocation point; see `Context` for names, frames and units.
            units: natural units of the robot, see `Units`.

        Returns:
            Expression, bounds and natural units of the rows, by `Rows.create`.
        """

    def node_bounds(self, robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
        """Simple bounds at nodes on the local positions and rates: four arrays (nv,), or None."""
        return None

    def limits(self, robot: Robot) -> dict[str, np.ndarray]:
        """Limits that the term replaces in the solution's description, by name; default: none."""
        return {}


@dataclass(frozen=True)
class NodePlace:
    """A node of a phase.

    Args:
        phase: the phase.
        index: index of the node within the phase.
        fractions: all nodes of the phase, as fractions of its duration.
        last: whether the node is the last of the schedule.
        before: the same node as the last of the phase before; None after an impact and inside a phase.
    """

    phase: Phase
    index: int
    fractions: tuple[float, ...]
    last: bool
    before: NodePlace | None = None

    @property
    def fraction(self) -> float:
        """Fraction of the phase's duration at this node, 0 to 1."""
        return self.fractions[self.index]

    @property
    def count(self) -> int:
        """Number of the phase's intervals."""
        return len(self.fractions) - 1

    def nearest(self, fraction: float) -> int:
        """Index of the phase's node nearest to a fraction of it."""
        distances = np.abs(np.array(self.fractions) - fraction)
        return int(np.flatnonzero(distances <= distances.min() + SAME_FRACTION)[0])

    def is_at(self, moment: Moment) -> bool:
        """Whether this is the node nearest to a moment."""
        if moment.phase is None:
            return self.last
        here = self.phase.name == moment.phase and self.index == self.nearest(moment.fraction)
        return here or (self.before is not None and self.before.is_at(moment))

    @property
    def step(self) -> float:
        """Width of the wider interval at this node, as a fraction of the phase's duration."""
        here = slice(max(self.index - 1, 0), self.index + 2)
        return float(np.diff(self.fractions[here]).max())


def nodes_of(phases: Sequence[Phase], index: int, fractions: tuple[float, ...]) -> Iterator[NodePlace]:
    """Nodes of a phase; its last node belongs to the next phase, unless that begins with an impact.

    ``fractions`` gives all nodes of every phase as fractions of its duration.
    """
    phase, count = phases[index], len(fractions) - 1
    ends = index == len(phases) - 1
    before = None
    if index > 0 and not phase.impact:
        before = NodePlace(phases[index - 1], count, fractions, False)
    for k in range(count):
        yield NodePlace(phase, k, fractions, False, None if k else before)
    if ends or phases[index + 1].impact:
        yield NodePlace(phase, count, fractions, ends)


@dataclass(frozen=True, kw_only=True)
class NodeConstraint(Term, ABC):
    """A constraint at some nodes; nodes of one phase at which the same constraints act share a function."""

    def acts_at(self, place: NodePlace) -> bool:
        """Whether the constraint acts at this node; default: at the end of the schedule."""
        return place.last

    @abstractmethod
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        """Rows at the node; only bounds and parameter values may depend on ``place``."""


@checked
@dataclass(frozen=True, kw_only=True)
class AtMoment(Term):
    """A term that acts at one moment, at the node nearest to it.

    Args:
        at: the moment, default the end of the motion; see `start_of`, `middle_of` and `end_of`.

    Raises:
        InputError: for an ``at`` that is not a moment.
    """

    at: Moment = END

    @property
    @override
    def phases(self) -> tuple[str, ...] | None:
        return None if self.at.phase is None else (self.at.phase,)

    def acts_at(self, place: NodePlace) -> bool:
        """Whether ``place`` is the node nearest to the moment."""
        return place.is_at(self.at)
