"""Why a solve failed, in one word: the optimality condition that was not met, or another reason."""

import math

from trajopt.solution.statistics import SolveStatistics
from trajopt.solvers.drivers import SOLVERS
from trajopt.solvers.status import Status
from trajopt.solving.verdicts import STILL_FEASIBLE
from trajopt.transcription.violations import describe_block

SOLVED = ""
PRIMAL = "primal"
DUAL = "dual"
COMPLEMENTARITY = "complementarity"
NOT_FINITE = "NaN"
TIME = "time"
CHECK = "check"
ERROR = "error"
MODES = (PRIMAL, DUAL, COMPLEMENTARITY, NOT_FINITE, TIME, CHECK, ERROR)

# Failure modes by status. Diverging iterates are a dual failure: an objective without lower bound has no
# multipliers. A base in gimbal lock and creeping contacts fail the check.
_OF_STATUS = {
    Status.SOLVED: SOLVED,
    Status.INFEASIBLE: PRIMAL,
    Status.INACCURATE: PRIMAL,
    Status.UNBOUNDED: DUAL,
    Status.NOT_FINITE: NOT_FINITE,
    Status.TIME_LIMIT: TIME,
    Status.SINGULAR_BASE: CHECK,
    Status.COARSE_GRID: CHECK,
    Status.INVALID: ERROR,
}


def mode_of(statistics: SolveStatistics) -> str:
    """The failure mode of a solve: one of `MODES`, or `SOLVED`.

    If the solver merely stopped (iteration limit, no step), the iterate's infeasibilities decide, see
    `worst_condition`.
    """
    status = Status[statistics.status.upper()]
    if status in _OF_STATUS:
        return _OF_STATUS[status]
    return worst_condition(
        statistics.primal_infeasibility,
        statistics.dual_infeasibility,
        statistics.complementarity,
        statistics.tolerance,
        SOLVERS[statistics.solver].feasibility_share * statistics.tolerance,
    )


def failure_text(statistics: SolveStatistics) -> str:
    """Status of a failed solve and what it violates, in words; empty on success."""
    if statistics.success:
        return ""
    missed = statistics.advice_in_line if statistics.converged else describe_block(statistics.worst_blocks[0])
    return f"{statistics.status}: {missed}"


def worst_condition(
    primal: float | None,
    dual: float | None,
    complementarity: float | None,
    tolerance: float,
    feasibility: float,
) -> str:
    """The optimality condition that an iterate violates most.

    This is the primal one if rows are violated by more than ``STILL_FEASIBLE``: at an infeasible point the
    other two mean little. Otherwise it is the one with the largest ratio to its tolerance (``feasibility``
    for the primal one). None stands for a figure that is not finite.
    """
    figures = [math.nan if value is None else value for value in (primal, dual, complementarity)]
    if not all(math.isfinite(value) for value in figures):
        return NOT_FINITE
    if figures[0] > STILL_FEASIBLE:
        return PRIMAL
    missed = zip(figures, (feasibility, tolerance, tolerance), (PRIMAL, DUAL, COMPLEMENTARITY), strict=True)
    return max(missed, key=lambda entry: entry[0] / entry[1])[2]
