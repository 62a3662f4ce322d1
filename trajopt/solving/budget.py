"""Solve within a time budget: reach the grade first, then refine while another round is expected to fit."""

from dataclasses import replace
from typing import Any

from trajopt.arguments import Positive, checked
from trajopt.certify.accuracy.measures import measure
from trajopt.problem.problem import Problem
from trajopt.solving.graded import solve_graded
from trajopt.solving.rounds import Graded, phase_errors

# Target of the next round, as a fraction of the last measured error.
GAIN = 0.1
# The next round is expected to take this many times as long as the last: a tenth of the error needs a third
# more intervals at degree four, and phases that miss their target are split in two.
GROWTH = 2.0


@checked
def solve_within(problem: Problem, budget: Positive, **settings: Any) -> Graded:
    """Return the most accurate motion within the grade that the solver finds in a given time.

    The first solve reaches the grade. Each further round refines the mesh for a tenth of the measured error,
    as long as twice the solver time of the last round is left. Building and compiling do not count against
    the budget.

    Args:
        problem: The problem to solve.
        budget: Solver time, s.
        **settings: Arguments of `trajopt.solving.solve_graded` except ``accuracy`` and ``max_time``.

    Returns:
        The motion with its measured error, all rounds, and the reason why they ended.

    Raises:
        InputError: As `trajopt.solve` does.
    """
    settings["solver_time"] = True
    made = solve_graded(problem, max_time=budget, **settings)
    if not made.solution.converged or problem.dynamics_kind == "own":
        return made
    accuracy, why = measure(made.solution), made.why
    rounds = (*made.rounds[:-1], replace(made.rounds[-1], errors=phase_errors(accuracy)))
    made = replace(made, accuracy=accuracy, rounds=rounds)
    for name in ("start", "seed", "perturb", "exchange"):  # only the first solve uses these
        settings.pop(name, None)
    while made.solution.success and not made.interrupted:
        left = budget - sum(one.wall_time for one in rounds)
        if GROWTH * made.rounds[-1].wall_time > left:
            why = "another round is not expected to fit into the time that is left"
            break
        finer = solve_graded(
            problem,
            **{**settings, "max_rounds": 2},
            first=made.solution,
            exchange=made.exchange,
            accuracy=GAIN * made.error,
            max_time=left + made.solution.statistics.wall_time_s,  # the given first round counts against it
        )
        rounds += finer.rounds[1:]
        if not finer.solution.success or finer.error >= made.error:
            why = finer.why
            break
        made = finer
    made = replace(made, rounds=rounds, why=why, target=None)
    graded = replace(made.statistics, error_m=made.error)
    return replace(made, solution=made.solution.with_statistics(graded=graded))
