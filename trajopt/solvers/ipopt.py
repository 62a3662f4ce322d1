"""IPOPT, with defaults chosen by measurement (docs/solvers.md)."""

from collections.abc import Mapping

import numpy as np

from trajopt import _engine
from trajopt.solvers.result import Callback, Option, Result, StoppingCriteria, WarmMultipliers
from trajopt.solvers.status import Status
from trajopt.transcription.hessians import LIMITED_MEMORY
from trajopt.transcription.nlp import Nlp

# The NLP is scaled by units, so IPOPT's own scaling is off; a solution "to an acceptable level" does not
# count. The bound relaxation is far below the tolerance. Multipliers start at zero: least-squares estimates
# at an infeasible guess are large and make the first Hessians indefinite, which doubles the iterations on the
# jump. Linear solutions are refined only if their residuals require it.
IPOPT_OPTIONS: dict[str, Option] = {
    "nlp_scaling_method": "none",
    "mu_strategy": "adaptive",
    "acceptable_iter": 0,
    "bound_relax_factor": 1e-9,
    "constr_mult_init_max": 0.0,
    "min_refinement_steps": 0,
    "print_level": 0,
    "sb": "yes",
}
# Multipliers of bounds balance costs: they start at this quantile of the magnitudes in the costs' gradient,
# clipped to the smallest and largest value.
BALANCE_QUANTILE, LEAST_MULTIPLIER, MOST_MULTIPLIER = 0.99, 3e-3, 1.0
# Options for a start from another solution (docs/warm-starts.md). IPOPT's default distance from bounds, 1e-2,
# and its default multipliers discard the solution's information. The solution's multipliers keep iterates
# near the start; without them a small initial barrier does.
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
# Options for a start that new rows exclude, so that steps are cut short at bounds: this barrier moves it away
# from them. If `IPOPT_WARM` succeeds, it takes fewer iterations (docs/warm-starts.md).
IPOPT_PUSHED: dict[str, Option] = {
    **{name: 1e-3 for name in IPOPT_WARM if "push" in name or "frac" in name},
    "mu_strategy": "monotone",
    "mu_init": 1e-3,
}
# IPOPT's option for the linear solver, and its value for the engine's stagewise factorisation.
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


def solve_ipopt(
    nlp: Nlp,
    x0: np.ndarray,
    stop: StoppingCriteria,
    options: Mapping[str, Option],
    callback: Callback,
    warm: WarmMultipliers | None,
) -> Result:
    """Run IPOPT, as a `Driver`, with the engine's stagewise factorisation or another linear solver."""
    t = nlp.transcription
    lam_g, lam_x = (None, None) if warm is None else (warm.lam_g, warm.lam_x)
    restart = IPOPT_WARM_WITHOUT_MULTIPLIERS if lam_g is None else IPOPT_WARM
    chosen = {
        **IPOPT_OPTIONS,
        **(_from_guess(nlp, x0) if warm is None else restart),
        **({"hessian_approximation": LIMITED_MEMORY} if nlp.hessian == LIMITED_MEMORY else {}),
        "tol": stop.tolerance,
        "constr_viol_tol": stop.feasibility,
        "max_iter": stop.max_iterations,
        "max_wall_time": stop.max_time,
        **options,
    }
    stage = None
    if chosen.setdefault(LINEAR_SOLVER, "mumps" if nlp.hessian == LIMITED_MEMORY else STAGES) == STAGES:
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
    return Result.from_engine(raw, _IPOPT_STATUS.get(raw["status"], Status.FAILED))


def _from_guess(nlp: Nlp, x0: np.ndarray) -> dict[str, Option]:
    """Return options for a start from a guess: an affine corrector, bound multipliers from the costs."""
    t = nlp.transcription
    slopes = np.abs(nlp.engine.gradient(x0))[t.lower_x < t.upper_x]
    size = float(np.quantile(slopes, BALANCE_QUANTILE)) if len(slopes) else 0.0
    return {
        "corrector_type": "affine",
        "bound_mult_init_val": min(max(size, LEAST_MULTIPLIER), MOST_MULTIPLIER),
    }
