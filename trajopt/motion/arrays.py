"""The arrays of a solution: names, types, and ranges of equal indices."""

import itertools
from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np

from trajopt.errors import InputError

_Record = TypeVar("_Record")
# Type of each array with one row per sample.
SAMPLED: dict[str, type] = {
    "t": float,
    "phase": int,
    "interval": int,
    "collocation": bool,
    "q": float,
    "v": float,
    "a": float,
    "tau": float,
    "f": float,
    "active": bool,
}
# Requests of a whole-body controller in a simulation, one row per sample.
REQUESTS: dict[str, type] = {"asked_force": float, "com_goal": float, "foot_goal": float}
OTHERS: dict[str, type] = {
    "interval_t": float,
    "impulse": float,
    "impact_index": int,
    "row_multiplier": float,
    "row_place": int,
    "bound_multiplier": float,
    **REQUESTS,
}
# Arrays that may be absent from a solution.
OPTIONAL = (*REQUESTS, "impulse", "impact_index", "row_multiplier", "row_place", "bound_multiplier")


def read_only(given: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Return read-only copies of a solution's arrays with their types, without absent optional arrays.

    Raises `InputError` if a value is not an array of its type, or does not have one row per sample.
    """
    arrays: dict[str, np.ndarray] = {}
    for name, dtype in {**SAMPLED, **OTHERS}.items():
        if given.get(name) is None and name in OPTIONAL:
            continue
        try:
            arrays[name] = np.array(given.get(name), dtype=dtype)
        except (TypeError, ValueError):
            raise InputError(f"'{name}' of the solution is not an array of {dtype.__name__}") from None
        arrays[name].setflags(write=False)
    samples = arrays["t"].shape
    for name in SAMPLED:
        shape = arrays[name].shape
        if len(samples) != 1 or shape[:1] != samples:
            raise InputError(
                f"'{name}' of the solution has shape {shape}", f"first dimension as t: {samples}"
            )
    return arrays


def rows_of(record: _Record, rows: slice | int | list[int] | np.ndarray) -> _Record:
    """Return the record with only the given rows of each array."""
    return type(record)(**{name: array[rows] for name, array in vars(record).items()})


def runs(index: np.ndarray) -> tuple[range, ...]:
    """Return the ranges of equal consecutive values."""
    edges = [0, *(np.flatnonzero(np.diff(index)) + 1).tolist(), len(index)]
    return tuple(range(start, stop) for start, stop in itertools.pairwise(edges) if stop > start)
