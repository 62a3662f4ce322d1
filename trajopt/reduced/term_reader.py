"""What each term uses of a robot, found from the symbols in its expressions.

Every term is evaluated on a context in each phase, at points, nodes and impacts. The symbols in the result
show which frames, joints, torques and contacts it uses.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from trajopt.dynamics.manifold import Coordinates
from trajopt.problem.problem import Problem
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.context_symbols import Place
from trajopt.terms.costs import NodeCost
from trajopt.terms.interfaces import Cost, NodeConstraint, NodePlace, PointConstraint, Rows, Term, nodes_of
from trajopt.transcription.mesh import equal_fractions
from trajopt.transcription.robot_layers import robot_layers

# Intervals of a phase at whose ends node terms are evaluated: five nodes.
NODE_INTERVALS = 4


@dataclass(frozen=True, eq=False)
class TermInstance:
    """A term at one place, with its context.

    expression: rows over their units, or the value of a cost. rows: None for a cost, and where the term has
    no rows. times: times at which parameters are read, s; those of a cost may vary.
    """

    term: Term
    phase: int
    context: Context
    node: NodePlace | None
    expression: ca.SX
    rows: Rows | None = None
    times: tuple[float, ...] = (0.0,)

    @cached_property
    def _symbols(self) -> set[int]:
        return {symbol.element_hash() for symbol in ca.symvar(self.expression)}

    def uses(self, expression: ca.SX) -> bool:
        """Whether the term contains any symbol of ``expression``."""
        return any(symbol.element_hash() in self._symbols for symbol in ca.symvar(expression))

    @cached_property
    def frames(self) -> tuple[str, ...]:
        """Frames used by the term."""
        return tuple(name for name, frame in self.context.frames.items() if self.uses(frame.stacked()))

    def rates(self) -> np.ndarray:
        """Return which coordinates (nv,) the term uses directly, or their rates or accelerations."""
        context, nv = self.context, self.context.coordinates.nv
        accelerates = context.actuation != "velocity" and context.place is Place.POINT
        second = context.ddxi if accelerates else ca.SX.zeros(nv)
        used = [self.uses(ca.vertcat(context.xi[i], context.rates[i], second[i])) for i in range(nv)]
        return np.array(used)

    @property
    def uses_dynamics(self) -> bool:
        """Whether the term uses generalised forces."""
        return self.context.uses_dynamics and self.uses(self.context.generalized_forces)

    @property
    def uses_torques(self) -> bool:
        """Whether the term uses generalised forces of actuated joints."""
        rows = np.flatnonzero(self.context.robot.actuation.matrix.any(axis=1)).tolist()
        return self.uses_dynamics and self.uses(self.context.generalized_forces[rows])

    def function(self) -> ca.Function:
        """Return the expression as a function of the place's inputs z, for all times in one column."""
        values = [self.context.parameter_values_at(t) for t in self.times]
        z, expressions = on_inputs(self.context, self.expression, values)
        return ca.Function("instance", [z], [ca.vertcat(*expressions)])


def on_inputs(context: Context, expression: ca.SX, values: Sequence[np.ndarray]) -> tuple[ca.SX, list[ca.SX]]:
    """Return new symbols for a context's inputs z, and the expression in them for each of ``values``."""
    symbols, layers = robot_layers(context, expression)
    terms = ca.Function("terms", [context.z, symbols, context.parameters], [expression])
    z = value = ca.SX.sym("z", context.z.numel())
    for layer in layers:
        value = layer(value)
    quantities = value if layers else ca.SX(0, 1)
    return z, [terms(z, quantities, ca.DM(parameters)) for parameters in values]


class TermReader:
    """Evaluates the terms of a problem without modes as its transcription does."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.coordinates, self.units = Coordinates(problem.robot.model), Units(problem.robot)
        self.time_scales = problem.schedule.time_scales
        self.n_time_scales = sum(index is not None for index in self.time_scales)

    def every(self) -> Iterator[TermInstance]:
        """Yield every term at each place where it acts, without the problem's dynamics."""
        terms = [term for term in self.problem.terms if isinstance(term, Cost | PointConstraint)]
        at_nodes: list[NodeConstraint | NodeCost] = list(self.problem.node_constraints)
        at_nodes += self.problem.node_costs
        for phase, where in enumerate(self.problem.schedule.phases):
            for term in terms:
                if not term.acts_in(where.name):
                    continue
                if term.acts_at_points:
                    yield self._instance(term, phase, Place.POINT)
                if term.acts_at_impacts and where.impact:
                    yield self._instance(term, phase, Place.IMPACT)
            for node in nodes_of(self.problem.schedule.phases, phase, equal_fractions(NODE_INTERVALS)):
                for acting in at_nodes:
                    if acting.acts_at(node):
                        yield self._instance(acting, phase, Place.NODE, node)

    def _instance(self, term: Any, phase: int, place: Place, node: NodePlace | None = None) -> TermInstance:
        robot, where = self.problem.robot, self.problem.schedule.phases[phase]
        context = Context(
            robot,
            self.coordinates,
            () if place is Place.NODE else tuple(robot.contact(name) for name in where.contacts),
            place=place,
            time_scales=(self.n_time_scales, self.time_scales[phase]),
            actuation=self.problem.actuation,
            surfaces=self.problem.surfaces_of(phase),
        )
        units = self.units.impulsive() if place is Place.IMPACT else self.units
        arguments = (context, units) if node is None else (context, units, node)
        if isinstance(term, Cost | NodeCost):
            value = term.value(*arguments)
            durations = [each.duration for each in self.problem.schedule.phases]
            parts = [i / NODE_INTERVALS * durations[phase] for i in range(NODE_INTERVALS + 1)]
            times = tuple(sum(durations[:phase]) + part for part in parts)
            return TermInstance(term, phase, context, node, value, times=times)
        rows = term.rows(*arguments)
        expression = ca.SX(0, 1) if rows is None else ca.SX(rows.expression) / ca.DM(rows.unit)
        return TermInstance(term, phase, context, node, expression, rows)
