"""Mesh sequencing: solve on a coarse mesh, resample the solution onto a finer one, solve again."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trajopt.arguments import checked
from trajopt.errors import InputError
from trajopt.motion.solution import Solution
from trajopt.problem.problem import Problem
from trajopt.solving.graded import solve_graded
from trajopt.transcription.transcription import chosen_mesh

# A scheme and a number of intervals over the whole schedule; None stands for the problem's own.
GridLevel = tuple[str | None, int | None]
# Label of the solve that others are compared with.
FROM_DEFAULT_GUESS = "from the default guess"


@dataclass(frozen=True, kw_only=True)
class Ladder:
    """Solutions on all meshes in order, and on the last one from the default guess if requested."""

    rungs: tuple[Solution, ...]
    cold: Solution | None = None

    @property
    def solution(self) -> Solution:
        """The solution on the last mesh that was solved."""
        return self.rungs[-1]

    def to_dict(self) -> dict[str, Any]:
        """Return the figures of every solve, their totals, and those of the solve from the default guess."""
        return {
            "rungs": [solve_figures(rung) for rung in self.rungs],
            "total": total_effort(self.rungs),
            "cold": None if self.cold is None else solve_figures(self.cold),
        }


def solve_figures(solution: Solution) -> dict[str, Any]:
    """Return the mesh, start, status and objective of a solve, and iterations and time of all its rounds."""
    keys = ("transcription", "warm_start", "status", "success", "objective")
    last = ("build_time_s", "compile_time_s", "functions_compiled")
    figures = {key: getattr(solution.statistics, key) for key in (*keys, *last)}
    return {"intervals": solution.n_intervals, **figures, **total_effort([solution])}


def total_effort(solutions: Sequence[Solution]) -> dict[str, Any]:
    """Return the total iterations and solver time (s) of several solves with all their rounds."""
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
    """Solve on every mesh of ``ladder`` in turn, each time from the last converged solution.

    On each mesh the motion is kept clear of collisions and judged as by `trajopt.solve` on a fixed mesh.
    Collision rows are passed on to the next mesh.

    Args:
        problem: The problem to solve.
        ladder: Pairs of scheme and number of intervals over the whole schedule; None for the problem's own.
        start: Solution, or its file, for the first mesh.
        compare: Also solve on the last mesh from the default guess.
        perturb: Noise on the first start, as in `trajopt.solve`.
        **settings: Arguments of `trajopt.solve`; the time limit applies to each rung.

    Raises:
        InputError: As `trajopt.solve` does, and for an empty ladder.
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
