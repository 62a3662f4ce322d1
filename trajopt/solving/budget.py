"""Solve within a time: to the grade first, then finer, while another round is expected to fit."""

from dataclasses import replace
from typing import Any

from trajopt.arguments import Positive, checked
from trajopt.certify.accuracy.measures import measure
from trajopt.problem.problem import Problem
from trajopt.solving.graded import solve_graded
from trajopt.solving.rounds import Graded, phase_errors

# The part of the last error that the next round aims at.
GAIN = 0.1
# An iteration of that round is expected to take this many times as long: a tenth of the error takes a third
# more intervals at degree four, and phases that miss are split in two.
GROWTH = 2.0


@checked
def solve_within(problem: Problem, budget: Positive, **settings: Any) -> Graded:
    """The most accurate motion of the grade that is found in a time of the solver.

    A first solve goes to the grade. Each further round refines the mesh to a tenth of the measured error,
    as long as the iterations of the last round, at the time that each took, leave room for it. Building
    and compiling, which happen once, do not count.

    Args:
        problem: What to solve.
        budget: Time of the solver, s.
        **settings: Those of `trajopt.solving.solve_graded` but ``accuracy`` and ``max_time``.

    Returns:
        The motion with its measured error, all rounds, and why they ended.

    Raises:
        InputError: As `trajopt.solve` does.
    """
    settings["solver_time"] = True
    made = solve_graded(problem, max_time=budget, **settings)
    if not made.solution.converged or not problem.holds_contacts:
        return made
    accuracy, why = measure(made.solution), made.why
    rounds = (*made.rounds[:-1], replace(made.rounds[-1], errors=phase_errors(accuracy)))
    made = replace(made, accuracy=accuracy, rounds=rounds)
    for name in ("start", "seed", "perturb", "exchange"):  # of the first solve
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
            max_time=left + made.solution.statistics.wall_time_s,  # that of the first round counts, too
        )
        rounds += finer.rounds[1:]
        if not finer.solution.success or finer.error >= made.error:
            why = finer.why
            break
        made = finer
    made = replace(made, rounds=rounds, why=why, target=None)
    graded = replace(made.statistics, error_m=made.error)
    return replace(made, solution=made.solution.with_statistics(graded=graded))
