"""IPOPT and the SQP on the same NLP, with defaults chosen by measurement (docs/measurements.md)."""

from __future__ import annotations

from collections.abc import Mapping
import numpy as np

from trajopt import _engine
from trajopt.errors import InputError
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
    names = ("x", "lam_g", "lam_x", "iterations", "wall_time", "function_time", "primal", "dual")
    return Result(
        status=_IPOPT_STATUS.get(raw["status"], Status.FAILED),
        solver_status=raw["status"],
        objective=raw["f"],
        complementarity=raw["complementarity"],
        **{name: raw[name] for name in names},
    )


def _usual_linear_solver(hessian: str) -> str:
    return "mumps" if hessian == LIMITED_MEMORY else STAGES


# The Hessian that is approximated from gradients, and the solver that can do so.
LIMITED_MEMORY, MAKES_HESSIANS = "limited-memory", "ipopt"
SOLVERS = {"ipopt": _ipopt, "sqp": solve_sqp}


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
