"""Solutions as arguments: objects or files, one or several, and checks on them."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError, shown
from trajopt.motion.solution import Solution

SolutionOrFile = Solution | str | Path
# Largest deviation of a rotation's norm from one: interpolation and single precision cause much less.
UNIT = 1e-2


def solution_of(given: SolutionOrFile) -> Solution:
    """Return a solution: ``given`` itself, or the one read from that path.

    Raises `InputError` for anything else, and `SolutionFileError` if the file cannot be read.
    """
    if isinstance(given, Solution):
        return given
    if isinstance(given, str | Path):
        return Solution.load(given)
    raise InputError(f"{shown(given)} is not a solution", "allowed: a Solution or the path of its file")


def solutions_of(given: SolutionOrFile | Iterable[SolutionOrFile]) -> list[Solution]:
    """Return a list of solutions from one, as in `solution_of`, or from several."""
    if isinstance(given, Iterable) and not isinstance(given, str):
        return [solution_of(one) for one in given]
    return [solution_of(given)]


def consistent_solution(given: SolutionOrFile) -> Solution:
    """Return a solution as `solution_of` does, after checking its consistency.

    Raises `SolutionFileError` for a file and `InputError` for a solution that is inconsistent or not finite.
    """
    solution = solution_of(given)
    if solution is not given:  # already checked when read
        return solution
    return solution.require_consistent()


def require_motion(solution: Solution) -> Solution:
    """Return the solution; raises `InputError` if it is too short, not finite, or has no unit rotations."""
    if solution.n_samples < 2:
        raise InputError(f"the solution has {solution.n_samples} samples", "allowed: two or more")
    for name in ("t", "q", "v", "a", "tau", "f"):
        if not np.isfinite(getattr(solution, name)).all():
            raise InputError(f"'{name}' of the solution holds NaN or infinity", "allowed: finite numbers")
    bent = [row for row, q in enumerate(solution.q) if not pin.isNormalized(solution.model, q, UNIT)]
    if bent:
        raise InputError(f"'q' of the solution holds no rotation at sample {bent[0]}", "allowed: unit norms")
    return solution
