"""Solve to an accuracy or within a time: choose, solve, measure, and refine what falls short."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from trajopt.certify.accuracy.measures import Accuracy, measure
from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.solution.solution import Solution
from trajopt.solving.ladder import INTERRUPTED
from trajopt.solving.refine import Refinement, Round, phase_errors, refine
from trajopt.solving.solving import solve
from trajopt.solving.verdicts import is_usable_start
from trajopt.study.choosing.choice import Choice, choices_by_time, choose_for_accuracy
from trajopt.study.sweep.front import Filter

# What is predicted for a setting may be this part of what is left: predictions err.
MOST_SHARE = 0.8
# Another, more accurate setting is tried while its time, as measured so far, fits into what is left.
MOST_SETTINGS = 4
# A solver that is left less than this, s, makes no iteration of use.
LEAST_TIME = 1e-3


@dataclass(frozen=True, kw_only=True)
class Aimed:
    """What was chosen, solved and measured.

    choices: settings in the order in which they were tried. rounds: all solves. spent: s, of the solver.
    accuracy: of ``solution``, None where it is none. goal: ``accuracy`` m, or ``budget`` s of the solver.
    """

    goal: str
    wanted: float
    choices: tuple[Choice, ...]
    rounds: tuple[Round, ...]
    solution: Solution
    accuracy: Accuracy | None
    why: str

    @property
    def spent(self) -> float:
        """Time of the solver in all rounds, s."""
        return sum(own.wall_time for own in self.rounds)

    @property
    def error(self) -> float:
        """Largest error of a phase of the solution, m; inf where nothing was solved."""
        return math.inf if self.accuracy is None else max(phase_errors(self.accuracy))

    @property
    def reached(self) -> bool:
        """Whether the goal is met, by measurement."""
        found = self.error if self.goal == "accuracy" else self.spent
        return self.solution.success and found <= self.wanted

    def to_dict(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "goal": self.goal,
            "wanted": self.wanted,
            "reached": self.reached,
            "error_m": self.error if math.isfinite(self.error) else None,
            "spent_s": self.spent,
            "why": self.why,
            "choices": [choice.to_dict() for choice in self.choices],
            "rounds": [own.to_dict() for own in self.rounds],
        }


def solve_to_accuracy(
    problem: Problem,
    accuracy: float,
    *,
    front: str | Path | None = None,
    where: Filter | None = None,
    start: Solution | str | Path | None = None,
    **settings: Any,
) -> Aimed:
    """Solve to an error of ``accuracy`` m in every phase: the fastest measured setting, then refinement.

    The error is `refinement.phase_errors`: open loop by numeric Pinocchio, or drift of contacts. front: a
    measured front to choose from; default: the packaged one that is most like the problem. where: settings
    that may be chosen. ``settings`` are those of `trajopt.solve` but its grid, solver and tolerance.
    Raises InputError for an accuracy that is no length, and as `trajopt.solve` does.
    """
    _require(accuracy, "accuracy", "m")
    choice = choose_for_accuracy(problem, accuracy, front=front, where=where)
    solver = choice.solver
    first = solve(problem, mesh=choice.mesh, start=start, label="chosen mesh", **solver, **settings)
    if first.meta["status"] == INTERRUPTED:
        made = Refinement(
            target=accuracy,
            solution=first,
            accuracy=None,
            rounds=(Round.of(choice.mesh, first),),
            why="interrupted",
        )
    else:
        further = {name: value for name, value in solver.items() if name != "tolerance"}
        origin: dict[str, Any] = {"start": first}
        if not is_usable_start(first):
            origin = {"mesh": choice.mesh, "start": start}
        made = refine(problem, accuracy, **origin, **further, **settings)
        if not is_usable_start(first):
            made = replace(made, rounds=(Round.of(choice.mesh, first), *made.rounds))
    return _finished(
        Aimed(
            goal="accuracy",
            wanted=float(accuracy),
            choices=(choice,),
            rounds=made.rounds,
            solution=made.solution,
            accuracy=made.accuracy,
            why=made.why,
        )
    )


def solve_within(
    problem: Problem,
    budget: float,
    *,
    front: str | Path | None = None,
    where: Filter | None = None,
    start: Solution | str | Path | None = None,
    **settings: Any,
) -> Aimed:
    """The most accurate solution that ``budget`` s of the solver give: a fast one first, then better ones.

    Building and compiling, which happen once, do not count; `Solution.meta` has their times. Arguments as of
    `solve_to_accuracy`. Raises InputError for a budget that is no time, and as `trajopt.solve` does.
    """
    _require(budget, "budget", "s")
    settings.pop("max_time", None)
    search = _Search(problem, float(budget), settings)
    search.run(choices_by_time(problem, front=front, where=where), start)
    return search.result()


class _Search:
    def __init__(self, problem: Problem, budget: float, settings: dict[str, Any]) -> None:
        self.problem, self.budget, self.settings = problem, budget, settings
        self.tried: list[Choice] = []
        self.rounds: list[Round] = []
        self.best: Solution | None = None
        self.last: Solution | None = None
        self.why = "the time is used"

    @property
    def left(self) -> float:
        return self.budget - sum(own.wall_time for own in self.rounds)

    def run(self, choices: tuple[Choice, ...], start: Solution | str | Path | None) -> None:
        """A fast setting, then the most accurate that fits into what is left, by corrected predictions."""
        remaining, pick, ratio = list(choices), choices[0], 1.0
        for _ in range(MOST_SETTINGS):
            remaining = remaining[remaining.index(pick) + 1 :]
            took = self._solve(pick, self.best or start)
            if self.last is not None and self.last.meta["status"] == INTERRUPTED:
                self.why = "interrupted"
                return
            ratio = max(took / pick.predicted_time, ratio if self.best is None else 0.0)
            fitting = [
                choice for choice in remaining if ratio * choice.predicted_time <= MOST_SHARE * self.left
            ]
            if not fitting:
                self.why = (
                    "no better setting is predicted to fit into what is left"
                    if remaining
                    else ("the most accurate measured setting is reached")
                )
                return
            pick = fitting[-1]

    def _solve(self, choice: Choice, start: Solution | str | Path | None) -> float:
        begin = time.perf_counter()
        found = solve(
            self.problem,
            mesh=choice.mesh,
            start=start,
            label=f"setting {len(self.tried) + 1}",
            max_time=max(self.left, LEAST_TIME),
            **choice.solver,
            **self.settings,
        )
        self.tried.append(choice)
        self.rounds.append(Round.of(choice.mesh, found))
        self.last = found
        if found.success:
            self.best = found
        return min(found.meta["wall_time_s"], time.perf_counter() - begin)

    def result(self) -> Aimed:
        solution = self.best or self.last
        assert solution is not None
        accuracy = measure(solution) if solution.success else None
        return _finished(
            Aimed(
                goal="budget",
                wanted=self.budget,
                choices=tuple(self.tried),
                rounds=tuple(self.rounds),
                solution=solution,
                accuracy=accuracy,
                why=self.why if solution.success else "nothing was solved in that time",
            )
        )


def _finished(aimed: Aimed) -> Aimed:
    """With what was aimed at and reached in the solution's meta."""
    meta = {name: value for name, value in aimed.solution.meta.items() if name != "refinement"}
    return replace(aimed, solution=replace(aimed.solution, meta={**meta, "aimed": aimed.to_dict()}))


def _require(value: float, name: str, unit: str) -> None:
    if not (isinstance(value, int | float) and math.isfinite(value) and value > 0):
        raise InputError(f"{name} is {value!r} {unit}", "allowed: finite and > 0")
