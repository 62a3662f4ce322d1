"""Terms of a whole robot on the motion of its reduced robot.

`TerminalState` requires N^T D^-1 e = 0 of the error e, N the directions that contacts leave free. If the
goal's contacts are not where the motion's are, its meaning depends on N. So a half requires the same of the
whole robot's error: of its rows A = N^T D^-1 E, with E from the half's rates to the whole's, the left
singular vectors of the r largest singular values, r the number of directions that the half's own contacts
leave free (`HalfEnd`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.robot.units import Units
from trajopt.scenes.reduction import Reduction, whole_place
from trajopt.scenes.view import WholeView
from trajopt.terms.context import Context
from trajopt.terms.context_symbols import Place
from trajopt.terms.interfaces import Cost, PointConstraint, Rows, Term
from trajopt.terms.node_costs import NodeCost
from trajopt.terms.node_interfaces import NodeConstraint, NodePlace
from trajopt.terms.terminal import TerminalRest, TerminalState, free_directions, guessed_posture
from trajopt.transcription.robot_layers import robot_layers

# Random points at which rows are compared, and the rounding difference of equal rows, natural units.
SAMPLES = 3
SAME = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class _WholeTerm(Term):
    """A term of the whole robot, under its own name, and the reduction to the small one."""

    term: Term
    reduction: Reduction

    @property
    @override
    def name(self) -> str:
        return self.term.name


@dataclass(frozen=True, kw_only=True)
class WholeCost(_WholeTerm, Cost):
    """A running cost of the whole robot, on the motion of the small one."""

    term: Cost

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        return self.term.residual(WholeView(context, self.reduction), self._units(context))

    @override
    def value(self, context: Context, units: Units) -> ca.SX:
        return self.term.value(WholeView(context, self.reduction), self._units(context))

    def _units(self, context: Context) -> Units:
        units = Units(self.reduction.whole)
        return units.impulsive() if context.place is Place.IMPACT else units


@dataclass(frozen=True, kw_only=True)
class WholeImpactCost(WholeCost):
    """The same for a cost of impacts."""

    acts_at_points: ClassVar[bool] = False
    acts_at_impacts: ClassVar[bool] = True


@dataclass(frozen=True, kw_only=True, eq=False)
class WholePointRows(_WholeTerm, PointConstraint):
    """A point constraint of the whole robot on the small one's motion, without redundant rows."""

    term: PointConstraint

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        found = self.term.rows(WholeView(context, self.reduction), Units(self.reduction.whole))
        return None if found is None else binding_rows(found, context)


@dataclass(frozen=True, kw_only=True, eq=False)
class WholeNodeCost(_WholeTerm, NodeCost):
    """A cost at nodes of the whole robot, on the motion of the small one."""

    term: NodeCost

    @override
    def acts_at(self, place: NodePlace) -> bool:
        return self.term.acts_at(place)

    @override
    def quantity(self, context: Context, units: Units, place: NodePlace) -> ca.SX:
        view, own = WholeView(context, self.reduction), Units(self.reduction.whole)
        return self.term.quantity(view, own, whole_place(place, self.reduction))


@dataclass(frozen=True, kw_only=True, eq=False)
class WholeNodeRows(_WholeTerm, NodeConstraint):
    """A node constraint of the whole robot on the small one's motion, without redundant rows."""

    term: NodeConstraint

    @override
    def acts_at(self, place: NodePlace) -> bool:
        return self.term.acts_at(place)

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        return binding_rows(self._whole_rows(context, place), context)

    def _whole_rows(self, context: Context, place: NodePlace) -> Rows:
        view, own = WholeView(context, self.reduction), Units(self.reduction.whole)
        return self.term.rows(view, own, whole_place(place, self.reduction))


@dataclass(frozen=True, kw_only=True, eq=False)
class HalfEnd(WholeNodeRows):
    """`TerminalState` or `TerminalRest` of the whole robot on the motion of its half."""

    term: TerminalState | TerminalRest

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        if self.term.q is None:
            q = self.reduction.lift_q(guessed_posture(context))
            return replace(self, term=replace(self.term, q=q)).rows(context, units, place)
        combined = context.parameter(self._combinations(place, self.term.q)).T
        return Rows.create(ca.mtimes(combined, self._whole_rows(context, place).expression), 0, 0, 1.0)

    def _combinations(self, place: NodePlace, goal: np.ndarray) -> np.ndarray:
        reduction, q = self.reduction, np.asarray(goal, dtype=float)
        position = Units(reduction.whole).position
        free = free_directions(reduction.whole, q, whole_place(place, reduction).phase.contacts)
        small = free_directions(reduction.small, reduction.drop_q(q), place.phase.contacts)
        left = np.linalg.svd(free.T @ (reduction.rates / position[:, None]))[0]
        return np.asarray(left[:, : small.shape[1]])


def binding_rows(rows: Rows, context: Context) -> Rows:
    """Return the rows without duplicates and without those that the small robot always satisfies.

    Found from values and gradients at random points: rows that agree at all of them, up to rounding, agree
    everywhere, since the functions are analytic.
    """
    function = _values_and_gradients(ca.SX(rows.expression) / ca.DM(rows.unit), context)
    generator = np.random.default_rng(0)
    sampled = [np.array(function(_random_inputs(context, generator))) for _ in range(SAMPLES)]
    lower, upper = rows.lower / rows.unit, rows.upper / rows.unit
    chosen: list[int] = []
    for i in range(len(lower)):
        own = np.array([sample[i] for sample in sampled])
        fixed = np.abs(own[:, 1:]).max(initial=0.0) < SAME and lower[i] - SAME <= own[0, 0] <= upper[i] + SAME
        repeated = any(
            np.abs(own - [sample[j] for sample in sampled]).max() < SAME
            and (lower[i], upper[i]) == (lower[j], upper[j])
            for j in chosen
        )
        if not (fixed or repeated):
            chosen.append(i)
    return Rows(rows.expression[chosen], rows.lower[chosen], rows.upper[chosen], rows.unit[chosen])


def _values_and_gradients(expression: ca.SX, context: Context) -> ca.Function:
    """Function z -> (n, 1 + n_z) of values and gradients of rows at the parameters' present values."""
    o, layers = robot_layers(context, expression)
    terms = ca.Function("terms", [context.z, o, context.parameters], [expression])
    z = value = ca.SX.sym("z", context.z.numel())
    for layer in layers:
        value = layer(value)
    found = terms(z, value if layers else ca.SX(0, 1), ca.DM(context.parameter_values))
    return ca.Function("rows", [z], [ca.densify(ca.horzcat(found, ca.jacobian(found, z)))])


def _random_inputs(context: Context, generator: np.random.Generator) -> np.ndarray:
    """Inputs of a point with unit rotations and positive time scales."""
    z = generator.uniform(0.1, 1.0, context.z.numel())
    for i in range(context.coordinates.n_rotations):
        z[4 * i : 4 * i + 4] /= np.linalg.norm(z[4 * i : 4 * i + 4])
    return z
