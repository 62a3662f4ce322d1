"""IPOPT, FATROP and the SQP on the same NLP, with defaults chosen by measurement (docs/measurements.md)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from trajopt import _engine
from trajopt.errors import InputError
from trajopt.robot.units import Units
from trajopt.solvers.result import (
    FEASIBILITY_SHARE,
    Callback,
    Option,
    Result,
    StoppingCriteria,
    WarmMultipliers,
)
from trajopt.solvers.sqp_driver import solve_sqp
from trajopt.solvers.status import Status
from trajopt.transcription.compilation import HESSIANS
from trajopt.transcription.nlp import Nlp
from trajopt.transcription.transcription import Transcription

# The NLP is scaled by units, so the solvers' own scaling is off; a solution "to an acceptable level" does not
# count. The bound relaxation is far below the tolerance. Multipliers start at zero: least-squares estimates
# at a guess off the constraints are large and make the first Hessians indefinite, which doubles the
# iterations of IPOPT on the jump.
IPOPT_OPTIONS: dict[str, Option] = {
    "nlp_scaling_method": "none",
    "mu_strategy": "adaptive",
    "acceptable_iter": 0,
    "bound_relax_factor": 1e-9,
    "constr_mult_init_max": 0.0,
    "print_level": 0,
    "sb": "yes",
}
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

# A start from another solution (docs/warm-starts.md). IPOPT's default distance from bounds, 1e-2, and its
# default initial multipliers discard the solution's information. With the solution's multipliers iterates
# stay where they are; without them a small first barrier keeps them there.
IPOPT_WARM: dict[str, Option] = {
    "warm_start_init_point": "yes",
    "warm_start_bound_push": 1e-5,
    "warm_start_bound_frac": 1e-5,
    "warm_start_slack_bound_push": 1e-5,
    "warm_start_slack_bound_frac": 1e-5,
    "warm_start_mult_bound_push": 1e-5,
}
IPOPT_WARM_WITHOUT_MULTIPLIERS: dict[str, Option] = {
    "mu_strategy": "monotone",
    "mu_init": 1e-5,
    "bound_push": 1e-5,
    "bound_frac": 1e-5,
    "slack_bound_push": 1e-5,
    "slack_bound_frac": 1e-5,
}
# FATROP takes no multipliers of bounds, and those of rows alone gain nothing. A smaller barrier needs fewer
# iterations where it succeeds, but sometimes stalls.
FATROP_WARM: dict[str, Option] = {"mu_init": 1e-3, "bound_push": 3e-3, "bound_frac": 3e-3}

# IPOPT's option, and its value for the engine's factorisation stage by stage.
LINEAR_SOLVER, STAGES = "linear_solver", "stages"

_IPOPT_STATUS = {
    "Solve_Succeeded": Status.SOLVED,
    "Solved_To_Acceptable_Level": Status.STEP_FAILED,
    "Feasible_Point_Found": Status.STEP_FAILED,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "Search_Direction_Becomes_Too_Small": Status.STEP_FAILED,
    "Diverging_Iterates": Status.UNBOUNDED,
    "User_Requested_Stop": Status.INTERRUPTED,
    "Maximum_Iterations_Exceeded": Status.ITERATION_LIMIT,
    "Restoration_Failed": Status.INFEASIBLE,
    "Error_In_Step_Computation": Status.STEP_FAILED,
    "Maximum_CpuTime_Exceeded": Status.TIME_LIMIT,
    "Maximum_WallTime_Exceeded": Status.TIME_LIMIT,
    "Not_Enough_Degrees_Of_Freedom": Status.INVALID,
    "Invalid_Problem_Definition": Status.INVALID,
    "Invalid_Number_Detected": Status.NOT_FINITE,
}


def _ipopt(
    nlp: Nlp,
    x0: np.ndarray,
    stop: StoppingCriteria,
    options: Mapping[str, Option],
    callback: Callback,
    warm: WarmMultipliers | None,
) -> Result:
    t = nlp.transcription
    lam_g, lam_x = (None, None) if warm is None else (warm.lam_g, warm.lam_x)
    restart = IPOPT_WARM_WITHOUT_MULTIPLIERS if lam_g is None else IPOPT_WARM
    chosen = {
        **IPOPT_OPTIONS,
        **({} if warm is None else restart),
        **({"hessian_approximation": LIMITED_MEMORY} if nlp.hessian == LIMITED_MEMORY else {}),
        "tol": stop.tolerance,
        "constr_viol_tol": FEASIBILITY_SHARE * stop.tolerance,
        "max_iter": stop.max_iterations,
        "max_wall_time": stop.max_time,
        **options,
    }
    stage = None
    if chosen.setdefault(LINEAR_SOLVER, _usual_linear_solver(nlp.hessian)) == STAGES:
        if nlp.hessian == LIMITED_MEMORY:
            raise ValueError(f"{LINEAR_SOLVER}={STAGES} has no place for a Hessian of gradients")
        del chosen[LINEAR_SOLVER]
        stage = t.layout.stage_numbers
    raw = _engine.solve_ipopt(
        nlp.engine, x0, t.lower_x, t.upper_x, t.lower_g, t.upper_g, chosen, callback, lam_g, lam_x, stage
    )
    if raw["status"] == "Invalid_Option":
        raise ValueError(
            "an option has a value that is not available here, such as a linear_solver that is not installed"
        )
    return _result(raw, _IPOPT_STATUS.get(raw["status"], Status.FAILED))


def _usual_linear_solver(hessian: str) -> str:
    return "mumps" if hessian == LIMITED_MEMORY else STAGES


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


def _fatrop(
    nlp: Nlp,
    x0: np.ndarray,
    stop: StoppingCriteria,
    options: Mapping[str, Option],
    callback: Callback,
    warm: WarmMultipliers | None,
) -> Result:
    t = nlp.transcription
    if t.problem.periodicity is not None:
        raise ValueError(
            "rows that join the first and the last stage have no place in it; allowed: ipopt, sqp"
        )
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
    return _result(raw, _FATROP_STATUS.get(raw["status"], Status.FAILED))


# The Hessian that is approximated from gradients, and the solver that can do so.
LIMITED_MEMORY, MAKES_HESSIANS = "limited-memory", "ipopt"
# Figures with the same name in the engine and in the result.
SAME_NAMES = (
    "x", "lam_g", "lam_x", "iterations", "wall_time", "function_time", "primal", "dual", "complementarity",
)  # fmt: skip
SOLVERS = {"ipopt": _ipopt, "fatrop": _fatrop, "sqp": solve_sqp}


def _result(raw: dict[str, Any], status: Status) -> Result:
    same = {name: raw[name] for name in SAME_NAMES}
    return Result(status=status, solver_status=raw["status"], objective=raw["f"], **same)


def run_solver(
    nlp: Nlp,
    x0: np.ndarray,
    solver: str,
    stop: StoppingCriteria,
    options: Mapping[str, Option],
    callback: Callback,
    warm: WarmMultipliers | None = None,
) -> Result:
    """Solve from ``x0`` with the solver of that name; ``warm`` where ``x0`` comes from another solution.

    Raises InputError for an unknown solver or option, and for a Hessian that the solver does not support.
    """
    if solver not in SOLVERS:
        raise InputError(f"unknown solver '{solver}'", f"allowed: {', '.join(SOLVERS)}")
    check_hessian(solver, nlp.hessian)
    try:
        return SOLVERS[solver](nlp, x0, stop, options, callback, warm)
    except ValueError as error:
        raise InputError(f"{solver}: {error}") from None


def check_hessian(solver: str, hessian: str) -> None:
    """Raise InputError for an unknown Hessian, or one that the solver does not support."""
    if hessian not in HESSIANS:
        raise InputError(f"unknown Hessian '{hessian}'", f"allowed: {', '.join(HESSIANS)}")
    if hessian == LIMITED_MEMORY and solver != MAKES_HESSIANS:
        allowed = ", ".join(name for name in HESSIANS if name != LIMITED_MEMORY)
        raise InputError(f"{solver} cannot approximate the Hessian from gradients", f"allowed: {allowed}")
