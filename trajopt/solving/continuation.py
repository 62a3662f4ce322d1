"""Continuation in a parameter: each problem starts from the last solution (Allgower and Georg, 1990)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from trajopt.arguments import checked
from trajopt.errors import InputError, shown
from trajopt.motion.grid import mesh_of
from trajopt.motion.solution import Solution
from trajopt.problem.problem import Problem
from trajopt.solving.graded import solve_graded
from trajopt.solving.ladder import FROM_DEFAULT_GUESS, GridLevel, solve_figures, total_effort
from trajopt.solving.rounds import Graded
from trajopt.transcription.transcription import chosen_mesh

MAX_HALVINGS = 4
# Solves in the search for the nearest value, including the first value and the requested one.
NEAREST_SOLVES = 8


@dataclass(frozen=True, kw_only=True)
class ContinuationStep:
    """One solve to the grade.

    Args:
        value: Value of the parameter.
        solution: The result.
        origin: Value of the solution from which it started; None for the default guess or a given start.
        asked: Whether the value belongs to the sequence; False for intermediate values.
        warm: Whether it started from a solution.
        cold: Solution of the same problem from its default guess, for comparison.
    """

    value: float
    solution: Solution
    origin: float | None
    asked: bool
    warm: bool
    cold: Solution | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the figures of the step."""
        cold = None if self.cold is None else solve_figures(self.cold)
        step = {"value": self.value, "origin": self.origin, "asked": self.asked}
        return {**step, **solve_figures(self.solution), "warm_start": self.warm, "cold": cold}


@dataclass(frozen=True, kw_only=True)
class Continuation:
    """All solves in order, including failed ones; ``values`` is the requested sequence."""

    values: tuple[float, ...]
    steps: tuple[ContinuationStep, ...]

    @property
    def solutions(self) -> dict[float, Solution]:
        """The last converged solution of each value in the sequence, whatever its verdict."""
        return {step.value: step.solution for step in self.steps if step.asked and step.solution.converged}

    @property
    def solved(self) -> tuple[float, ...]:
        """Values in the sequence whose motion satisfies the check at all times."""
        return tuple(value for value, solution in self.solutions.items() if solution.success)

    @property
    def success(self) -> bool:
        """Whether every value in the sequence is solved."""
        return len(self.solved) == len(set(self.values))

    def to_dict(self) -> dict[str, Any]:
        """Return the steps, totals over all solves, and totals from default guesses if compared."""
        cold = [step.cold for step in self.steps if step.cold is not None]
        record: dict[str, Any] = {
            "values": list(self.values),
            "success": self.success,
            "steps": [step.to_dict() for step in self.steps],
            "total": total_effort([step.solution for step in self.steps]),
            "cold": total_effort(cold) if cold else None,
        }
        if cold:
            record["cold_solved"] = sum(solution.converged for solution in cold)
            record["saved"] = {key: record["cold"][key] - value for key, value in record["total"].items()}
        return record


@checked
def continuation(
    load: Callable[[float], Problem],
    values: Sequence[float],
    *,
    start: Solution | str | Path | None = None,
    compare: bool = False,
    max_halvings: int = MAX_HALVINGS,
    on_step: Callable[[ContinuationStep], None] | None = None,
    transcription: str | None = None,
    intervals: int | None = None,
    **settings: Any,
) -> Continuation:
    """Solve ``load(value)`` for each value in turn, starting from the last solution.

    Each value is solved to the grade as by `trajopt.solve`, on the mesh of the last solution, refined where
    needed, and with its collision rows. Functions are compiled once if the parameter changes only numbers.

    Args:
        load: Returns the problem at a value of the parameter.
        values: Values in the order in which they are solved.
        start: Solution, or its file, for the first value; default: the first problem's guess.
        compare: Also solve each value from its default guess, to measure the time saved.
        max_halvings: If a value is not solved, the step from the last solved one is halved up to this many
            times; then the default guess is tried.
        on_step: Called after each value and each intermediate step.
        transcription: Scheme of a fixed mesh, as in `trajopt.solve`.
        intervals: Number of its intervals over the whole schedule.
        **settings: Arguments of `trajopt.solve`; the time limit applies to each solve.

    Raises:
        InputError: As ``load`` and `trajopt.solve` do.
    """
    asked = tuple(float(value) for value in values)
    if not asked:
        raise InputError("values of continuation are empty", "allowed: at least one finite number")
    if not isinstance(max_halvings, int) or isinstance(max_halvings, bool) or max_halvings < 0:
        raise InputError(f"max_halvings is {shown(max_halvings)}", "allowed: a whole number of at least 0")
    walk = _Walk(load, (transcription, intervals), settings, on_step, start)
    for value in asked:
        if not walk.to(value, max_halvings, compare):
            break
    return Continuation(values=asked, steps=tuple(walk.steps))


def nearest(
    load: Callable[[float], Problem],
    first: float,
    asked: float,
    *,
    most: int = NEAREST_SOLVES,
    transcription: str | None = None,
    intervals: int | None = None,
    on_step: Callable[[ContinuationStep], None] | None = None,
    **settings: Any,
) -> ContinuationStep | None:
    """Return the solved step nearest to ``asked``, found by bisection from ``first``.

    Each solve starts from the last solution. Returns None if ``first`` is not solved.

    Args:
        load: Returns the problem at a value of the parameter.
        first: A value that can be solved.
        asked: The requested value, tried second.
        most: Largest number of solves.
        transcription: Scheme of a fixed mesh, as in `trajopt.solve`.
        intervals: Number of its intervals.
        on_step: Called after each solve.
        **settings: Arguments of `trajopt.solve`; limits of time and iterations apply to each solve.

    Raises:
        InputError: As ``load`` and `trajopt.solve` do.
    """
    walk = _Walk(load, (transcription, intervals), settings, on_step, None)
    value, beyond = first, asked
    for _ in range(most):
        made = walk.solve(value)
        if made.interrupted or walk.origin in (None, asked):
            break
        if not _usable(made):
            beyond = value
        value = asked if value == first else (walk.origin + beyond) / 2
    return max(
        (step for step in walk.steps if step.solution.converged),
        key=lambda step: -abs(step.value - asked),
        default=None,
    )


@dataclass
class _Walk:
    """The steps so far, and the last usable solution with its value (None: a given start)."""

    load: Callable[[float], Problem]
    grid: GridLevel
    settings: dict[str, Any]
    on_step: Callable[[ContinuationStep], None] | None
    start: Solution | str | Path | None
    origin: float | None = None
    last: Graded | None = None
    steps: list[ContinuationStep] = field(default_factory=list)

    def to(self, value: float, halvings: int, compare: bool) -> bool:
        """Continue to ``value``, with intermediate steps if needed; return False if the user stops it."""
        targets = [value]
        while targets:
            made = self.solve(targets[-1], asked=len(targets) == 1)
            if _usable(made):
                targets.pop()
            elif made.interrupted:
                return False
            elif self.origin is None or not halvings:
                break
            else:
                halvings -= 1
                targets.append((self.origin + targets[-1]) / 2)
        if targets and self.start is not None and self.solve(value, default_guess=True).interrupted:
            return False
        return not (compare and self.compare(value))

    def solve(self, value: float, *, asked: bool = True, default_guess: bool = False) -> Graded:
        """Solve to the grade, from the last solution or from the problem's default guess."""
        start = None if default_guess else self.start
        made = self._graded(value, f"value {value:g}", start)
        origin = None if start is None else self.origin
        step = ContinuationStep(
            value=value, solution=made.solution, origin=origin, asked=asked, warm=start is not None
        )
        self.steps.append(step)
        if _usable(made):
            self.start, self.origin, self.last = made.solution, value, made
        if self.on_step is not None:
            self.on_step(step)
        return made

    def _graded(self, value: float, label: str, start: Solution | str | Path | None) -> Graded:
        problem, named = self.load(value), self.grid != (None, None)
        mesh = chosen_mesh(problem, *self.grid) if named else None
        exchange = None
        if start is not None and self.last is not None:
            exchange = self.last.exchange
            mesh = mesh or mesh_of(self.last.solution)
        return solve_graded(
            problem,
            mesh=mesh,
            start=start,
            exchange=exchange,
            refine=not named,
            **{**self.settings, "label": label},
        )

    def compare(self, value: float) -> bool:
        """Solve from the default guess unless the last step at ``value`` did; True if the user stops it."""
        index = max(i for i, step in enumerate(self.steps) if step.asked and step.value == value)
        cold, stopped = self.steps[index].solution, False
        if self.steps[index].warm:
            made = self._graded(value, f"value {value:g} {FROM_DEFAULT_GUESS}", None)
            cold, stopped = made.solution, made.interrupted
        self.steps[index] = replace(self.steps[index], cold=cold)
        return stopped


def _usable(made: Graded) -> bool:
    """Return whether the next solve can start there: the motion and the last round both converged."""
    return made.solution.converged and made.rounds[-1].solved
