"""What terms return, checked where it is used: errors in a term of the user's own name it, file and line."""

import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca

from trajopt.errors import InputError, TrajoptError, first_line, shown
from trajopt.terms.context import Context
from trajopt.terms.interfaces import PointConstraint, Rows, Term, column


def result_of(term: Term, phase: str, build: Callable[..., Any], context: Context, *more: object) -> Any:
    """What a term's method ``build`` returns in a phase.

    Raises:
        InputError: with the term's name, where the method fails or returns what it may not.
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
        raise InputError(f"{what}: {first_line(error)}", f"in {where}") from error


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
    """Raise `InputError` for symbols that are not of the context."""
    known = [context.z, context.dynamics_symbols(), context.frame_symbols(), context.parameters]
    free = ca.Function("known", known, [expression], {"allow_free": True}).free_sx()
    if len(free):
        names = ", ".join(dict.fromkeys(str(symbol) for symbol in free))
        raise InputError(
            f"the expression depends on {names}, which the context does not have",
            "allowed: symbols of the context, and numbers as context.parameter(...)",
        )
