"""Optima of pruned and full problems, and how well two of them agree."""

import trajopt
from trajopt import Problem, Solution

# Solvers stop at 1e-8 in natural units; two ways to write one problem differ by that over costs of 1e-3.
SOLVED = 1e-8
SAME_OPTIMUM = 1e-5
SAME_MOTION = 1e-4  # rad, m: where the optimum is flat its minimiser is less sharp than its value
MOST_ITERATIONS = 60


def solved(problem: Problem, intervals: int | None = None, perturb: float = 0.0) -> Solution:
    solution = trajopt.solve(
        problem,
        intervals=intervals,
        perturb=perturb,
        tolerance=SOLVED,
        max_iterations=MOST_ITERATIONS,
        fixed_mesh=True,
    )
    assert solution.converged, solution.statistics.advice
    return solution


def objective(solution: Solution) -> float:
    return float(solution.statistics.objective)
