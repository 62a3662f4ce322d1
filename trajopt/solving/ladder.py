"""Coarse to fine: solve on a coarse grid, resample, refine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.solution.solution import Solution
from trajopt.solving.solving import solve
from trajopt.solving.verdicts import is_start
from trajopt.transcription.schemes import scheme

# A rung is a scheme and a number of intervals; None is the problem's own.
Rung = tuple[str | None, int | None]
# What a user's interruption leaves is no rung to climb from.
INTERRUPTED = "interrupted"
# The label of a solve that others are compared with.
OWN_GUESS = "from its own guess"


@dataclass(frozen=True, kw_only=True)
class Ladder:
    """Solutions of all rungs, coarse to fine, and of the finest from the problem's own guess if asked for."""

    rungs: tuple[Solution, ...]
    cold: Solution | None = None

    @property
    def solution(self) -> Solution:
        """The finest rung's."""
        return self.rungs[-1]

    def to_dict(self) -> dict[str, Any]:
        """Figures of every rung and their totals, and of the solve from the problem's own guess."""
        cold = None if self.cold is None else figures(self.cold)
        return {"rungs": [figures(rung) for rung in self.rungs], "total": total(self.rungs), "cold": cold}


def figures(solution: Solution) -> dict[str, Any]:
    """How a solution was found: grid, start, status, iterations, times in s, objective."""
    meta = solution.meta
    keys = ("transcription", "warm_start", "status", "success", "iterations", "objective")
    times = ("wall_time_s", "build_time_s", "compile_time_s", "functions_compiled")
    return {"intervals": solution.n_intervals, **{key: meta[key] for key in (*keys, *times)}}


def total(solutions: Sequence[Solution]) -> dict[str, Any]:
    """Iterations and the solver's time in s of several solves together."""
    return {
        "iterations": sum(solution.meta["iterations"] for solution in solutions),
        "wall_time_s": sum(solution.meta["wall_time_s"] for solution in solutions),
    }


def solve_ladder(
    problem: Problem,
    ladder: Sequence[Rung],
    *,
    start: Solution | str | Path | None = None,
    compare: bool = False,
    perturb: float = 0.0,
    **settings: Any,
) -> Ladder:
    """Solve on every grid of ``ladder`` in turn, each from the last one solved.

    ladder: pairs of scheme and number of intervals over the whole schedule, None for the problem's own.
    start: a solution, or its file, for the first rung. perturb: noise on the first rung's start.
    compare: solve the last rung from the problem's own guess, too. ``settings`` are those of `trajopt.solve`;
    limits of time and iterations are for each rung.

    A rung that is not solved is left out as a start. Raises InputError as `trajopt.solve` does.
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
        start = found[-1] if is_start(found[-1]) else start
    compared = compare and found[-1].meta["status"] != INTERRUPTED
    cold = solve(problem, **rungs[-1], label=OWN_GUESS, **settings) if compared else None
    return Ladder(rungs=tuple(found), cold=cold)


def _rung(problem: Problem, entry: Rung) -> dict[str, Any]:
    """Arguments of a solve; wrong ones are refused before anything is solved."""
    if not isinstance(entry, tuple | list) or len(entry) != 2:
        raise InputError(f"rung {entry!r}", "allowed: (scheme, intervals), such as ('legendre:1', 15)")
    name, intervals = entry
    if name is not None:
        scheme(name)
    if intervals is not None:
        problem.schedule.intervals(intervals)
    return {"transcription": name, "intervals": intervals}
