"""The first value or derivative that is not finite: its term, its place, and the inputs that cause it."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from trajopt.terms.context_symbols import Place
from trajopt.transcription.names import NlpNames, StagePoint
from trajopt.transcription.nlp import Nlp
from trajopt.transcription.stage_functions import Derivatives, PointFunction, point_function
from trajopt.transcription.symbols import (
    Label,
    coordinate_labels,
    input_labels,
    node_labels,
    rotation_labels,
)
from trajopt.transcription.timeline import NodeLayout, StageKind
from trajopt.transcription.transcription import FunctionGroup, Transcription

Evaluation = Callable[[np.ndarray], np.ndarray]


def nonfinite_terms(
    names: NlpNames, site: StagePoint, form: NodeLayout, place: Place, inputs: np.ndarray
) -> list[tuple[str, Evaluation]]:
    """Return the terms with non-finite values at z = ``inputs``, with their functions.

    If all values are finite, these are the terms with non-finite derivatives.
    """
    made = list(_terms(names, site, form, place))
    for kind in (value_function, derivative_function):
        evaluations = [(name, kind(function, parameters)) for name, function, parameters in made]
        guilty = [(name, value) for name, value in evaluations if not np.isfinite(value(inputs)).all()]
        if guilty:
            return guilty
    return []


def value_function(function: PointFunction, parameters: np.ndarray) -> Evaluation:
    """Return all values of a point function at z in one column."""

    def values(z: np.ndarray) -> np.ndarray:
        o = function.robot_inputs(ca.DM(z), ca.DM(parameters))
        for layer in function.layers:
            o = layer(o)
        outputs = function.terms(z, o if function.layers else ca.DM(0, 1), parameters)
        return np.concatenate([np.array(part).ravel() for part in outputs])

    return values


def derivative_function(function: PointFunction, parameters: np.ndarray) -> Evaluation:
    """Return all first and second derivatives of a point function at z in one column."""
    made = Derivatives(function)
    first, second, ones = made.first, made.second, np.ones(function.n_rows)

    def slopes(z: np.ndarray) -> np.ndarray:
        parts = [*first(z, parameters), second(z, parameters, 1.0, ones)]
        return np.concatenate([np.array(ca.DM(part).nonzeros()) for part in parts])

    return slopes


def _terms(
    names: NlpNames, site: StagePoint, form: NodeLayout, place: Place
) -> Iterator[tuple[str, PointFunction, np.ndarray]]:
    """Yield name, function and parameter values of every term that acts at a place."""
    layout, k = names.layout, site.stage
    phase = layout.place_phase(k) if place is Place.NODE else layout.stages[k].phase
    units, more = names.units_at(place, k), (layout.place(k),) if place is Place.NODE else ()
    for term in names.acting_terms(phase, place, k):
        context = names.functions.context(phase, form, place)
        cost, rows = ca.SX(0), []
        if hasattr(term, "rows"):
            result = term.rows(context, units, *more)
            rows = [] if result is None or not result.expression.numel() else [result.expression]
        else:
            cost = term.value(context, units, *more)
        if rows or not cost.is_zero():
            function = point_function(term.name, context, cost, rows)
            yield term.name, function, context.parameter_values_at(names.time(site, layout.node_times))


# Changes of one input, in natural units, tried in turn until the value is finite. Small ones leave a point
# without a slope, such as a norm at zero; large ones reach the domain of a root or a logarithm. Quaternion
# entries change little, since far from unit length they are not rotations.
CHANGES = (1e-3, 1e-1, 1.0, 10.0, 100.0)
MOST_TURN = 0.1
# Largest number of inputs to name; if more of them are a joint cause, their kinds are named instead.
MOST_NAMED = 6


@dataclass(frozen=True, kw_only=True)
class SuspectInput:
    """An input of the function: name and value in SI units, in the variable's true or nominal time."""

    name: str
    value: float

    def __str__(self) -> str:
        return f"{self.name} = {self.value:.6g}"


@dataclass(frozen=True, kw_only=True)
class NonFinite:
    """A non-finite ``output`` (cost, rows, gradient, jacobian, hessian) of ``terms`` at a place.

    row: subject of the row, for output "rows". inputs: those that are not finite; without any, those that
    make everything finite if one of them changes a little. kinds: if no single input does, kinds that do.
    """

    output: str
    terms: tuple[str, ...] = ()
    row: str = ""
    phase: str
    node: int
    point: int | None
    time: float
    place: str
    inputs: tuple[SuspectInput, ...]
    kinds: tuple[str, ...] = ()

    def __str__(self) -> str:
        what = f"{self.output} of {' and '.join(self.terms) or 'a function'}"
        what += f" [{self.row}]" if self.row else ""
        cause = ", ".join(map(str, self.inputs)) or " and ".join(self.kinds)
        return f"{what} is not finite at {self.place}" + (f"; because of {cause}" if cause else "")


@dataclass(frozen=True, kw_only=True)
class _Where:
    """A group of functions, its position, and the names of its inputs."""

    group: FunctionGroup
    position: int
    site: StagePoint
    form: NodeLayout
    place: Place | None
    labels: Sequence[Label]


def first_nonfinite(nlp: Nlp, names: NlpNames, x: np.ndarray) -> NonFinite | None:
    """Return the first non-finite function of the NLP at scaled variables x (n_unknowns,), or None."""
    first = nlp.engine.first_nonfinite(x)
    if first is None:
        return _unknown_itself(names, x)
    number, position, output, index = first
    t = nlp.transcription
    where = _where(t, names, number, position)
    variables = int(t.layout.node_offset[where.site.stage]) + np.arange(where.group.gather.shape[1])
    with np.errstate(invalid="ignore"):  # NaN times a structural zero is not NaN
        seen, rows = x[variables], where.group.gather.toarray()
        inputs = np.array([row[row != 0] @ seen[row != 0] for row in rows])
    guilty = []
    if where.place is not None:
        guilty = nonfinite_terms(names, where.site, where.form, where.place, inputs)
    causes = _suspects(names.unknown_labels, x, variables[~np.isfinite(x[variables])])
    kinds: tuple[str, ...] = ()
    if not causes:
        function, parameters = where.group.point, where.group.parameters[where.position]
        whole = [value_function(function, parameters), derivative_function(function, parameters)]
        causes, kinds = _causes([value for _, value in guilty] or whole, where, inputs)
    return NonFinite(
        output=output,
        terms=tuple(name for name, _ in guilty) or (() if where.place else ("defect",)),
        row=names.row(int(where.group.rows[position, index])).about if output == "rows" else "",
        inputs=causes,
        kinds=kinds,
        **_at(names, where.site),
    )


def _at(names: NlpNames, site: StagePoint) -> dict[str, Any]:
    return {
        "phase": names.phase(site.stage),
        "node": site.stage,
        "point": site.point if site.point >= 0 else None,
        "time": names.time(site),
        "place": names.place(site),
    }


def _unknown_itself(names: NlpNames, x: np.ndarray) -> NonFinite | None:
    """Return a non-finite variable that no function depends on, or None."""
    wrong = np.flatnonzero(~np.isfinite(x))
    if not len(wrong):
        return None
    inputs = _suspects(names.unknown_labels, x, wrong[:1])
    return NonFinite(output="unknown", inputs=inputs, **_at(names, names.unknown_sites[int(wrong[0])]))


def _suspects(labels: Sequence[Label], values: np.ndarray, which: np.ndarray) -> tuple[SuspectInput, ...]:
    return tuple(
        SuspectInput(name=str(labels[i]), value=float(values[i])) for i in which[:MOST_NAMED].tolist()
    )


def _where(t: Transcription, names: NlpNames, number: int, position: int) -> _Where:
    group, layout = t.groups[number], t.layout
    k = int(group.stages[position])
    form = layout.forms[k]
    point, place = _point_of(t, group, k), None
    if point >= 0:
        place = Place.POINT
    elif k < layout.n_stages and group.point.name.startswith("impact_"):
        place = Place.IMPACT
    elif group.point.name.startswith("node_"):
        place = Place.NODE
    return _Where(
        group=group,
        position=position,
        site=StagePoint(stage=k, point=point),
        form=form,
        place=place,
        labels=_labels(t, names, group, k, place),
    )


def _point_of(t: Transcription, group: FunctionGroup, k: int) -> int:
    """Return the index of a group's collocation point, or -1 at a node; points share one function."""
    if k == t.layout.n_stages or t.layout.stages[k].kind is not StageKind.INTERVAL:
        return -1
    siblings = [
        one for one in t.groups if one.point is group.point and np.array_equal(one.stages, group.stages)
    ]
    count = t.layout.scheme_of(int(t.layout.phase_of[k])).s
    plain = group.point.name in ("interval_end", "change") or group.point.name.startswith("node_")
    if plain or len(siblings) != count:
        return -1
    return next(i for i, one in enumerate(siblings) if one is group)


def _labels(
    t: Transcription, names: NlpNames, group: FunctionGroup, k: int, place: Place | None
) -> Sequence[Label]:
    layout, form = t.layout, t.layout.forms[k]
    if place is not None:
        phase = layout.place_phase(k) if place is Place.NODE else layout.stages[k].phase
        return input_labels(names.functions.context(phase, form, place), form, names.free_phases)
    if group.point.name == "change":
        return node_labels(form, names.free_phases)
    labels = rotation_labels(form.robot, form.coordinates)
    for kind in ("position", "rate")[: form.order]:
        coordinates = coordinate_labels(form.robot, form.coordinates, kind)
        labels += [coordinates[int(index)] for index in form.coordinates.rotation_index]
    return labels


def _causes(
    functions: Sequence[Evaluation], where: _Where, inputs: np.ndarray
) -> tuple[tuple[SuspectInput, ...], tuple[str, ...]]:
    """Return inputs that each make everything finite when changed, or else kinds of inputs that do."""
    units = np.abs(where.group.gather.toarray()).max(axis=1)
    units[units == 0] = 1.0
    kinds = np.array([label.kind for label in where.labels])
    turning = np.array(["quaternion" in label.quantity for label in where.labels])
    for change in CHANGES:
        steps = units * np.where(turning, min(change, MOST_TURN), change)
        alone = [j for j in range(len(inputs)) if _is_finite_after(functions, inputs, [j], steps)]
        if alone:
            return _suspects(where.labels, inputs, np.array(alone)), ()
    members = {kind: np.flatnonzero(kinds == kind).tolist() for kind in dict.fromkeys(kinds.tolist())}
    return (), tuple(
        kind
        for kind, group in members.items()
        if any(_is_finite_after(functions, inputs, group, units * change) for change in CHANGES)
    )


def _is_finite_after(
    functions: Sequence[Evaluation], inputs: np.ndarray, which: list[int], steps: np.ndarray
) -> bool:
    """Return whether changing only these inputs, in either direction, makes all functions finite."""
    for sign in (1.0, -1.0):
        trial = inputs.copy()
        trial[which] += sign * steps[which]
        if all(np.isfinite(function(trial)).all() for function in functions):
            return True
    return False
