"""One case of a batch, solved to the grade from a neighbour's solution or from its default guess."""

import time
from dataclasses import dataclass, replace
from typing import Any

from trajopt.arguments import checked
from trajopt.errors import InputError
from trajopt.motion.energy_use import cost_of_transport, energy
from trajopt.problem.catalogue import families
from trajopt.problem.family import choose
from trajopt.problem.problem import Problem
from trajopt.solution.solution import Solution
from trajopt.solving.graded import solve
from trajopt.solving.ladder import total_effort
from trajopt.solving.solving import check_settings
from trajopt.solving.time_limits import GRACE, OVERHEAD_TIME
from trajopt.study.batch.variation import BatchCase
from trajopt.study.suite.failure import failure_text

# Seconds of a case besides its solves: building, functions that are not in the cache yet, the check.
BUILD_TIME = 300.0
# Iterations on a mesh after which a neighbour's solution has gained nothing; the default guess is tried.
MOST_FROM_NEIGHBOUR = 100
# Longest time, s, that the timers of all kernels take.
MOST_TIME = 1e9


@checked
@dataclass(frozen=True, kw_only=True)
class BatchSettings:
    """How every case of a batch is solved. Raises `InputError` for invalid values.

    Args:
        solver: as in `trajopt.solve`.
        tolerance: as in `trajopt.solve`.
        max_iterations: as in `trajopt.solve`.
        max_time: for all solves from one start, s.
        neighbours: start from a neighbour's solution, and from the default guess only where that fails.
    """

    solver: str = "ipopt"
    tolerance: float = 1e-6
    max_iterations: int = 500
    max_time: float = 60.0
    neighbours: bool = True

    def __post_init__(self) -> None:
        check_settings(self.solver, self.tolerance, self.max_iterations, self.max_time, 0.0, 0)

    @property
    def longest(self) -> float:
        """Time limit of a case's process, s."""
        return min((1 + self.neighbours) * (self.max_time + OVERHEAD_TIME) + GRACE + BUILD_TIME, MOST_TIME)


@dataclass(frozen=True, kw_only=True)
class CaseResult:
    """The figures of a case by column, and the content of its solution file; None without a motion."""

    figures: dict[str, Any]
    content: bytes | None


def solve_case(case: BatchCase, settings: BatchSettings, start: bytes | None) -> CaseResult:
    """Solve a case in this process.

    Args:
        case: problem and values.
        settings: of the batch.
        start: content of a neighbour's solution file; if it does not lead to a motion with the grade, the
            default guess is tried too.

    Raises:
        TrajoptError: if the problem cannot be built.
    """
    begun = time.perf_counter()
    problem = choose(families(), case.problem).load(case.values)
    tried = [] if start is None else _from_neighbour(problem, settings, start)
    if not (tried and tried[-1].success):
        tried.append(_solved(problem, settings, None))
    best = next((one for one in tried if one.success), tried[-1])
    try:
        content: bytes | None = best.to_bytes()
    except InputError:  # an iterate that is not finite
        content = None
    statistics, spent = best.statistics, total_effort(tried)
    figures = {
        "success": best.success,
        "status": statistics.status,
        "detail": failure_text(statistics),
        "warm_start": statistics.warm_start,
        "iterations": spent["iterations"],
        "solver_time_s": spent["wall_time_s"],
        "case_time_s": time.perf_counter() - begun,
        "objective": statistics.objective,
        "motion_time_s": float(best.t[-1] - best.t[0]),
        "energy_j": energy(best) if best.converged else None,
        "cost_of_transport": cost_of_transport(best) if best.converged else None,
        "max_violation": statistics.max_violation,
        "tolerance_used": statistics.tolerance_used,
        "worst_figure": statistics.worst_figure,
        "variables": statistics.variables,
        "intervals": best.n_intervals,
    }
    return CaseResult(figures=figures, content=content)


def _from_neighbour(problem: Problem, settings: BatchSettings, start: bytes) -> list[Solution]:
    """The solve from a neighbour's solution; empty if that has other phases or joints."""
    settings = replace(settings, max_iterations=min(settings.max_iterations, MOST_FROM_NEIGHBOUR))
    try:
        return [_solved(problem, settings, Solution.from_bytes(start))]
    except InputError:
        return []


def _solved(problem: Problem, settings: BatchSettings, start: Solution | None) -> Solution:
    return solve(
        problem,
        start=start,
        solver=settings.solver,
        tolerance=settings.tolerance,
        max_iterations=settings.max_iterations,
        max_time=settings.max_time,
    )
