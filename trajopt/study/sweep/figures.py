"""The accuracy of a solution as one flat row, by `trajopt.certify.accuracy`."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.certify.accuracy.measures import measure

# Columns of ``settings.csv`` about accuracy, named as in `trajopt.certify.accuracy`;
# the last two are against the reference.
COLUMNS = {
    "open_loop": "open_loop_m",
    "open_loop_motion": "open_loop_motion_m",
    "interval_error": "interval_error_m",
    "collocation_error": "collocation_error",
    "foot_drift": "foot_drift_m",
    "violation_between": "violation_between",
    "objective_gap": "objective_gap",
    "distance": "distance_m",
}


def figures(file: Path, reference: Path | None) -> dict[str, float | None]:
    """Figures of the solution in ``file`` by column; unknown ones are None. Raises TrajoptError."""
    with np.errstate(all="ignore"):  # an inaccurate motion may diverge: its figures show it
        accuracy: dict[str, Any] = measure(file, reference).to_dict()
    return {column: _number(accuracy.get(name)) for name, column in COLUMNS.items()}


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None
