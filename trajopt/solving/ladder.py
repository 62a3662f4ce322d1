"""Grid sequencing: solve on a coarse grid, resample the solution onto a finer one, solve again."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trajopt.arguments import checked
from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.solution.solution import Solution
from trajopt.solving.graded import solve_graded
from trajopt.transcription.transcription import chosen_mesh

# A scheme and a number of intervals over the whole schedule; None is the problem's.
GridLevel = tuple[str | None, int | None]
# The label of a solve that others are compared with.
FROM_DEFAULT_GUESS = "from the default guess"


@dataclass(frozen=True, kw_only=True)
class Ladder:
    """Solutions on all grids, coarse to fine, and on the finest from the default guess if asked for."""

    rungs: tuple[Solution, ...]
    cold: Solution | None = None

    @property
    def solution(self) -> Solution:
        """The solution on the finest grid."""
        return self.rungs[-1]

    def to_dict(self) -> dict[str, Any]:
        """Figures of every solve and their totals, and of the solve from the default guess."""
        return {
            "rungs": [solve_figures(rung) for rung in self.rungs],
            "total": total_effort(self.rungs),
            "cold": None if self.cold is None else solve_figures(self.cold),
        }


def solve_figures(solution: Solution) -> dict[str, Any]:
    """How a solution was found: grid, start, status, objective; iterations and time of all its rounds."""
    keys = ("transcription", "warm_start", "status", "success", "objective")
    last = ("build_time_s", "compile_time_s", "functions_compiled")
    figures = {key: getattr(solution.statistics, key) for key in (*keys, *last)}
    return {"intervals": solution.n_intervals, **figures, **total_effort([solution])}


def total_effort(solutions: Sequence[Solution]) -> dict[str, Any]:
    """Iterations and the solver's time in s of several solves together, each with all its rounds."""
    rounds = [each for solution in solutions for each in solution.statistics.rounds]
    return {key: sum(getattr(each, key) for each in rounds) for key in ("iterations", "wall_time_s")}


@checked
def solve_ladder(
    problem: Problem,
    ladder: Sequence[GridLevel],
    *,
    start: Solution | str | Path | None = None,
    compare: bool = False,
    perturb: float = 0.0,
    **settings: Any,
) -> Ladder:
    """Solve on every grid of ``ladder`` in turn, each from the last one solved.

    On every grid bodies are kept apart and the motion is judged as by `trajopt.solve` on a named mesh; rows
    for bodies go on to the next one. A solution that is not feasible does not start the next solve.

    Args:
        problem: What to solve.
        ladder: Pairs of scheme and number of intervals over the whole schedule, None for the problem's.
        start: A solution, or its file, for the first grid.
        compare: Solve on the last grid from the default guess, too.
        perturb: Noise on the first start, as in `trajopt.solve`.
        **settings: Those of `trajopt.solve`; the limit of time is for each rung.

    Raises:
        InputError: As `trajopt.solve` does, and for a ladder without grids.
    """
    rungs = [chosen_mesh(problem, *entry) for entry in ladder]
    if not rungs:
        raise InputError("the ladder has no rung", "allowed: pairs of scheme and number of intervals")
    solutions: list[Solution] = []
    exchange = None
    for index, mesh in enumerate(rungs):
        noise = perturb if index == 0 else 0.0
        label = f"rung {index + 1} of {len(rungs)}" if len(rungs) > 1 else ""
        settings |= {"start": start, "perturb": noise, "label": label}
        made = solve_graded(problem, mesh=mesh, exchange=exchange, refine=False, **settings)
        solutions.append(made.solution)
        if made.interrupted:
            break
        start, exchange = made.solution if made.solution.converged else start, made.exchange
    cold = None
    if compare and not made.interrupted:
        settings |= {"start": None, "perturb": 0.0, "label": FROM_DEFAULT_GUESS}
        cold = solve_graded(problem, mesh=rungs[-1], refine=False, **settings).solution
    return Ladder(rungs=tuple(solutions), cold=cold)
