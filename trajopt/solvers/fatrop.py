"""FATROP, with defaults chosen by measurement (docs/measurements.md)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from trajopt import _engine
from trajopt.robot.units import Units
from trajopt.solvers.result import Callback, Option, Result, StoppingCriteria, WarmMultipliers
from trajopt.solvers.status import Status
from trajopt.transcription.nlp import Nlp
from trajopt.transcription.transcription import Transcription

# Slacks start further inside their bounds than FATROP's own 1e-2: a guess sits on limits it will leave. The
# pivot tolerance treats a stage's rows as dependent early enough that its linear algebra seldom repeats a
# step. Curvature proportional to a short step is small but positive: FATROP's own least pivot, 1e-6, takes it
# for negative on fine meshes and regularises every step (docs/scaling.md).
FATROP_OPTIONS: dict[str, Option] = {
    "print_level": 0,
    "bound_push": 0.1,
    "bound_frac": 0.1,
    "linsol_lu_fact_tol": 1e-4,
    "linsol_pivot_tol": 1e-10,
}

# FATROP takes no multipliers of bounds, and those of rows alone gain nothing. A smaller barrier needs fewer
# iterations where it succeeds, but sometimes stalls.
FATROP_WARM: dict[str, Option] = {"mu_init": 1e-3, "bound_push": 3e-3, "bound_frac": 3e-3}

_FATROP_STATUS = {
    "Success": Status.SOLVED,
    "MaxIterExceeded": Status.ITERATION_LIMIT,
    "StopAtAcceptablePoint": Status.STEP_FAILED,
    "LocalInfeasibility": Status.INFEASIBLE,
    "LineSearchFailed": Status.STEP_FAILED,
    "ErrorInStepComputation": Status.STEP_FAILED,
    "UserRequestedStop": Status.INTERRUPTED,
    "MaxWallTimeExceeded": Status.TIME_LIMIT,
    "InvalidNumber": Status.NOT_FINITE,
}


def mesh_weight(t: Transcription) -> float:
    """Mean weight of a collocation point in the objective: its part of the duration over sqrt(length / g)."""
    layout = t.layout
    phases = range(len(layout.intervals))
    points = sum(len(layout.intervals_of(phase)) * layout.scheme_of(phase).s for phase in phases)
    return float(layout.node_times[-1]) / Units(t.problem.robot).time / points


def solve_fatrop(
    nlp: Nlp,
    x0: np.ndarray,
    stop: StoppingCriteria,
    options: Mapping[str, Option],
    callback: Callback,
    warm: WarmMultipliers | None,
) -> Result:
    """A `Driver`: its stages are those of the layout."""
    t = nlp.transcription
    chosen = {
        **FATROP_OPTIONS,
        **({} if warm is None else FATROP_WARM),
        "tolerance": stop.tolerance,
        "max_iter": stop.max_iterations,
        "max_wall_time": stop.max_time,
        # A barrier acts at every point alike: the objective, whose points weigh less on finer meshes, is
        # scaled to a mean weight of one. Otherwise the first barrier is stronger and the last less accurate
        # on fine meshes.
        "objective_scale": 1.0 / mesh_weight(t),
        **options,
    }
    nx, nu, ng = (np.array(part, dtype=np.int32) for part in t.stage_sizes())
    raw = _engine.solve_fatrop(
        nlp.engine, nx, nu, ng, x0, t.lower_x, t.upper_x, t.lower_g, t.upper_g, chosen, callback
    )
    return Result.from_engine(raw, _FATROP_STATUS.get(raw["status"], Status.FAILED))
