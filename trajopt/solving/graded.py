"""Solve to a grade: solve on a coarse mesh, examine the motion, refine where it misses, solve again from it.

The first mesh has a quarter of the problem's intervals, of degree four. It is refined by the figures of the
check: local errors and drift by phase, figures that are broken between points by interval.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.certify.accuracy.natural_units import NaturalUnits
from trajopt.certify.check import Examination, examine
from trajopt.certify.report import GRADE, OPEN_LOOP, CheckReport, Tolerances
from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.robot.units import Units
from trajopt.solution.grid import mesh_of
from trajopt.solution.solution import Solution
from trajopt.solving.exchange import Exchange
from trajopt.solving.ladder import INTERRUPTED
from trajopt.solving.refine import Round, unknowns_by_phase, unknowns_on_mesh
from trajopt.solving.remeshing import PhaseErrors, remeshed_where_broken
from trajopt.solving.solving import solve as solve_on_mesh
from trajopt.solving.verdicts import judged_by
from trajopt.transcription.mesh import Mesh
from trajopt.transcription.transcription import chosen_mesh

# Scheme of the first mesh, and its part of the problem's own intervals: on gaits and small jumps as accurate
# as two points on all of them, in half the time.
FIRST_SCHEME, FIRST_PART = "legendre:4", 0.25
# Widest interval of the first mesh, in natural times sqrt(l / g).
WIDEST = 1.0
# The scheme for which a problem's own number of intervals is meant, unless it names another.
USUAL_SCHEME = "legendre:2"
MOST_ROUNDS = 10
# Bodies this deep in each other, m, are moved apart before the mesh is refined.
DEEP = 5e-3
# Planes are laid anew until the objective changes by less than this part of it: the motion that they allow is
# then the best one near it.
SETTLED = 5e-3
MOST_VARIABLES = 100_000


@dataclass(frozen=True, kw_only=True)
class Graded:
    """The best motion found, its check, the solves, and what ended them; ``examined``: s of all checks."""

    solution: Solution
    report: CheckReport | None
    rounds: tuple[Round, ...]
    why: str
    examined: float

    @property
    def reached(self) -> bool:
        """Whether the motion has the grade."""
        return self.solution.success

    @property
    def spent(self) -> float:
        """Time of the solver in all rounds, s."""
        return sum(own.wall_time for own in self.rounds)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "reached": self.reached,
            "why": self.why,
            "spent_s": self.spent,
            "examined_s": self.examined,
            "rounds": [own.to_dict() for own in self.rounds],
        }


def first_mesh(problem: Problem) -> Mesh:
    """The mesh on which a solve to a grade begins; that of the problem where it names a scheme of its own."""
    counts = problem.schedule.intervals(problem.default_intervals)
    if problem.default_transcription != USUAL_SCHEME:
        return Mesh.uniform(problem.default_transcription, counts)
    widest = WIDEST * Units(problem.robot).time
    wanted = [
        max(round(FIRST_PART * count), math.ceil(phase.duration / widest), 1)
        for count, phase in zip(counts, problem.schedule.phases, strict=True)
    ]
    return Mesh.uniform(FIRST_SCHEME, wanted)


def solve(
    problem: Problem,
    *,
    transcription: str | None = None,
    intervals: int | None = None,
    mesh: Mesh | None = None,
    fixed_mesh: bool = False,
    draft: bool = False,
    **settings: Any,
) -> Solution:
    """Solve a problem until its motion holds at any time; never raises because that is not reached.

    The mesh is refined, see `solve_graded`. A mesh that is named is solved once, like that of a reduced model
    without legs.

    Args:
        problem: What to solve.
        transcription: Scheme of a mesh to solve on once, as in `trajopt.solving.solving.solve`.
        intervals: Its number of intervals over the whole schedule.
        mesh: That mesh, instead of both.
        fixed_mesh: Solve once, on the problem's own mesh where none is named.
        draft: Solve once, on the first mesh of a refinement.
        **settings: Those of `trajopt.solving.solving.solve`.

    Returns:
        The best motion. Its ``success`` is the verdict of the check, ``converged`` that all rows hold at its
        points; its meta has under ``graded`` the meshes, under ``failures`` and ``advice`` what is missed.

    Raises:
        InputError: For a value that is not allowed.
    """
    named = fixed_mesh or (transcription, intervals, mesh) != (None, None, None)
    if named or not problem.holds_contacts:
        if draft:
            raise InputError("a draft and a mesh are both asked for", "allowed: one of them")
        fixed = chosen_mesh(problem, transcription, intervals, mesh)
        if not problem.holds_contacts:
            return solve_on_mesh(problem, mesh=fixed, **{**settings, "judge": False})
        return solve_graded(problem, mesh=fixed, refine=False, **settings).solution
    return solve_graded(problem, max_rounds=1 if draft else MOST_ROUNDS, **settings).solution


def solve_graded(
    problem: Problem,
    *,
    mesh: Mesh | None = None,
    start: Solution | str | Path | None = None,
    tolerances: Tolerances = GRADE,
    max_rounds: int = MOST_ROUNDS,
    refine: bool = True,
    **settings: Any,
) -> Graded:
    """Solve a problem until its motion is within ``tolerances`` at any time, or no mesh is left to try.

    Args:
        problem: What to solve.
        mesh: The first one; default: `first_mesh`.
        start: A solution, or its file, from which the first solve starts.
        tolerances: The grade.
        max_rounds: Limit of solves; one is a draft.
        refine: False keeps the first mesh: only rows for bodies that come too near are added.
        **settings: Those of `trajopt.solve`; limits of time and iterations are for each solve.

    Raises:
        InputError: As `trajopt.solve` does.
    """
    loop = _Loop(problem, tolerances, refine, settings)
    return loop.result(loop.run(mesh or first_mesh(problem), start, max_rounds))


@dataclass
class _Loop:
    """The rounds so far, the last solution, and the best one with its examination."""

    problem: Problem
    tolerances: Tolerances
    refine: bool
    settings: dict[str, Any]
    rounds: list[Round] = field(default_factory=list)
    last: Solution | None = None
    examined: float = 0.0
    best: tuple[float, Solution, CheckReport] | None = None
    settled: bool = True

    def __post_init__(self) -> None:
        self.exchange = Exchange(self.problem)

    def run(self, mesh: Mesh, start: Solution | str | Path | None, rounds: int) -> str:
        """Solve, examine, refine; return why it ends."""
        solution = self._first(mesh, start)
        while solution is not None:
            begun = time.perf_counter()
            found = examine(solution, self.tolerances)
            self.examined += time.perf_counter() - begun
            self._keep(solution, found.report)
            look = self.exchange.look(solution)
            near = self.exchange.depth(look)
            if not found.report.failures(self.tolerances) and near <= 0 and self.settled:
                return "the grade is reached"
            if len(self.rounds) >= rounds:
                return "it is a draft" if rounds == 1 else f"{rounds} rounds were not enough"
            new = {pair for pair in self.exchange.missing(look) if pair not in self.exchange.moments}
            self.exchange.add(look)
            mesh = mesh_of(solution)
            if self.refine and near < DEEP:  # else the motion will be another one: its mesh is judged then
                mesh = self._refined(mesh, solution, found)
            if mesh == mesh_of(solution) and near <= 0 and self.settled:
                return "a finer mesh does not mend what is missed" if self.refine else "the mesh is fixed"
            if unknowns_on_mesh(self.problem, mesh) > MOST_VARIABLES:
                return f"the next mesh would have more than {MOST_VARIABLES} variables"
            sideless = near >= DEEP and not new.isdisjoint(self.exchange.sided_pairs)
            solution = self._solved_from(mesh, solution, sideless)
        return f"a mesh was not solved: {self.rounds[-1].status.replace('_', ' ')}"

    def _first(self, mesh: Mesh, start: Solution | str | Path | None) -> Solution | None:
        """The solution on the first mesh, or on the problem's own mesh where that fails.

        Not where it is certified as infeasible: of 13 such settings none was solved on the own mesh.
        """
        for tried in dict.fromkeys((mesh, *([chosen_mesh(self.problem)] if self.refine else []))):
            solution = self._solved(tried, start)
            if solution is not None or self.rounds[-1].status == INTERRUPTED:
                return solution
            if self.last is not None and self.last.meta.get("certified_infeasible"):
                break
        return None

    def _solved(
        self, mesh: Mesh, start: Solution | str | Path | None, problem: Problem | None = None
    ) -> Solution | None:
        given, number = self.settings.get("label", ""), len(self.rounds) + 1
        # A named mesh is usually solved once; a refinement has several meshes.
        label = ", ".join(filter(None, [given, f"mesh {number}" if self.refine or number > 1 else ""]))
        self.last = solve_on_mesh(
            problem or self.problem,
            mesh=mesh,
            start=start,
            **{**self.settings, "label": label, "judge": False},
        )
        self.settings.pop("perturb", None)  # noise is for the first start
        self.rounds.append(Round.of(mesh, self.last))
        return self.last if self.last.converged else None

    def _solved_from(self, mesh: Mesh, solution: Solution, sideless: bool) -> Solution | None:
        """From the last motion or from the guess, whichever is on the right side of bodies to pass.

        A motion that goes deep through a body that had no rows may be on no side of it (``sideless``); a
        guess that is clear passes it where its author wants it to. From then on motions are on that side, and
        planes along them hold them back less than those along the guess.
        """
        if not self.exchange.moments:
            return self._solved(mesh, solution)
        for problem, start in self.exchange.starts(solution, sideless and self.exchange.guess_is_clear()):
            found = self._solved(mesh, start, problem)
            if found is not None:
                before, after = solution.meta["objective"], found.meta["objective"]
                self.settled = abs(after - before) <= SETTLED * max(abs(before), abs(after))
                return found
            if self.rounds[-1].status == INTERRUPTED:
                break
        return None

    def _keep(self, solution: Solution, report: CheckReport) -> None:
        _, used = report.worst(self.tolerances)
        if self.best is None or used < self.best[0] or used <= 1:
            self.best = (used, solution, report)

    def _refined(self, mesh: Mesh, solution: Solution, found: Examination) -> Mesh:
        length = NaturalUnits.of(solution.model).length
        ends, used = np.cumsum(mesh.counts)[:-1], found.report
        errors = [
            PhaseErrors(local=local, phase=max(self._error(used, index), float(drift)), unknowns=sizes)
            for index, (local, drift, sizes) in enumerate(
                zip(
                    np.split(found.local.position, ends),
                    found.drift,
                    unknowns_by_phase(self.problem),
                    strict=True,
                )
            )
        ]
        # A scheme that a problem names suits its kinks: torques of least time ring at a higher degree.
        usual = self.problem.default_transcription == USUAL_SCHEME
        return remeshed_where_broken(mesh, errors, found.broken, length, raise_degree=usual)

    def _error(self, report: CheckReport, index: int) -> float:
        """Error of a phase in what it does, over what is allowed."""
        phase = report.phases[index]
        names = ("local_position", "local_joints", *(OPEN_LOOP if phase.stable else ()))
        ratios = [
            getattr(phase, name) / limit
            for name in names
            if getattr(phase, name) is not None and (limit := getattr(self.tolerances, name)) is not None
        ]
        return max(ratios, default=0.0)

    def result(self, why: str) -> Graded:
        """The best motion with its verdict, recorded in its meta."""
        solution, report = (self.last, None) if self.best is None else self.best[1:]
        assert solution is not None
        if report is not None:
            solution = judged_by(solution, report, self.tolerances)
        rounds = tuple(self.rounds)
        made = Graded(solution=solution, report=report, rounds=rounds, why=why, examined=self.examined)
        return replace(made, solution=replace(solution, meta={**solution.meta, "graded": made.to_dict()}))
