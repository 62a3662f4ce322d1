"""Grid sequencing: solve on a coarse grid, resample the solution onto a finer one, solve again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.solution.solution import Solution
from trajopt.solving.solving import solve
from trajopt.transcription.schemes import scheme

# A scheme and a number of intervals over the whole schedule; None is the problem's.
GridLevel = tuple[str | None, int | None]
# The status of a solve that the user interrupted: nothing starts from it.
INTERRUPTED = "interrupted"
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
        cold = None if self.cold is None else solve_figures(self.cold)
        return {
            "rungs": [solve_figures(rung) for rung in self.rungs],
            "total": total_effort(self.rungs),
            "cold": cold,
        }


def solve_figures(solution: Solution) -> dict[str, Any]:
    """How a solution was found: grid, start, status, iterations, times in s, objective."""
    meta = solution.meta
    keys = ("transcription", "warm_start", "status", "success", "iterations", "objective")
    times = ("wall_time_s", "build_time_s", "compile_time_s", "functions_compiled")
    return {"intervals": solution.n_intervals, **{key: meta[key] for key in (*keys, *times)}}


def total_effort(solutions: Sequence[Solution]) -> dict[str, Any]:
    """Iterations and the solver's time in s of several solves together."""
    return {
        "iterations": sum(solution.meta["iterations"] for solution in solutions),
        "wall_time_s": sum(solution.meta["wall_time_s"] for solution in solutions),
    }


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

    A solution that is not feasible does not start the next solve.

    Args:
        problem: What to solve.
        ladder: Pairs of scheme and number of intervals over the whole schedule, None for the problem's.
        start: A solution, or its file, for the first grid.
        compare: Solve on the last grid from the default guess, too.
        perturb: Noise on the first start, as in `trajopt.solve`.
        **settings: Those of `trajopt.solve`; limits of time and iterations are for each solve.

    Raises:
        InputError: As `trajopt.solve` does, and for a ladder without grids.
    """
    rungs = [_rung(problem, entry) for entry in ladder]
    if not rungs:
        raise InputError("the ladder has no rung", "allowed: pairs of scheme and number of intervals")
    found: list[Solution] = []
    for index, grid in enumerate(rungs):
        noise = perturb if index == 0 else 0.0
        label = f"rung {index + 1} of {len(rungs)}" if len(rungs) > 1 else ""
        found.append(solve(problem, **grid, start=start, perturb=noise, label=label, **settings))
        if found[-1].meta["status"] == INTERRUPTED:
            break
        start = found[-1] if found[-1].converged else start
    compared = compare and found[-1].meta["status"] != INTERRUPTED
    cold = solve(problem, **rungs[-1], label=FROM_DEFAULT_GUESS, **settings) if compared else None
    return Ladder(rungs=tuple(found), cold=cold)


def _rung(problem: Problem, entry: GridLevel) -> dict[str, Any]:
    """Arguments of a solve; wrong ones are refused before anything is solved."""
    if not isinstance(entry, tuple | list) or len(entry) != 2:
        raise InputError(f"rung {entry!r}", "allowed: (scheme, intervals), such as ('legendre:1', 15)")
    name, intervals = entry
    if name is not None:
        scheme(name)
    if intervals is not None:
        problem.schedule.intervals(intervals)
    return {"transcription": name, "intervals": intervals}
