"""Point functions of a problem's collocation points, nodes and transitions, built from its terms."""

import difflib
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from trajopt.errors import InputError, TrajoptError, first_line, shown
from trajopt.problem.problem import Problem
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.context_symbols import Place
from trajopt.terms.costs import NodeCost
from trajopt.terms.dynamics import ImpactDynamics
from trajopt.terms.interfaces import Cost, PointConstraint, Rows, Term, column
from trajopt.terms.moments import MomentConstraint
from trajopt.transcription.layout import Layout
from trajopt.transcription.redundancy import independent_rows
from trajopt.transcription.stage_functions import PointFunction, point_function
from trajopt.transcription.timeline import NodeLayout

# Symbols of a context by other words for them.
SYMBOLS = {
    **dict.fromkeys(("configuration", "position"), "q"),
    **dict.fromkeys(("velocity", "qd", "dq"), "v"),
    **dict.fromkeys(("acceleration", "qdd", "ddq"), "a"),
    **dict.fromkeys(("tau", "effort"), "torque"),
    **dict.fromkeys(("force", "contact_forces"), "wrenches"),
}


@dataclass(frozen=True)
class StageTerms:
    """A point function with its rows and parameters.

    Args:
        function: the point function.
        blocks: name and rows (bounds, units) of each block.
        parameters_at: values (n_p,) of the parameters at a nominal time in s.
        varying: see `Parameters.varying_columns`.
    """

    function: PointFunction
    blocks: tuple[tuple[str, Rows], ...]
    parameters_at: Callable[[float], np.ndarray]
    varying: tuple[tuple[Callable[[float], np.ndarray], slice], ...] = ()

    @property
    def row_scale(self) -> np.ndarray:
        """One over the unit of every row."""
        return np.concatenate([np.zeros(0), *[1 / rows.unit for _, rows in self.blocks]])


@dataclass(frozen=True)
class TermFunctions:
    """Point functions of one transcription; ``units`` are keyed by ``id(robot)``."""

    problem: Problem
    layout: Layout
    units: Mapping[int, Units]
    _kept: dict[int, dict[str, tuple[int, ...]]] = field(default_factory=dict, init=False)
    # Each term that states something, by identity, and whether it can vary.
    _effects: dict[int, tuple[Term, bool]] = field(default_factory=dict, init=False)

    def point(self, phase: int) -> StageTerms:
        """Function of a phase's collocation points."""
        form = self.layout.form_of(phase)
        units, context = self.units[id(form.robot)], self.context(phase, form, Place.POINT)
        name, problem = self.problem.schedule.phases[phase].name, self.problem
        costs = [self._result(t, name, t.value, context, units) for t in problem.costs if t.acts_in(name)]
        acting = [term for term in problem.point_constraints if term.acts_in(name)]
        rows = [(t.name, self._result(t, name, t.rows, context, units)) for t in acting]
        return _stage_terms(name, context, context.time_scale * sum(costs, ca.SX(0)), rows)

    def impact(self, k: int) -> StageTerms:
        """Function of the impact at stage k: the impact dynamics, and terms on contact forces."""
        phase, form = self.layout.stages[k].phase, self.layout.forms[k]
        units = self.units[id(form.robot)].impulsive()
        context = self.context(phase, form, Place.IMPACT)
        name, problem = self.problem.schedule.phases[phase].name, self.problem
        costs = [
            self._result(t, name, t.value, context, units) for t in problem.impact_costs if t.acts_in(name)
        ]
        acting = [t for t in problem.point_constraints if t.acts_in(name) and t.acts_at_impacts]
        rows = [(t.name, self._result(t, name, t.rows, context, units)) for t in (ImpactDynamics(), *acting)]
        return _stage_terms(f"impact_{name}", context, sum(costs, ca.SX(0)), rows)

    def nodes(self) -> dict[int, StageTerms]:
        """Function, named rows and parameter values of each node with constraints or costs."""
        functions: dict[tuple[object, ...], PointFunction] = {}
        at_nodes, constraints, prices = {}, self.problem.node_constraints, self.problem.node_costs
        for k, form in enumerate(self.layout.forms):
            place, phase = self.layout.place(k), self.layout.place_phase(k)
            acting = [t for t in constraints if place is not None and t.acts_at(place)]
            priced = [t for t in prices if place is not None and t.acts_at(place)]
            if place is None or not (acting or priced):
                continue
            units, near = self.units[id(form.robot)], self._unwrapped_guess.get(k)
            context = self.context(phase, form, Place.NODE, near, partial(self._guess_at, k))
            name = place.phase.name
            named = [(t.name, self._result(t, name, t.rows, context, units, place)) for t in acting]
            cost = sum((self._result(t, name, t.value, context, units, place) for t in priced), ca.SX(0))
            key = (id(form), name, *(id(term) for term in (*acting, *priced)))
            terms = _stage_terms(f"node_{name}", context, cost, named, functions.get(key))
            if terms.blocks or priced:
                functions[key] = terms.function
                at_nodes[k] = terms
        return at_nodes

    def moment(self, term: MomentConstraint) -> StageTerms:
        """Function of a constraint at moments of a phase; each moment has its own parameters."""
        phase = self.problem.schedule.names.index(term.during)
        form = self.layout.form_of(phase)
        loaded = [contact for contact in self.layout.contacts[phase] if contact.name in term.loads]
        if len(loaded) < len(term.loads):
            raise InputError(
                f"{term.name} in phase '{term.during}' is about the force of {', '.join(term.loads)}",
                f"active: {', '.join(contact.name for contact in self.layout.contacts[phase]) or 'none'}",
            )
        context = Context(
            form.robot,
            form.coordinates,
            tuple(loaded),
            time_scales=(form.n_time_scales, form.time_scale),
            actuation=self.problem.actuation,
            surfaces=self.problem.surfaces_of(phase),
            mode=self.problem.modes.get(term.during),
        )
        parameters = context.parameter(np.zeros(term.parameters.shape[1]))
        rows = self._result(term, term.during, term.row, context, self.units[id(form.robot)], parameters)
        return _stage_terms(f"moment_{term.name}", context, ca.SX(0), [(term.name, rows)])

    def end(self, form: NodeLayout) -> PointFunction | None:
        """Rotations, and body rates and their rates if any, from (rotations, theta, theta', theta'')."""
        n = form.coordinates.n_rotations
        if n == 0:
            return None
        z = ca.SX.sym("z", (4 + 3 * form.order) * n)
        full = ca.vertcat(z, ca.SX.zeros(3 * (3 - form.order) * n))
        theta, rates, second = ca.vertsplit(full[4 * n :], 3 * n)
        parts = form.coordinates.next_rotations(z[: 4 * n], theta, rates, second)
        return _plain("interval_end", z, parts[: form.order])

    def change(self, k: int) -> PointFunction:
        """Map from node k to the next node, which has other coordinates or rates in another time scale."""
        before, after = self.layout.forms[k], self.layout.forms[k + 1]
        phase = self.layout.stages[k].phase
        context = self.context(phase, before, Place.NODE)
        time_scales = context.z[before.time_scales.tolist()] if before.n_time_scales else ca.SX(0, 1)
        if after.coordinates is before.coordinates:
            n = len(before.rotations) + len(before.additive)
            configuration, rates = context.z[:n], context.rates
        else:
            state = self._mapped(context, before, after)
            n = state.numel() - after.coordinates.nv
            configuration, rates = state[:n], state[n:]
        ratio = ca.SX(1) if after.time_scale is None else time_scales[after.time_scale]
        parts = [configuration, ratio * rates, ratio**2 * context.second][: after.order]
        return _plain("change", context.z, [*parts, time_scales])

    def _mapped(self, context: Context, before: NodeLayout, after: NodeLayout) -> ca.SX:
        """State after a change of coordinates, from the symbols before it: a mode's lift or drop."""
        whole = after.robot is self.problem.robot
        mode = next(m for m in self.problem.modes.values() if m.robot is (before if whole else after).robot)
        still = ca.SX.zeros(before.coordinates.nv)
        state = (context.q, context.v, still)
        q, v, *_ = mode.lift(*state, mode.anchor) if whole else mode.drop(*state)
        shared = {joint.name: context.xi[joint.v] for joint in before.coordinates.joints if joint.is_counted}
        return after.coordinates.symbolic_node(q, v, shared)

    def require_effects(self) -> None:
        """Raise `InputError` for a term whose rows or residuals are constant wherever it acts."""
        for term, varies in self._effects.values():
            if not varies:
                raise InputError(
                    f"{term.name} cannot vary: it depends neither on the motion nor on forces",
                    "allowed: expressions of the context's symbols; torques, wrenches and frames are symbols"
                    " of their own, and context.rate(...) differentiates along the motion",
                )

    def _result(
        self, term: Term, phase: str, build: Callable[..., Any], context: Context, *more: object
    ) -> Any:
        """The result of a term's method, see `result_of`; records whether it can vary.

        A constant cost other than zero is a price of time.
        """
        if self._effects.get(id(term), (term, False))[1]:
            return result_of(term, phase, build, context, *more)
        before = context.squares[0].numel()
        result = result_of(term, phase, build, context, *more)
        expression = result.expression if isinstance(result, Rows) else result
        if expression is None or expression.numel() == 0:
            return result
        varies = context.varies(expression)
        states = isinstance(result, Rows)
        if not states and expression.is_zero():  # a residual that is zero, not one without entries
            own = getattr(type(term), "value", None) not in (Cost.value, NodeCost.value)
            states = own or context.squares[0].numel() > before
        if varies or states:
            self._effects[id(term)] = term, varies
        return result

    def redundant(self) -> dict[str, list[str]]:
        """Return the names of the redundant contact rows, which are left out, by phase."""
        axes, left_out = ("x", "y", "z", "rx", "ry", "rz"), {}
        for index, phase in enumerate(self.problem.schedule.phases):
            kept = self.kept_rows(index)
            left = [
                f"{contact.name} {axes[row]}"
                for contact in self.layout.contacts[index]
                for row in contact.rows
                if row not in kept.get(contact.name, contact.rows)
            ]
            if left:
                left_out[phase.name] = left
        return left_out

    def kept_rows(self, phase: int) -> dict[str, tuple[int, ...]]:
        """Rows of the contacts' motion imposed in a phase, judged at its guess; see ``redundancy``."""
        if phase not in self._kept:
            self._kept[phase] = self._independent(phase)
        return self._kept[phase]

    def _independent(self, phase: int) -> dict[str, tuple[int, ...]]:
        layout, form = self.layout, self.layout.form_of(phase)
        kept = self.problem.schedule.kept_contacts(phase) if phase else ()
        contacts = layout.contacts[phase] if form.robot is not layout.robot else layout.touching[phase]
        before = [contact for contact in contacts if contact.name in kept]
        after = [contact for contact in contacts if contact.name not in kept]
        first, last = layout.intervals_of(phase)[[0, -1]]
        q = self.problem.guess_at(float(layout.node_times[first] + layout.node_times[last + 1]) / 2)
        q = self._in_coordinates_of(form, q)
        known = {c.name: self.problem.contact_place(c.name, phase) for c in contacts}
        places = {name: place for name, place in known.items() if place is not None}
        return independent_rows(form.robot, q, before, after, places, self.problem.levers[phase])

    def _in_coordinates_of(self, form: NodeLayout, q: np.ndarray) -> np.ndarray:
        return self.layout.in_coordinates_of(form, q, *np.zeros((2, self.layout.robot.nv)))[0]

    def _guess_at(self, k: int) -> np.ndarray:
        """The guess (nq,) at node k, in the coordinates of its form."""
        time = float(self.layout.node_times[k])
        return self._in_coordinates_of(self.layout.forms[k], self.problem.guess_at(time))

    @cached_property
    def _unwrapped_guess(self) -> dict[int, np.ndarray]:
        """The guess at nodes whose coordinates count whole turns; goals refer to the turn nearest to it.

        So a motion whose guess makes a full turn ends after that turn, and does not turn back past pi.
        """
        nearby: dict[int, np.ndarray] = {}
        before: dict[int, np.ndarray] = {}
        for k, form in enumerate(self.layout.forms):
            coordinates = form.coordinates
            if not any(joint.kind in ("planar", "continuous") for joint in coordinates.joints):
                continue
            fixed = k == 0 and self.problem.periodicity is None
            time = float(self.layout.node_times[k])
            q = self._in_coordinates_of(
                form, self.problem.initial_q if fixed else self.problem.guess_at(time)
            )
            node = coordinates.node_from_pinocchio(q, np.zeros(coordinates.nv))
            nearby[k] = coordinates.continued(node, before.get(id(coordinates), node))
            before[id(coordinates)] = nearby[k]
        return nearby

    def context(
        self,
        phase: int,
        form: NodeLayout,
        place: Place,
        near: np.ndarray | None = None,
        guess: Callable[[], np.ndarray] | None = None,
    ) -> Context:
        """Fresh symbols for a point, node or impact of a phase."""
        contacts = {Place.POINT: self.layout.contacts, Place.IMPACT: self.layout.touching}
        name = self.problem.schedule.phases[phase].name
        return Context(
            self.problem.robot_in(name) if name in self.problem.payloads else form.robot,
            form.coordinates,
            contacts[place][phase] if place in contacts else (),
            place=place,
            time_scales=(form.n_time_scales, form.time_scale),
            actuation=self.problem.actuation,
            surfaces=self.problem.surfaces_of(phase),
            kept_rows=self.kept_rows(phase),
            mode=self.problem.modes.get(name),
            near=near,
            guess=guess,
            given=self.problem.wrenches,
        )


def _stage_terms(
    name: str,
    context: Context,
    cost: ca.SX,
    named: Sequence[tuple[str, Rows | None]],
    known: PointFunction | None = None,
) -> StageTerms:
    """Terms over a context; ``known`` is the function of the same terms at another node."""
    blocks = tuple((label, rows) for label, rows in named if rows is not None and rows.expression.numel())
    function = known or point_function(name, context, cost, [rows.expression for _, rows in blocks])
    return StageTerms(function, blocks, context.parameter_values_at, context.varying_columns)


def _plain(name: str, z: ca.SX, parts: Sequence[ca.SX]) -> PointFunction:
    """A point function of its inputs alone: no robot, no parameters, no cost."""
    phi = ca.densify(ca.vertcat(*parts))
    return PointFunction(
        name, (), ca.Function("terms", [z, ca.SX.sym("o", 0), ca.SX.sym("p", 0)], [ca.SX(0), phi])
    )


def result_of(term: Term, phase: str, build: Callable[..., Any], context: Context, *more: object) -> Any:
    """Checked result of a term's method ``build`` in a phase.

    Raises:
        InputError: with the term's name, if the method fails or returns something that is not allowed.
    """
    method = build.__name__
    try:
        result = build(context, *more)
        return _value(method, result, context) if method == "value" else _rows(term, method, result, context)
    except InputError as error:
        if type(error) is not InputError:
            raise
        raise InputError(f"{term.name} in phase '{phase}': {error.what}", error.allowed) from None
    except TrajoptError:
        raise
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        what = f"{method}() of {term.name} in phase '{phase}' fails with {type(error).__name__}"
        where = f"{Path(place.filename).name}, line {place.lineno}"
        raise InputError(f"{what}: {first_line(error)}", f"{_meant(error)}in {where}") from error


def _meant(error: Exception) -> str:
    """A suggestion for an unknown attribute of a context or of what it has; else empty."""
    if not isinstance(error, AttributeError):
        return ""
    known = {name: name for name in dir(error.obj) if not name.startswith("_")}
    if of_context := isinstance(error.obj, Context):
        known |= SYMBOLS
    close = difflib.get_close_matches(str(error.name), known, 1)
    return f"did you mean {'context.' * of_context}{known[close[0]]}? " if close else ""


def _value(method: str, result: Any, context: Context) -> ca.SX:
    value = ca.SX(result) if isinstance(result, int | float) and not isinstance(result, bool) else result
    if not isinstance(value, ca.SX | ca.DM) or value.numel() != 1:
        raise InputError(f"{method}() returns {shown(result)}", "allowed: a casadi.SX of one entry")
    value = ca.SX(value)
    _require_known(value, context)
    return value


def _rows(term: Term, method: str, result: Any, context: Context) -> Rows | None:
    if result is None and isinstance(term, PointConstraint):
        return None
    if not isinstance(result, Rows):
        allowed = "allowed: Rows.create(expression, lower, upper, unit)"
        allowed += ", or None where nothing is constrained" if isinstance(term, PointConstraint) else ""
        raise InputError(f"{method}() returns {shown(result)}", allowed)
    expression = column("expression of Rows", result.expression)
    for name in ("lower", "upper", "unit"):
        count = len(getattr(result, name))
        if count != expression.numel():
            allowed = f"allowed: {expression.numel()}, one for each row"
            raise InputError(f"{name} of Rows has {count} numbers", allowed)
    _require_known(expression, context)
    return result


def _require_known(expression: ca.SX, context: Context) -> None:
    """Raise `InputError` for symbols that do not belong to the context."""
    known = [context.z, context.robot_symbols(), context.force_rates, context.parameters]
    free = ca.Function("known", known, [expression], {"allow_free": True}).free_sx()
    if len(free):
        names = ", ".join(dict.fromkeys(str(symbol) for symbol in free))
        raise InputError(
            f"the expression depends on {names}, which the context does not have",
            "allowed: symbols of the context, and numbers as context.parameter(...)",
        )
