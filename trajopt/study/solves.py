"""The solve of a case in any study: its settings, its file, and in one word why it failed."""

import math
from dataclasses import dataclass
from typing import Any

from trajopt.errors import InputError
from trajopt.motion.solution import Solution
from trajopt.motion.statistics import SolveStatistics
from trajopt.problem.problem import Problem
from trajopt.solvers.drivers import SOLVERS
from trajopt.solvers.status import Status
from trajopt.solving.graded import solve
from trajopt.solving.solving import check_settings
from trajopt.solving.time_limits import GRACE, OVERHEAD_TIME
from trajopt.solving.verdicts import STILL_FEASIBLE
from trajopt.transcription.violations import describe_block

# Most starts of a case: more add no information and take a day.
MOST_STARTS = 10_000
# Seconds of a task besides its solves: building, functions that are not in the cache yet, the check.
BUILD_TIME = 300.0
# Longest time, s, that the timers of all kernels take.
MOST_TIME = 1e9
# Failure modes: the optimality condition that was not met, or another reason.
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


@dataclass(frozen=True, kw_only=True)
class SolveSettings:
    """How the cases of a study are solved. Raises `InputError` for invalid values.

    Args:
        solver: as in `trajopt.solve`.
        tolerance: as in `trajopt.solve`.
        max_iterations: as in `trajopt.solve`.
        max_time: for all solves from one start, s.
    """

    solver: str = "ipopt"
    tolerance: float = 1e-6
    max_iterations: int = 500
    max_time: float = 60.0

    def __post_init__(self) -> None:
        check_settings(self.solver, self.tolerance, self.max_iterations, self.max_time, 0.0, 0)

    @property
    def starts(self) -> int:
        """Number of starts of one task."""
        return 1

    @property
    def longest(self) -> float:
        """Time limit of a task's process, s."""
        return min(self.starts * (self.max_time + OVERHEAD_TIME) + GRACE + BUILD_TIME, MOST_TIME)

    def solve(self, problem: Problem, **arguments: Any) -> Solution:
        """The solution by `trajopt.solve` with these settings and further arguments."""
        settings = {name: getattr(self, name) for name in SolveSettings.__dataclass_fields__}
        return solve(problem, **(settings | arguments))


def file_content(solution: Solution) -> bytes | None:
    """Content of a solution's file; None for an iterate that is not finite."""
    try:
        return solution.to_bytes()
    except InputError:
        return None


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
