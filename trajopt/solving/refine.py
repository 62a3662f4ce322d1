"""Refine a mesh until the motion meets a target accuracy, starting each solve from the last solution.

The error of a phase is what the planned torques do in it (`accuracy.measure`: open loop by numeric Pinocchio,
from the phase's planned start), or the drift of its contacts where that is larger: metres either way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.certify.accuracy.measures import Accuracy, measure
from trajopt.errors import require_positive
from trajopt.problem.problem import Problem
from trajopt.solution.descriptions import jsonable
from trajopt.solution.grid import mesh_of
from trajopt.solution.input import solution_of
from trajopt.solution.solution import Solution
from trajopt.solving.exchange import Exchange
from trajopt.solving.ladder import INTERRUPTED
from trajopt.solving.remeshing import PhaseErrors, remeshed
from trajopt.solving.solving import solve
from trajopt.transcription.mesh import Mesh

# The first mesh has this part of the problem's own intervals, and two a phase at least: its solution takes
# little time and shows where the error is.
COARSE = 0.2
LEAST_INTERVALS = 2
MAX_ROUNDS = 8
MAX_VARIABLES = 100_000
# The solver's tolerance, as a fraction of the target over the robot's length: its error grows along the
# motion.
TOLERANCE_SHARE = 1e-3
TOLERANCES = (1e-10, 1e-6)


@dataclass(frozen=True, kw_only=True)
class Round:
    """One solve: its mesh, size, and the error of each phase in m (None where it was not solved)."""

    mesh: Mesh
    variables: int
    iterations: int
    wall_time: float
    status: str
    errors: tuple[float, ...] | None

    @classmethod
    def of(cls, mesh: Mesh, solution: Solution) -> Round:
        """The round of a solution on a mesh, not yet measured."""
        meta = solution.meta
        return cls(
            mesh=mesh,
            variables=meta["variables"],
            iterations=meta["iterations"],
            wall_time=meta["wall_time_s"],
            status=meta["status"],
            errors=None,
        )

    @property
    def error(self) -> float | None:
        """Largest error of a phase, m."""
        return None if self.errors is None else max(self.errors)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able; an error that is not finite is None."""
        return jsonable(
            {
                "transcription": self.mesh.transcription,
                "intervals": self.mesh.counts,
                "variables": self.variables,
                "iterations": self.iterations,
                "wall_time_s": self.wall_time,
                "status": self.status,
                "errors_m": self.errors,
            }
        )


@dataclass(frozen=True, kw_only=True)
class Refinement:
    """The best solution, its measured ``accuracy`` (None where nothing was solved) and how it was reached."""

    target: float
    solution: Solution
    accuracy: Accuracy | None
    rounds: tuple[Round, ...]
    why: str

    @property
    def error(self) -> float:
        """Largest error of a phase of the solution, m; inf where nothing was solved."""
        return largest_error(self.accuracy)

    @property
    def reached(self) -> bool:
        """Whether the target is met, by measurement."""
        return self.error <= self.target

    def to_dict(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "target_m": self.target,
            "reached": self.reached,
            "error_m": jsonable(self.error),
            "why": self.why,
            "rounds": [own.to_dict() for own in self.rounds],
        }


def largest_error(accuracy: Accuracy | None) -> float:
    """Largest error of a phase, m; inf where nothing was solved and measured."""
    return math.inf if accuracy is None else max(phase_errors(accuracy))


def phase_errors(accuracy: Accuracy) -> tuple[float, ...]:
    """Error of each phase in m: open loop from its planned start, or the drift of its contacts."""
    return tuple(max(own.open_loop.position, own.foot_drift or 0.0) for own in accuracy.phases)


def coarse_mesh(problem: Problem) -> Mesh:
    """The mesh that refinement begins with where none is given."""
    schedule = problem.schedule
    total = max(round(COARSE * problem.default_intervals), len(schedule.phases))
    counts = [max(count, LEAST_INTERVALS) for count in schedule.intervals(total)]
    return Mesh.uniform(problem.default_transcription, counts)


def tolerance_for(target: float, length: float) -> float:
    """A solver's tolerance that leaves a small part of ``target`` (m) on a robot of ``length`` m."""
    return float(np.clip(TOLERANCE_SHARE * target / length, *TOLERANCES))


def refine(
    problem: Problem,
    target: float,
    *,
    mesh: Mesh | None = None,
    start: Solution | str | Path | None = None,
    raise_degree: bool = True,
    max_rounds: int = MAX_ROUNDS,
    max_variables: int = MAX_VARIABLES,
    tolerance: float | None = None,
    **settings: Any,
) -> Refinement:
    """Solve a problem to an accuracy of ``target`` m in every phase, with as few variables as possible.

    Args:
        problem: What to solve.
        target: Largest error of a phase, m.
        mesh: The first one; default: a fifth of the problem's intervals.
        start: A solution, or its file, from which the first solve starts; without a mesh it is measured
            itself, and its mesh is refined.
        raise_degree: False only splits intervals.
        max_rounds: Limit of solves.
        max_variables: Approximate limit of a mesh's variables.
        tolerance: The solver's; default: by the target.
        **settings: Those of `trajopt.solve`.

    Returns:
        The refinement: `Refinement.reached` tells success, ``why`` what ended it.

    Raises:
        InputError: For a target that is no length, and as `trajopt.solve` does.
    """
    require_positive("accuracy", target, "m")
    tolerance = tolerance_for(target, problem.robot.length) if tolerance is None else tolerance
    loop = _Loop(problem, float(target), raise_degree, {**settings, "tolerance": tolerance})
    known = None if start is None else solution_of(start)
    if mesh is None and known is not None and known.converged:
        loop.record(mesh_of(known), known)
        why = loop.run(mesh_of(known), known, known, max_rounds + 1, max_variables)
    else:
        why = loop.run(mesh or coarse_mesh(problem), known, None, max_rounds, max_variables)
    return loop.result(why)


@dataclass
class _Loop:
    """The rounds so far, the last solution, and the best one with its measured accuracy."""

    problem: Problem
    target: float
    raise_degree: bool
    settings: dict[str, Any]
    rounds: list[Round] = field(default_factory=list)
    best: tuple[Solution, Accuracy] | None = None
    last: Solution | None = None
    clear: bool = False

    def __post_init__(self) -> None:
        self.exchange = Exchange(self.problem)

    def run(
        self, mesh: Mesh, start: Solution | None, found: Solution | None, rounds: int, max_variables: int
    ) -> str:
        """Solve (unless a solution on ``mesh`` is ``found``), measure, remesh; return why it stops."""
        for _ in range(rounds):
            solution = found or self._solve(mesh, start)
            if solution is None:
                return f"a mesh was not solved: {self.rounds[-1].status.replace('_', ' ')}"
            accuracy = measure(solution)
            errors = phase_errors(accuracy)
            self.rounds[-1] = replace(self.rounds[-1], errors=errors)
            look = self.exchange.look(solution)
            clear = not self.exchange.missing(look)
            if self.best is None or (not clear, max(errors)) <= (not self.clear, largest_error(self.best[1])):
                self.best, self.clear = (solution, accuracy), clear
            if max(errors) <= self.target and clear:
                return "the target is met"
            self.exchange.add(look)
            mesh = self._remeshed(mesh, accuracy)
            if unknowns_on_mesh(self.problem, mesh) > max_variables:
                return f"the next mesh would have more than {max_variables} variables"
            start, found = solution, None
        return f"{rounds} rounds were not enough"

    def _remeshed(self, mesh: Mesh, accuracy: Accuracy) -> Mesh:
        ends = np.cumsum(mesh.counts)
        found = [
            PhaseErrors(local=local, phase=error, unknowns=sizes)
            for local, error, sizes in zip(
                np.split(accuracy.interval_errors, ends[:-1]),
                phase_errors(accuracy),
                unknowns_by_phase(self.problem),
                strict=True,
            )
        ]
        return remeshed(mesh, found, self.target, self.problem.robot.length, self.raise_degree)

    def record(self, mesh: Mesh, solution: Solution) -> None:
        """Append a round, not yet measured."""
        self.rounds.append(Round.of(mesh, solution))
        self.last = solution

    def _solve(self, mesh: Mesh, start: Solution | None) -> Solution | None:
        """The solution on a mesh; from the problem's guess where ``start`` does not lead to one."""
        starts = iter([(self.problem, None)]) if start is None else self.exchange.starts(start)
        for problem, origin in starts:
            label = f"mesh {len(self.rounds) + 1}"
            solution = solve(problem, mesh=mesh, start=origin, label=label, **self.settings)
            self.record(mesh, solution)
            if solution.converged:
                return solution
            if solution.meta["status"] == INTERRUPTED:
                break
        return None

    def result(self, why: str) -> Refinement:
        """The refinement, recorded in its solution's meta."""
        solution, accuracy = (self.last, None) if self.best is None else self.best
        assert solution is not None
        made = Refinement(
            target=self.target, solution=solution, accuracy=accuracy, rounds=tuple(self.rounds), why=why
        )
        return replace(made, solution=replace(solution, meta={**solution.meta, "refinement": made.to_dict()}))


def unknowns_by_phase(problem: Problem) -> list[tuple[int, int]]:
    """Approximate number of variables of each phase per node and per point: states, inputs, wrenches."""
    robot = problem.robot
    wrenches = [
        sum(robot.contact(name).dimension for name in phase.contacts) for phase in problem.schedule.phases
    ]
    return [(2 * robot.nv, robot.nv + size) for size in wrenches]


def unknowns_on_mesh(problem: Problem, mesh: Mesh) -> int:
    """Approximate number of variables of a problem on a mesh."""
    return sum(
        phase.count * (node + phase.method.s * point)
        for phase, (node, point) in zip(mesh.phases, unknowns_by_phase(problem), strict=True)
    )
