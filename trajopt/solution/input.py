"""Solutions as functions take them: objects or files, one or several, and motions that can be shown."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError
from trajopt.solution.solution import Solution

Given = Solution | str | Path
# Norms of rotations may be this far from one: interpolation and single precision stay well below.
UNIT = 1e-2


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
    """Return the solution; raises `InputError` for one that is too short or no finite motion."""
    if solution.n_samples < 2:
        raise InputError(f"the solution has {solution.n_samples} samples", "allowed: two or more")
    for name in ("t", "q", "v", "a", "tau", "f"):
        if not np.isfinite(getattr(solution, name)).all():
            raise InputError(f"'{name}' of the solution holds NaN or infinity", "allowed: finite numbers")
    bent = [row for row, q in enumerate(solution.q) if not pin.isNormalized(solution.model, q, UNIT)]
    if bent:
        raise InputError(f"'q' of the solution holds no rotation at sample {bent[0]}", "allowed: unit norms")
    return solution
