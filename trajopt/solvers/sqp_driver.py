"""The SQP as one of the solvers: its options, statuses and figures."""

import time
from collections.abc import Mapping

import numpy as np

from trajopt.solvers.result import Callback, Option, Result, StoppingCriteria, WarmMultipliers
from trajopt.solvers.sqp_settings import SqpSettings
from trajopt.solvers.status import Status
from trajopt.transcription.nlp import Nlp

_SQP_STATUS = {
    "Solved": Status.SOLVED,
    "Early": Status.EARLY,
    "Infeasible": Status.INFEASIBLE,
    "NoStep": Status.STEP_FAILED,
    "IterationLimit": Status.ITERATION_LIMIT,
    "TimeLimit": Status.TIME_LIMIT,
    "Interrupted": Status.INTERRUPTED,
    "NotFinite": Status.NOT_FINITE,
}


def solve_sqp(
    nlp: Nlp,
    x0: np.ndarray,
    stop: StoppingCriteria,
    options: Mapping[str, Option],
    callback: Callback,
    warm: WarmMultipliers | None,
) -> Result:
    """Solve from ``x0``, projected onto its bounds, and the multipliers of ``warm``.

    Raises ValueError for an option that is unknown or not allowed.
    """
    from trajopt.solvers.sqp import Sqp

    settings = SqpSettings.create(options, stop)
    lam_g, lam_x = np.zeros(nlp.transcription.n_rows), np.zeros_like(x0)
    if warm is not None and warm.lam_g is not None and warm.lam_x is not None:
        lam_g, lam_x = warm.lam_g, warm.lam_x
    begun, before = time.perf_counter(), _function_seconds(nlp)
    outcome = Sqp(nlp, settings, callback).run(x0, lam_g, lam_x)
    return Result(
        x=outcome.point.x,
        lam_g=outcome.point.lam_g,
        lam_x=outcome.point.lam_x,
        status=_SQP_STATUS[outcome.status],
        solver_status=outcome.status,
        iterations=outcome.iterations,
        objective=outcome.point.pair.f,
        wall_time=time.perf_counter() - begun,
        function_time=_function_seconds(nlp) - before,
        primal=outcome.errors.primal,
        dual=outcome.errors.dual,
        complementarity=outcome.errors.complementarity,
        figures={
            "quadratic_programs": outcome.programs,
            "quadratic_program_iterations": outcome.program_iterations,
            "quadratic_program_time_s": outcome.program_time,
        },
    )


def _function_seconds(nlp: Nlp) -> float:
    return sum(seconds for seconds, _ in nlp.engine.timings().values())
