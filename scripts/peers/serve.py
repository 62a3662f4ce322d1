"""Our half of a comparison: requests as lines of JSON on stdin, answers on stdout, one at a time.

{"do": "describe", "task": "walk"}                                         robot: masses, posture
{"do": "solve", "task": "walk", "scheme": "legendre:3", "intervals": 4, "linear_solver": "stages",
 "threads": 1}
{"do": "open-loop", ...}                                                   errors of the last of these solves

Functions are compiled, and problems transcribed, before the first solve that needs them: no time counts that.
"""

from functools import cache
from typing import Any

import numpy as np

from scripts.peers import problems
from scripts.peers.halves import answer
from scripts.peers.tasks import TASKS
from trajopt.certify.reintegration import integrated_states
from trajopt.motion.quantities import MotionQuantities
from trajopt.motion.solution import Solution
from trajopt.problem import Problem
from trajopt.solvers.ipopt import LINEAR_SOLVER
from trajopt.solving.solving import PreparedProblem, prepare, solve_prepared

_SOLVED: dict[tuple[str, str, int, str, int], Solution] = {}


@cache
def _problem(task: str) -> Problem:
    return problems.build(TASKS[task])


@cache
def _prepared(task: str, scheme: str, intervals: int, threads: int) -> PreparedProblem:
    problem = _problem(task)
    return prepare(problem, mesh=problems.mesh(problem, scheme, intervals), threads=threads)


def describe(task: str) -> dict[str, Any]:
    """What has to be the same on both sides."""
    robot = _problem(task).robot
    masses = [inertia.mass for inertia in robot.model.inertias]
    return {"masses": masses, "posture": robot.reference.tolist()}


def solve(task: str, scheme: str, intervals: int, linear_solver: str, threads: int) -> dict[str, Any]:
    """Time of the solver in s, its iterations, and whether the problem is solved."""
    prepared = _prepared(task, scheme, intervals, threads)
    options = {LINEAR_SOLVER: linear_solver}
    found = solve_prepared(prepared, prepared.guess, origin={}, judge=False, options=options)
    _SOLVED[task, scheme, intervals, linear_solver, threads] = found
    return {
        "seconds": found.statistics.wall_time_s,
        "iterations": found.statistics.iterations,
        "solved": found.statistics.success,
    }


def open_loop(task: str, scheme: str, intervals: int, linear_solver: str, threads: int) -> dict[str, Any]:
    """Errors of the base's position in m, at the end and the largest at nodes; largest torque, N m."""
    plan = _SOLVED[task, scheme, intervals, linear_solver, threads]
    motion, errors = MotionQuantities(plan), []
    for rows, state in zip(plan.intervals, integrated_states(motion, range(plan.n_intervals)), strict=False):
        apart = np.inf if state is None else motion.distance_from(rows.stop - 1, state[0])[0]
        errors.append(float(apart))
    torque = float(np.abs(plan.tau[plan.collocation]).max())
    return {"end": errors[-1], "largest": max(errors), "torque": torque}


ANSWERS = {"describe": describe, "solve": solve, "open-loop": open_loop}


if __name__ == "__main__":
    answer(ANSWERS)
