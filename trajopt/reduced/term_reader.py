"""What terms ask of a robot: their expressions in every phase, read by their symbols.

Nothing is known about a term but what it does: it is written over a context in each phase, at points, nodes
and impacts, and the symbols in what it returns say which frames, joints, torques and contacts it uses.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.dynamics.manifold import Coordinates
from trajopt.problem.problem import Problem
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.context_symbols import Actuation, Place
from trajopt.terms.interfaces import Cost, PointConstraint, Rows, Term
from trajopt.terms.node_interfaces import NodeConstraint, NodePlace
from trajopt.transcription.mesh import equal_fractions
from trajopt.transcription.robot_layers import robot_layers

# Nodes of a phase at which node terms are read: its ends, and three between.
NODE_INTERVALS = 4


@dataclass(frozen=True, eq=False)
class TermInstance:
    """A term at one place: its context, and its rows or the value of its cost."""

    term: Term
    phase: int
    context: Context
    node: NodePlace | None
    rows: Rows | None

    @property
    def expression(self) -> ca.SX:
        """Rows over their units, or the cost."""
        if self.rows is not None:
            return ca.SX(self.rows.expression) / ca.DM(self.rows.unit)
        return ca.SX(0, 1)

    @cached_property
    def _symbols(self) -> set[int]:
        return {symbol.element_hash() for symbol in ca.symvar(self.expression)}

    def uses(self, expression: ca.SX) -> bool:
        """Whether any symbol of ``expression`` is in the term's own."""
        return any(symbol.element_hash() in self._symbols for symbol in ca.symvar(expression))

    @cached_property
    def frames(self) -> tuple[str, ...]:
        """Frames that the term uses."""
        return tuple(name for name, frame in self.context.frames.items() if self.uses(frame.stacked()))

    def rates(self) -> np.ndarray:
        """Which coordinates, rates or accelerations (nv,) the term uses themselves."""
        context, nv = self.context, self.context.coordinates.nv
        second = self._second()
        return np.array(
            [self.uses(ca.vertcat(context.xi[i], context.rates[i], second[i])) for i in range(nv)]
        )

    def _second(self) -> ca.SX:
        order = self.context.actuation != "velocity" and self.context.place is Place.POINT
        return self.context.ddxi if order else ca.SX.zeros(self.context.coordinates.nv)

    @property
    def uses_dynamics(self) -> bool:
        """Whether generalised forces are in it."""
        return self.context.uses_dynamics and self.uses(self.context.generalized_forces)

    @property
    def uses_torques(self) -> bool:
        """Whether generalised forces of actuated joints are in it."""
        unactuated = self.context.robot.n_unactuated
        return self.uses_dynamics and self.uses(self.context.generalized_forces[unactuated:])

    def function(self) -> ca.Function:
        """The expression as a function of the place's inputs z."""
        expression = self.expression
        o, layers = robot_layers(self.context, expression)
        terms = ca.Function("terms", [self.context.z, o, self.context.parameters], [expression])
        z = ca.SX.sym("z", self.context.z.numel())
        value = z
        for layer in layers:
            value = layer(value)
        found = value if layers else ca.SX(0, 1)
        values = [self.context.parameter_values_at(t) for t in self._moments]
        return ca.Function("asked", [z], [ca.vertcat(*[terms(z, found, ca.DM(own)) for own in values])])

    @property
    def _moments(self) -> tuple[float, ...]:
        """Times at which the parameters are read, s: rows have none that vary."""
        return (0.0,)


@dataclass(frozen=True, eq=False)
class CostInstance(TermInstance):
    """A cost at one place, read at some ``times``, s: what it follows may vary."""

    value: ca.SX
    times: tuple[float, ...]

    @property
    @override
    def expression(self) -> ca.SX:
        return self.value

    @property
    @override
    def _moments(self) -> tuple[float, ...]:
        return self.times


class TermReader:
    """Reads the terms of a problem without modes, as its transcription will."""

    def __init__(self, problem: Problem, actuation: Actuation | None = None) -> None:
        self.problem, self.actuation = problem, actuation or problem.actuation
        self.coordinates, self.units = Coordinates(problem.robot.model), Units(problem.robot)
        self.clocks = problem.schedule.clocks
        self.n_clocks = sum(clock is not None for clock in self.clocks)

    def context(self, phase: int, place: Place) -> Context:
        """A fresh context of the whole robot in a phase."""
        robot, where = self.problem.robot, self.problem.schedule.phases[phase]
        active = () if place is Place.NODE else tuple(robot.contact(name) for name in where.contacts)
        return Context(
            robot,
            self.coordinates,
            active,
            place=place,
            clocks=(self.n_clocks, self.clocks[phase]),
            actuation=self.actuation,
            surfaces=self.problem.surfaces_of(phase),
        )

    def every(self, *, dynamics: bool = True) -> Iterator[TermInstance]:
        """Every term where it acts; ``dynamics`` also the rows that are always there."""
        rows = self.problem.motion_rows if dynamics else ()
        own = [term for term in self.problem.terms if isinstance(term, Cost | PointConstraint)]
        for phase, where in enumerate(self.problem.schedule.phases):
            for term in (*rows, *own):
                if not term.acts_in(where.name):
                    continue
                if term.acts_at_points:
                    yield self.read(term, phase, Place.POINT)
                if term.acts_at_impacts and where.impact:
                    yield self.read(term, phase, Place.IMPACT)
            yield from self.nodes(phase)

    def read(self, term: Cost | PointConstraint, phase: int, place: Place) -> TermInstance:
        """A cost or a point constraint in a phase."""
        context = self.context(phase, place)
        units = self.units.impulsive() if place is Place.IMPACT else self.units
        if isinstance(term, Cost):
            return CostInstance(
                term, phase, context, None, None, term.value(context, units), self.times(phase)
            )
        return TermInstance(term, phase, context, None, term.rows(context, units))

    def nodes(self, phase: int) -> Iterator[TermInstance]:
        """Node constraints and costs in a phase, at the first node where they act and at one more inside."""
        phases = self.problem.schedule.phases
        for index in range(NODE_INTERVALS + (phase == len(phases) - 1)):
            last = index == NODE_INTERVALS
            place = NodePlace(
                phases[phase], index, equal_fractions(NODE_INTERVALS), last, phase == len(phases) - 1
            )
            for term in self.problem.node_constraints:
                if term.acts_at(place):
                    yield self.node(term, phase, place)
            for cost in self.problem.node_costs:
                if cost.acts_at(place):
                    context = self.context(phase, Place.NODE)
                    value = cost.value(context, self.units, place)
                    yield CostInstance(cost, phase, context, place, None, value, self.times(phase))

    def times(self, phase: int) -> tuple[float, ...]:
        """Nominal times in a phase at which costs are read, s: its ends, and some between."""
        durations = [where.duration for where in self.problem.schedule.phases]
        start = sum(durations[:phase])
        return tuple(start + i / NODE_INTERVALS * durations[phase] for i in range(NODE_INTERVALS + 1))

    def node(self, term: NodeConstraint, phase: int, place: NodePlace) -> TermInstance:
        """A node constraint at one node."""
        context = self.context(phase, Place.NODE)
        return TermInstance(term, phase, context, place, term.rows(context, self.units, place))
