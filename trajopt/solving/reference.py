"""Compute a converged reference solution: refine the mesh until two successive solutions agree.

The first mesh is the problem's own. The second has the same intervals but the reference's scheme, and each
further mesh doubles the intervals; each solve starts from the last solution. Two solutions agree if
objective, durations and the whole motion do. Agreement of the first two does not count, since an error that
vanishes at the nodes is the same on both meshes.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from trajopt.arguments import Positive, checked
from trajopt.certify.accuracy.comparison import Comparison, compare
from trajopt.errors import InputError, TrajoptError
from trajopt.motion.grid import mesh_of
from trajopt.motion.solution import Solution
from trajopt.problem.problem import Problem
from trajopt.robot.natural_units import NaturalUnits
from trajopt.solving.solving import DEFAULT_SOLVER, solve

# Degree three has order six where controls are smooth; if a limit becomes active or inactive within an
# interval, only more intervals help.
SCHEME = "legendre:3"
# Far below the compared differences: along a flat direction the optimum moves by the square root of the error
# in the objective.
TOLERANCE = 1e-9
# Relative change of the objective between two meshes; weights are not meaningful to more digits.
OBJECTIVE = 1e-5
# Largest distance between two motions, over the robot's reach: half a millimetre for a dog-sized robot.
DISTANCE = 1e-3
# Motions further apart than this, over the reach, may be different optima and are tested.
OPTIMUM_DISTANCE = 0.02
# So are motions this many times as far apart as the two before them: refinement alone reduces the distance.
DISTANCE_GROWTH = 2.0
# A solution on the coarser mesh belongs to the finer mesh's optimum if its distance from it is below this
# fraction of the gap.
SAME_SIDE = 0.25
MAX_UNKNOWNS = 200_000
MAX_TIME = 600.0
# Smallest time limit, s, of a solve that starts just before the deadline.
LEAST_TIME = 1.0

Start = Solution | str | Path | None


@checked
@dataclass(frozen=True, kw_only=True)
class Agreement:
    """How far two solutions that agree may be apart.

    ``objective`` is relative; ``distance`` is over the reach l, or over sqrt(l / g) for durations. Joints are
    compared too, in rad (over l in m if l > 1 m): they may turn without any named point moving.
    """

    objective: Positive = OBJECTIVE
    distance: Positive = DISTANCE

    def holds(self, apart: Comparison, units: NaturalUnits) -> bool:
        """Return whether a comparison is within these bounds."""
        return (
            apart.objective_gap is not None
            and abs(apart.objective_gap) <= self.objective
            and apart.farthest <= self.distance * units.length
            and apart.joints <= self.distance * max(1.0, units.length)
            and apart.time <= self.distance * units.time
        )


@dataclass(frozen=True, kw_only=True)
class MeshSolve:
    """One solve of the sequence; ``apart`` compares it with the previous one, None for the first.

    ``other_optimum`` says that it is a different optimum from the previous one: the coarser mesh has both.
    False if not tested.
    """

    scheme: str
    intervals: int
    unknowns: int
    iterations: int
    status: str
    objective: float | None
    seconds: float
    apart: Comparison | None = None
    other_optimum: bool = False

    def __str__(self) -> str:
        text = f"{self.scheme}, {self.intervals} intervals, {self.unknowns} variables: {self.status}"
        text += f" in {self.iterations} iterations, {self.seconds:.1f} s"
        if self.objective is not None:
            text += f", objective {self.objective:.9g}"
        if self.apart is not None:
            text += f"; from the last {_in_words(self.apart)}"
        return text + (", another optimum" if self.other_optimum else "")


@dataclass(frozen=True, kw_only=True)
class ConvergedReference:
    """A converged solution, its comparison with the previous mesh, and all solves that led to it."""

    solution: Solution = field(repr=False)
    agreement: Comparison
    rungs: tuple[MeshSolve, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the agreement and the solves, JSON-able."""
        return {"agreement": asdict(self.agreement), "rungs": [asdict(rung) for rung in self.rungs]}

    def __str__(self) -> str:
        last = self.rungs[-1]
        mesh = f"{last.scheme}, {last.intervals} intervals"
        changed = sum(rung.other_optimum for rung in self.rungs)
        note = f"; the optimum changed {changed} times on the way" if changed else ""
        return (
            f"{mesh}, objective {last.objective:.9g}; the last two agree to {_in_words(self.agreement)}{note}"
        )


class NoReferenceError(TrajoptError):
    """No two successive solutions agree; ``rungs`` are the solves so far."""

    def __init__(self, what: str, rungs: tuple[MeshSolve, ...]) -> None:
        self.rungs = rungs
        super().__init__(what)


def _in_words(apart: Comparison) -> str:
    """Summarise a comparison."""
    gap = (
        "no objective" if apart.objective_gap is None else f"{abs(apart.objective_gap):.1e} of the objective"
    )
    when = f", {apart.time:.1e} s" if apart.time > 1e-9 else ""
    return f"{gap}, {apart.farthest:.1e} m{when}"


def converged_reference(
    problem: Problem,
    *,
    scheme: str = SCHEME,
    solver: str = DEFAULT_SOLVER,
    tolerance: float = TOLERANCE,
    agreement: Agreement | None = None,
    max_unknowns: int = MAX_UNKNOWNS,
    max_time: float = MAX_TIME,
    threads: int = 1,
    start: Start = None,
    progress: Callable[[MeshSolve], None] | None = None,
) -> ConvergedReference:
    """Refine until two successive solutions agree; return the finer one with their comparison.

    Args:
        problem: The problem to solve.
        scheme: Scheme of all meshes but the first.
        solver: Name of the solver, as in `solve`.
        tolerance: Tolerance of the solver.
        agreement: Bounds on the differences of objective, motion and durations.
        max_unknowns: Largest number of variables of one solve.
        max_time: Time limit of all solves together, s.
        threads: Threads for functions and linear systems.
        start: Start of the first solve, as in `solve`.
        progress: Called with each solve.

    Raises:
        NoReferenceError: If the budget runs out or a mesh is not solved; the message says how far the last
            two solutions agree and whether they are different optima.
        InputError: As `solve` does.
    """
    for name, value in (("max_time", max_time), ("max_unknowns", max_unknowns)):
        if not value > 0:
            raise InputError(f"{name} is {value:g}", "allowed: > 0")
    climb = _Climb(
        problem=problem,
        settings={"solver": solver, "tolerance": tolerance, "threads": threads},
        scheme=scheme,
        max_unknowns=max_unknowns,
        deadline=time.monotonic() + max_time,
        progress=progress,
    )
    return climb.run(start, agreement or Agreement())


@dataclass(kw_only=True)
class _Climb:
    """Settings of the solves, their common budget, and the solves so far."""

    problem: Problem
    settings: Mapping[str, Any]
    scheme: str
    max_unknowns: int
    deadline: float
    progress: Callable[[MeshSolve], None] | None
    rungs: list[MeshSolve] = field(default_factory=list)
    begun: float = 0.0

    @property
    def left(self) -> float:
        """Time left, s."""
        return self.deadline - time.monotonic()

    def run(self, start: Start, agreement: Agreement) -> ConvergedReference:
        """Refine until two successive solutions agree."""
        last = self._solved(start)
        self._record(last)
        while True:
            solution = self._solved(last)
            apart = compare(solution, last)
            agreed = len(self.rungs) > 1 and agreement.holds(apart, solution.units)
            self._record(solution, apart, other=not agreed and self._is_other(last, solution, apart))
            if agreed:
                made = ConvergedReference(solution=solution, agreement=apart, rungs=tuple(self.rungs))
                return replace(
                    made,
                    solution=solution.with_statistics(
                        more={**solution.statistics.more, "reference": made.to_dict()}
                    ),
                )
            last = solution

    def _record(self, solution: Solution, apart: Comparison | None = None, *, other: bool = False) -> None:
        statistics = solution.statistics
        rung = MeshSolve(
            scheme=statistics.transcription,
            intervals=solution.n_intervals,
            unknowns=statistics.variables,
            iterations=statistics.iterations,
            status=statistics.status,
            objective=statistics.objective,
            seconds=time.monotonic() - self.begun,
            apart=apart,
            other_optimum=other,
        )
        self.rungs.append(rung)
        if self.progress is not None:
            self.progress(rung)

    def _solved(self, start: Start) -> Solution:
        """Return the solution on the next mesh; tries the default guess if ``start`` does not converge."""
        scheme, intervals = self._mesh()
        self.begun = time.monotonic()
        for origin in (start, None) if start is not None else (None,):
            solution = solve(
                self.problem,
                transcription=scheme,
                intervals=intervals,
                start=origin,
                max_time=max(self.left, LEAST_TIME),
                **self.settings,
            )
            if solution.converged:
                return solution
            if self.left <= 0:
                break
        mesh = f"{solution.statistics.transcription} with {solution.n_intervals} intervals"
        raise self._failure(f"{mesh} is not solved ({solution.statistics.status.replace('_', ' ')})")

    def _mesh(self) -> tuple[str | None, int | None]:
        """Return scheme and intervals of the next mesh, None for the problem's; raises if over budget."""
        if not self.rungs:
            return None, None
        if self.left <= 0:
            raise self._failure("the time is up")
        last, finer = self.rungs[-1], 1 if len(self.rungs) == 1 else 2
        if finer * last.unknowns > self.max_unknowns:
            raise self._failure(f"the next mesh has more than {self.max_unknowns} variables")
        return self.scheme, finer * last.intervals

    def _is_other(self, coarse: Solution, fine: Solution, apart: Comparison) -> bool:
        """Return whether two solutions are different optima; tested only if far apart or diverging."""
        before = self.rungs[-1].apart
        grew = before is not None and apart.farthest > DISTANCE_GROWTH * before.farthest
        far = apart.farthest > OPTIMUM_DISTANCE * NaturalUnits.of(coarse.model).length
        if self.left <= 0 or not (far or grew):
            return False
        return in_other_optimum(self.problem, coarse, fine, max_time=self.left, **self.settings)

    def _failure(self, why: str) -> NoReferenceError:
        text = f"no reference: {why}"
        if self.rungs and self.rungs[-1].apart is not None:
            text += f"; the last two meshes agree to {_in_words(self.rungs[-1].apart)}"
            if self.rungs[-1].other_optimum:
                text += " and are different optima: one mesh has both"
        return NoReferenceError(text, tuple(self.rungs))


def in_other_optimum(problem: Problem, coarse: Solution, fine: Solution, **settings: Any) -> bool:
    """Return whether ``coarse`` and a finer solution are different optima, not just on different meshes.

    The problem is solved again on the mesh of ``coarse``, starting from ``fine``. If the result is much
    nearer to ``fine`` than ``coarse`` is, the coarse mesh has both optima. Without convergence the answer is
    False. ``settings`` are arguments of `solve`. Raises `InputError` as `compare` and `solve` do.
    """
    apart = compare(coarse, fine).farthest
    back = solve(problem, mesh=mesh_of(coarse), start=fine, **settings)
    return back.converged and compare(back, fine).farthest < SAME_SIDE * apart
