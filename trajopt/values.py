"""Values that users give: numbers and arrays, checked; and values as JSON has them."""

from __future__ import annotations

import math
from typing import Any, TypeGuard

import numpy as np

from trajopt.errors import InputError


def is_number(value: Any) -> TypeGuard[float]:
    """Whether a value is a finite number, Python's or NumPy's; True and False are none."""
    return isinstance(value, int | float | np.number) and not isinstance(value, bool) and math.isfinite(value)


def require_positive(what: str, value: Any, unit: str = "") -> None:
    """Raise `InputError` unless ``value`` is a finite number above zero."""
    if not (is_number(value) and value > 0):
        raise InputError(f"{what} is {_shown(value, unit)}", "allowed: finite and > 0")


def require_not_negative(what: str, value: Any, unit: str = "") -> None:
    """Raise `InputError` unless ``value`` is a finite number of zero or above."""
    if not (is_number(value) and value >= 0):
        raise InputError(f"{what} is {_shown(value, unit)}", "allowed: finite and >= 0")


def require_finite(what: str, value: Any, unit: str = "") -> None:
    """Raise `InputError` unless ``value`` is a finite number."""
    if not is_number(value):
        raise InputError(f"{what} is {_shown(value, unit)}", "allowed: a finite number")


def _shown(value: Any, unit: str) -> str:
    number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    return (f"{value:g}" if number else repr(value)) + (f" {unit}" if unit else "")


def numbers_of(value: Any) -> np.ndarray:
    """A copy of ``value`` as an array of numbers, without entries where it is none."""
    try:
        return np.array(value, dtype=float)
    except (TypeError, ValueError):
        return np.zeros(0)


def finite_array(what: str, value: Any, shape: tuple[int, ...] = (3,), unit: str = "") -> np.ndarray:
    """A read-only copy of ``value`` as finite numbers of a shape. Raises `InputError` for anything else."""
    array = numbers_of(value)
    if array.shape != shape or not np.isfinite(array).all():
        size = str(shape[0]) if len(shape) == 1 else f"{shape}"
        raise InputError(
            f"{what} is {value!r}", f"allowed: {size} finite numbers" + (f", {unit}" if unit else "")
        )
    array.setflags(write=False)
    return array


def unit_vector(what: str, value: Any) -> np.ndarray:
    """The direction (3,) of ``value`` with length one. Raises `InputError` for anything without direction."""
    vector = numbers_of(value)
    if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
        raise InputError(f"{what} is {value!r}", "allowed: 3 finite numbers, not all 0")
    return np.asarray(vector / np.linalg.norm(vector))


def jsonable(value: Any) -> Any:
    """The value with lists for tuples and arrays, and None for numbers that are not finite."""
    if isinstance(value, dict):
        return {str(key): jsonable(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [jsonable(entry) for entry in list(value)]
    return None if isinstance(value, float) and not math.isfinite(value) else value
