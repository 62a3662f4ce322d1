"""One case of a batch, solved to the grade from a neighbour's solution or from its default guess."""

import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from trajopt.arguments import checked
from trajopt.errors import InputError
from trajopt.motion.energy_use import cost_of_transport, energy
from trajopt.motion.solution import Solution
from trajopt.problem.catalogue import families
from trajopt.problem.family import choose
from trajopt.solving.ladder import total_effort
from trajopt.study.batch.variation import BatchCase
from trajopt.study.solves import SolveSettings, failure_text, file_content

# Iterations on a mesh after which a neighbour's solution has gained nothing; the default guess is tried.
MOST_FROM_NEIGHBOUR = 100


@checked
@dataclass(frozen=True, kw_only=True)
class BatchSettings(SolveSettings):
    """How every case of a batch is solved. Raises `InputError` for invalid values.

    Args:
        solver: as in `trajopt.solve`.
        tolerance: as in `trajopt.solve`.
        max_iterations: as in `trajopt.solve`.
        max_time: for all solves from one start, s.
        neighbours: start from a neighbour's solution, and from the default guess only where that fails.
    """

    neighbours: bool = True

    @property
    def starts(self) -> int:
        """Number of starts of one task."""
        return 1 + self.neighbours


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
    tried: list[Solution] = []
    if start is not None:
        most = min(settings.max_iterations, MOST_FROM_NEIGHBOUR)
        with suppress(InputError):  # the neighbour has other phases or joints
            tried.append(settings.solve(problem, start=Solution.from_bytes(start), max_iterations=most))
    if not (tried and tried[-1].success):
        tried.append(settings.solve(problem))
    best = next((one for one in tried if one.success), tried[-1])
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
    return CaseResult(figures=figures, content=file_content(best))
