"""Whether two solutions of a problem differ by their meshes, or are different optima."""

from __future__ import annotations

from typing import Any

from trajopt.certify.accuracy.comparison import compare
from trajopt.problem.problem import Problem
from trajopt.solution.grid import mesh_of
from trajopt.solution.solution import Solution
from trajopt.solving.solving import solve

# A solution on the coarser mesh that is nearer to the finer one than this part of the gap is in its optimum.
SAME_SIDE = 0.25


def in_other_optimum(problem: Problem, coarse: Solution, fine: Solution, **settings: Any) -> bool:
    """Whether ``coarse`` differs from a finer solution by more than its mesh: its own mesh has both optima.

    The problem is solved anew on the mesh of ``coarse``, starting from ``fine``. Where that ends near
    ``fine`` and not near ``coarse``, the two are different optima; where it is not solved nothing is known,
    and the answer is False. settings: of `solve`. Raises `InputError` as `compare` and `solve`.
    """
    apart = compare(coarse, fine).farthest
    back = solve(problem, mesh=mesh_of(coarse), start=fine, **settings)
    return back.success and compare(back, fine).farthest < SAME_SIDE * apart
