"""Solve to an accuracy or within a time: choose, solve, measure, and refine if needed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from trajopt.arguments import Positive, checked
from trajopt.certify.accuracy.measures import Accuracy, measure
from trajopt.problem import Problem
from trajopt.solution.meta import jsonable
from trajopt.solution.solution import Solution
from trajopt.solvers.result import LEAST_TIME
from trajopt.solving.deprecation import accepts_compile
from trajopt.solving.graded import MOST_ROUNDS, USUAL_TOLERANCE, solve_graded
from trajopt.solving.rounds import INTERRUPTED, Round, largest_error
from trajopt.solving.solving import solve
from trajopt.study.choosing.choice import ChosenSetting, choices_by_time, choose_for_accuracy
from trajopt.study.sweep.front import SettingFilter

# A setting is tried if its predicted time is below this fraction of the time left: predictions err.
MOST_SHARE = 0.8
# Most settings tried: another, more accurate one if its time, corrected by those measured, fits into the time
# left.
MOST_SETTINGS = 4


@dataclass(frozen=True)
class TargetSolve:
    """The settings chosen, the solves, and the measured accuracy.

    choices: settings in the order in which they were tried. rounds: all solves. spent: s, of the solver.
    accuracy: of ``solution``, None if it was not solved. goal: ``accuracy`` m, or ``budget`` s of the solver.
    """

    goal: str
    wanted: float
    choices: tuple[ChosenSetting, ...]
    rounds: tuple[Round, ...]
    solution: Solution
    accuracy: Accuracy | None
    why: str

    @property
    def spent(self) -> float:
        """Time of the solver in all rounds, s."""
        return sum(solve.wall_time for solve in self.rounds)

    @property
    def error(self) -> float:
        """Largest error of a phase of the solution, m; inf where nothing was solved."""
        return largest_error(self.accuracy)

    @property
    def reached(self) -> bool:
        """Whether the goal is met, by measurement, with a motion that holds at any time."""
        found = self.error if self.goal == "accuracy" else self.spent
        return self.solution.success and found <= self.wanted

    def to_dict(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "goal": self.goal,
            "wanted": self.wanted,
            "reached": self.reached,
            "error_m": jsonable(self.error),
            "spent_s": self.spent,
            "why": self.why,
            "choices": [choice.to_dict() for choice in self.choices],
            "rounds": [jsonable(vars(solve.statistics)) for solve in self.rounds],
        }


@accepts_compile
@checked
def solve_to_accuracy(
    problem: Problem,
    accuracy: Positive,
    *,
    front: str | Path | None = None,
    where: SettingFilter | None = None,
    start: Solution | str | Path | None = None,
    **settings: Any,
) -> TargetSolve:
    """Solve to an error of ``accuracy`` m in every phase and to the grade: measured setting, then refinement.

    The error is `rounds.phase_errors`: open loop by numeric Pinocchio, or drift of contacts. front: a
    measured front to choose from; default: the packaged one that is most like the problem. where: settings
    that may be chosen. ``settings`` are those of `trajopt.solve` but its grid, solver and tolerance.
    Raises InputError for an invalid accuracy, and as `trajopt.solve` does.
    """
    wanted = float(accuracy)
    choice = choose_for_accuracy(problem, accuracy, front=front, where=where)
    own = {**choice.solver, **settings}
    made = solve_graded(problem, mesh=choice.mesh, start=start, accuracy=wanted, **own)
    return _recorded(
        TargetSolve("accuracy", wanted, (choice,), made.rounds, made.solution, made.accuracy, made.why)
    )


@accepts_compile
@checked
def solve_within(
    problem: Problem,
    budget: Positive,
    *,
    front: str | Path | None = None,
    where: SettingFilter | None = None,
    start: Solution | str | Path | None = None,
    **settings: Any,
) -> TargetSolve:
    """The most accurate solution that ``budget`` s of the solver give: a fast one first, then better ones.

    What is left is spent on rows for bodies and finer meshes, until the motion has the grade. Building and
    compiling, which happen once, do not count; `Solution.meta` has their times. Arguments as in
    `solve_to_accuracy`. Raises InputError for an invalid budget, and as `trajopt.solve` does.
    """
    settings.pop("max_time", None)
    remaining = choices_by_time(problem, front=front, where=where)
    tried: list[ChosenSetting] = []
    rounds: list[Round] = []
    best: Solution | None = None
    left, ratio, why = float(budget), 1.0, "the time is used"
    pick: ChosenSetting | None = remaining[0]
    while pick is not None and len(tried) < MOST_SETTINGS:
        tried.append(pick)
        own = {**pick.solver, **settings, "label": f"setting {len(tried)}", "max_time": max(left, LEAST_TIME)}
        found = solve(problem, mesh=pick.mesh, start=best or start, judge=False, **own)
        rounds.append(Round.of(pick.mesh, found))
        best = found if found.converged else best
        if found.meta["status"] == INTERRUPTED:
            why = INTERRUPTED
            break
        # The measured time corrects the predictions for the others.
        ratio = max(rounds[-1].wall_time / pick.predicted_time, ratio if best is None else 0.0)
        left -= rounds[-1].wall_time
        remaining = remaining[remaining.index(pick) + 1 :]
        fitting = [choice for choice in remaining if ratio * choice.predicted_time <= MOST_SHARE * left]
        pick = fitting[-1] if fitting else None
        if not remaining:
            why = "the most accurate measured setting is reached"
        elif not fitting:
            why = "no better setting is predicted to fit into the time left"
    if best is None:
        made, why = found, "nothing was solved in that time"
    else:
        own = {**tried[-1].solver, **settings}
        own["tolerance"] = min(own["tolerance"], USUAL_TOLERANCE)
        own["max_time"] = left + best.meta["wall_time_s"]  # that of the first round counts, too
        most = 1 if why == INTERRUPTED else MOST_ROUNDS
        graded = solve_graded(problem, first=best, max_rounds=most, **own)
        rounds += graded.rounds[1:]
        made, why = graded.solution, why if len(graded.rounds) == 1 else f"{why}; {graded.why}"
    accuracy = None if best is None else measure(made)
    return _recorded(TargetSolve("budget", float(budget), tuple(tried), tuple(rounds), made, accuracy, why))


def _recorded(found: TargetSolve) -> TargetSolve:
    """The goal and what was reached, also in the solution's meta."""
    more = {**found.solution.statistics.more, "aimed": found.to_dict()}
    return replace(found, solution=found.solution.with_statistics(graded=None, more=more))
