"""Every term at a place as a separate function, evaluated layer by layer, to find the one at fault."""

from collections.abc import Callable, Iterator

import casadi as ca
import numpy as np

from trajopt.terms.context_symbols import Place
from trajopt.transcription.names import NlpNames, Site
from trajopt.transcription.stage_functions import Derivatives, PointFunction, point_function
from trajopt.transcription.timeline import NodeLayout

Evaluation = Callable[[np.ndarray], np.ndarray]


def nonfinite_terms(
    names: NlpNames, site: Site, form: NodeLayout, place: Place, inputs: np.ndarray
) -> list[tuple[str, Evaluation]]:
    """Terms whose own values at z = ``inputs`` are not finite, with their functions.

    Where all values are finite, those whose derivatives are not.
    """
    made = list(_terms(names, site, form, place))
    for kind in (value_function, derivative_function):
        evaluations = [(name, kind(function, parameters)) for name, function, parameters in made]
        guilty = [(name, value) for name, value in evaluations if not np.isfinite(value(inputs)).all()]
        if guilty:
            return guilty
    return []


def value_function(function: PointFunction, parameters: np.ndarray) -> Evaluation:
    """All values of a point function at z in one column."""

    def values(z: np.ndarray) -> np.ndarray:
        o = ca.DM(z)
        for layer in function.layers:
            o = layer(o)
        outputs = function.terms(z, o if function.layers else ca.DM(0, 1), parameters)
        return np.concatenate([np.array(part).ravel() for part in outputs])

    return values


def derivative_function(function: PointFunction, parameters: np.ndarray) -> Evaluation:
    """All its first and second derivatives in one column."""
    made = Derivatives(function)
    first, second, ones = made.first, made.second, np.ones(function.n_rows)

    def slopes(z: np.ndarray) -> np.ndarray:
        parts = [*first(z, parameters), second(z, parameters, 1.0, ones)]
        return np.concatenate([np.array(ca.DM(part).nonzeros()) for part in parts])

    return slopes


def _terms(
    names: NlpNames, site: Site, form: NodeLayout, place: Place
) -> Iterator[tuple[str, PointFunction, np.ndarray]]:
    """Name, function and parameters' values of every term that acts at a place."""
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
