"""Columns of the index of a batch: the case, its parameters, its figures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from trajopt.study.batch.variation import BatchCase
from trajopt.versions import optional_package

if TYPE_CHECKING:
    import pyarrow as pa

# Columns of figures, with the names of their PyArrow types.
FIGURES = {
    "success": "bool_",
    "status": "string",
    "detail": "string",
    "start": "int64",
    "warm_start": "bool_",
    "iterations": "int64",
    "solver_time_s": "float64",
    "case_time_s": "float64",
    "objective": "float64",
    "motion_time_s": "float64",
    "energy_j": "float64",
    "cost_of_transport": "float64",
    "max_violation": "float64",
    "tolerance_used": "float64",
    "worst_figure": "string",
    "variables": "int64",
    "intervals": "int64",
    "attempts": "int64",
    "file": "string",
}
FIRST = ("case", "problem")


def arrow() -> Any:
    """PyArrow with its Parquet module; if it is missing, raises an `InputError` that names the extra."""
    for name in ("pyarrow.parquet", "pyarrow"):
        package = optional_package(name, what="the index of a batch", extra="batch")
    return package


def parameter_columns(cases: Iterable[BatchCase]) -> dict[str, bool]:
    """Columns of all parameters of the cases, and whether each holds words."""
    columns: dict[str, bool] = {}
    for case in cases:
        for name, value in case.values.items():
            columns[name] = columns.get(name, False) or isinstance(value, str)
    return columns


def column_of(name: str) -> str:
    """The column of a parameter: its name, with a prefix if another column has it."""
    return f"parameter_{name}" if name in FIGURES or name in FIRST else name


def schema(words: Mapping[str, bool]) -> pa.Schema:
    """Names and types of all columns, with the parameters from `parameter_columns`."""
    pyarrow = arrow()
    parameters = [
        (column_of(name), pyarrow.string() if word else pyarrow.float64()) for name, word in words.items()
    ]
    figures = [(name, getattr(pyarrow, kind)()) for name, kind in FIGURES.items()]
    return pyarrow.schema([("case", pyarrow.int64()), ("problem", pyarrow.string()), *parameters, *figures])


def row_of(index: int, case: BatchCase, figures: dict[str, Any], words: Mapping[str, bool]) -> dict[str, Any]:
    """One row of the index."""
    values = {
        column_of(name): str(value) if words[name] else float(value) for name, value in case.values.items()
    }
    return {"case": index, "problem": case.problem, **values, **figures}
