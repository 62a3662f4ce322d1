"""Solutions as functions take them: objects or files, one or several, and motions that can be shown."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from trajopt.errors import InputError
from trajopt.solution import Solution

Given = Solution | str | Path


def solutions_of(given: Given | Iterable[Given]) -> list[Solution]:
    """Return the solutions that are meant: ``given`` is one, or the path of its file, or several of them.

    Raises `InputError` for anything else, `SolutionFileError` for a file that cannot be read.
    """
    allowed = "allowed: a Solution or the path of its file, or several in a list"
    if not isinstance(given, Solution | str | Path | Iterable):
        raise InputError(f"{given!r:.60} is no solution", allowed)
    several = [given] if isinstance(given, Solution | str | Path) else list(given)
    for one in several:
        if not isinstance(one, Solution | str | Path):
            raise InputError(f"{one!r:.60} is no solution", allowed)
    return [one if isinstance(one, Solution) else Solution.load(one) for one in several]


def require_motion(solution: Solution) -> Solution:
    """Return the solution; raises `InputError` where it has less than two samples or is not finite."""
    if solution.n_samples < 2:
        raise InputError(f"the solution has {solution.n_samples} samples", "allowed: two or more")
    for name in ("t", "q", "v", "a", "tau", "f"):
        if not np.isfinite(getattr(solution, name)).all():
            raise InputError(f"'{name}' of the solution holds NaN or infinity", "allowed: finite numbers")
    return solution
