"""Mesh refinement: rounds of solving, checking and remeshing, until a motion passes the check at all times.

A mesh is refined by the figures of the check: local errors and contact drift by phase, violations between
collocation points by interval. Where torques chatter, the degree is lowered to one. If an accuracy is
requested, too, the error of a phase is the larger of its open-loop error (`accuracy.measure`: planned torques
integrated by numeric Pinocchio from the phase's planned start) and the drift of its contacts.
"""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.certify.accuracy.measures import Accuracy, measure
from trajopt.certify.check import BODIES, Examination, examine
from trajopt.certify.report import OPEN_LOOP, CheckReport, Tolerances
from trajopt.motion.grid import mesh_of
from trajopt.motion.solution import Solution
from trajopt.problem.problem import Problem
from trajopt.robot.natural_units import NaturalUnits
from trajopt.solvers.ipopt import IPOPT_PUSHED
from trajopt.solvers.result import LEAST_TIME, Option
from trajopt.solving.exchange import Exchange
from trajopt.solving.feedback import with_gains
from trajopt.solving.remeshing import PhaseErrors, remeshed
from trajopt.solving.rounds import (
    INTERRUPTED,
    Graded,
    Round,
    phase_errors,
    unknowns_by_phase,
    unknowns_on_mesh,
)
from trajopt.solving.solving import DEFAULT_SOLVER
from trajopt.solving.solving import solve as solve_on_mesh
from trajopt.solving.verdicts import judged_by
from trajopt.terms.limits import with_far_limits
from trajopt.transcription.mesh import Mesh
from trajopt.transcription.transcription import chosen_mesh

# Scheme for which a problem's own number of intervals is meant, unless it names another.
USUAL_SCHEME = "legendre:2"
# Scheme of motions whose torques chatter at a higher degree. Its rates are linear within an interval: between
# two nodes at a limit they are constant. At a higher degree they ring there between points, at no cost.
CALM_SCHEME = "legendre:1"
# Bodies that penetrate by this much, m, are separated before the mesh is refined.
DEPTH = 5e-3
# Figures of the check for joint limits.
LIMITS = ("effort_excess", "velocity_excess", "position_excess")
# Planes are laid anew until the relative change of the objective is below this: the motion within them is
# then locally optimal.
OBJECTIVE_CHANGE = 5e-3
MOST_VARIABLES = 100_000
# If a phase fails in more than PATIENCE successive rounds, the neighbours of intervals that are split are
# split as well, and no interval stays BALANCE times as wide as the next one.
PATIENCE, BALANCE = 3, 2.5
# Default time limit of all rounds, s.
MAX_TIME = 600.0
# A solve from the last motion is given up after GIVE_UP times the iterations of the last round, but not below
# GIVE_UP_LEAST iterations times variables, since giving up a small solve gains nothing. It is repeated with
# larger distances from bounds, then from other starts, and without the limit if none of them converges. The
# limit is DEEP_FACTOR times as high if bodies were deep in each other, since the motion will change much.
GIVE_UP, GIVE_UP_LEAST, DEEP_FACTOR = 3, 2.5e5, 2
# If after FAR_ROUNDS the best motion is still FAR_RATIO times beyond a tolerance, the refinement restarts.
FAR_ROUNDS, FAR_RATIO = 4, 20.0
# Iterations on the first mesh before the problem's own mesh is tried; then the first is solved without limit.
MOST_FIRST = 200


@dataclass(frozen=True)
class _Examined:
    """A solution with the problem that it solves, its examination, and its accuracy if one is requested."""

    solution: Solution
    problem: Problem
    examination: Examination
    accuracy: Accuracy | None


@dataclass
class Refinement:
    """The rounds so far, the last solution, and the best one with its examination.

    ``missed`` (n_phases,) counts the successive rounds up to the last in which each phase failed.
    ``calm`` says that the degree was lowered against chatter; see `CALM_SCHEME`.
    ``solver_time`` says that the time limit counts only the solver, not everything but compilation.
    ``solved`` is the problem of ``last``, with its constraints on bodies.
    """

    problem: Problem
    tolerances: Tolerances
    refine: bool
    settings: dict[str, Any]
    exchange: Exchange
    target: float | None
    solver_time: bool = False
    begun: float = field(default_factory=time.perf_counter)
    compiled: float = 0.0
    rounds: list[Round] = field(default_factory=list)
    last: Solution | None = None
    solved: Problem | None = None
    examined: float = 0.0
    best: tuple[float, _Examined] | None = None
    settled: bool = True
    missed: np.ndarray | int = 0
    calm: bool = False

    def run(
        self, mesh: Mesh, start: Solution | str | Path | None, first: Solution | None, rounds: int
    ) -> str:
        """Solve, check and refine; return the reason why it ends.

        Each round checks one motion. It may take several solves, from the last motion and from the guess.
        """
        solution = self._first(mesh, start) if first is None else self._given(first)
        examined = 0
        while solution is not None:
            latest = self._examine(solution)
            examined += 1
            look = self.exchange.look(solution)
            report = latest.examination.report
            deepest = [name for name in report.failures(self.tolerances) if name in BODIES]
            times = [report.places[name].time for name in deepest]
            if times and self.exchange.depth(look) <= 0:  # collides only between the sampled moments
                look = self.exchange.look(solution, times)
            near = self.exchange.depth(look)
            rings = examined < rounds and self._rings(mesh_of(solution), report)
            if self._used(latest) <= 1 and near <= 0 and self.settled and not rings:
                return "the grade is reached"
            if examined >= rounds:
                return "it is a draft" if rounds == 1 else f"{rounds} rounds were not enough"
            imposed = self._far_limits_imposed(report)
            # A motion from a given start passes bodies on the side that the start chose.
            deep = self.exchange.sideless_depth(look, known=not self.settled) >= DEPTH
            sideless = deep and start is None
            self.exchange.add(look)
            mesh = mesh_of(solution)
            if self.refine and near < DEPTH and not imposed:  # otherwise the motion will change much
                mesh = self._refined(mesh, latest)
            if mesh == mesh_of(solution) and near <= 0 and self.settled and not imposed:
                return "a finer mesh does not mend what is missed" if self.refine else "the mesh is fixed"
            if unknowns_on_mesh(self.problem, mesh) > MOST_VARIABLES:
                return f"the next mesh would have more than {MOST_VARIABLES} variables"
            if self._left() <= LEAST_TIME:
                return "the time is used"
            hopeless = examined == FAR_ROUNDS and self.best is not None and self.best[0] > FAR_RATIO
            anew = self._restart() if hopeless else None
            if anew is not None:
                solution, rounds = anew, rounds + examined
                continue
            solution = self._solved_from(mesh, solution, sideless, DEEP_FACTOR if near >= DEPTH else 1)
        return f"a mesh was not solved: {self.rounds[-1].status.replace('_', ' ')}"

    def _far_limits_imposed(self, report: CheckReport) -> bool:
        """If the motion exceeds a limit, add those that seemed out of reach; return whether any are new."""
        if not any(name.startswith(LIMITS) for name in report.failures(self.tolerances)):
            return False
        terms = with_far_limits(self.problem.terms, self.problem.robot)
        if terms == self.problem.terms:
            return False
        self.problem = self.exchange.problem = replace(self.problem, terms=terms)
        return True

    def _first(self, mesh: Mesh, start: Solution | str | Path | None) -> Solution | None:
        """Return the solution on the first mesh, or on the problem's own mesh if that fails or takes long.

        The own mesh is not tried if the problem is certified infeasible without collision rows: IPOPT
        solved none of 14 such problems there, from two starts each.
        """
        own = chosen_mesh(self.problem) if self.refine else mesh
        for tried in dict.fromkeys((mesh, own)):
            if isinstance(start, Solution) and self.exchange.moments:
                solution = self._solved_from(tried, start, sideless=False)
            else:
                solution = self._solved(tried, start, most=None if tried == own else MOST_FIRST)
            if solution is not None or self._is_over():
                return solution
            if not self.exchange.moments and self.last and self.last.statistics.certified_infeasible:
                return None
        left = own != mesh and not self.exchange.moments and self.rounds[0].iterations >= MOST_FIRST
        return self._solved(mesh, start) if left else None

    def _restart(self) -> Solution | None:
        """Solve from the guess on the problem's own mesh, without collision rows; None if that fails.

        If rounds from a coarse mesh do not come near the grade, they follow another optimum.
        """
        own = chosen_mesh(self.problem)
        if not self.refine or own == self.rounds[0].mesh:
            return None
        kept, self.exchange = self.exchange, Exchange(self.problem)
        solution = self._solved(own, None)
        if solution is None:
            self.exchange = kept
        else:
            self.settled, self.missed, self.calm = True, 0, False
        return solution

    def _given(self, first: Solution) -> Solution | None:
        self.last = first
        self.rounds.append(Round.of(mesh_of(first), first))
        return first if first.converged else None

    def _left(self) -> float:
        """Return the remaining time, s."""
        used = sum(round_.wall_time for round_ in self.rounds)
        if not self.solver_time:
            used = max(used, time.perf_counter() - self.begun - self.compiled)
        return self.settings.get("max_time", MAX_TIME) - used

    def _is_over(self) -> bool:
        """Return whether the user stopped the last round, or no time is left for another."""
        return self.rounds[-1].status == INTERRUPTED or self._left() <= LEAST_TIME

    def _solved(
        self,
        mesh: Mesh,
        start: Solution | str | Path | None,
        problem: Problem | None = None,
        most: int | None = None,
        options: Mapping[str, Option] | None = None,
    ) -> Solution | None:
        given, number = self.settings.get("label", ""), len(self.rounds) + 1
        # A fixed mesh is usually solved once; a refinement has several meshes.
        label = ", ".join(filter(None, [given, f"mesh {number}" if self.refine or number > 1 else ""]))
        limit: dict[str, Any] = {}
        if self.settings.get("max_time", MAX_TIME) > 0:  # otherwise the solve rejects it
            limit["max_time"] = max(self._left(), LEAST_TIME)
        if most is not None:
            limit["max_iterations"] = min(most, self.settings.get("max_iterations", most))
        if options is not None:
            limit["options"] = {**options, **(self.settings.get("options") or {})}
        self.solved = problem or self.problem
        self.last = solve_on_mesh(
            self.solved,
            mesh=mesh,
            start=start,
            solver_time=self.solver_time,
            **{**self.settings, **limit, "label": label, "judge": False},
        )
        self.compiled += self.last.statistics.compile_time_s or 0.0
        self.settings.pop("perturb", None)  # noise applies only to the first start
        self.rounds.append(Round.of(mesh, self.last))
        return self.last if self.last.converged else None

    def _solved_from(
        self, mesh: Mesh, solution: Solution, sideless: bool, patience: int = 1
    ) -> Solution | None:
        """Solve from the last motion or from the guess, whichever passes obstacles on the right side.

        A motion deep inside a body may be on neither side of it (``sideless``); a collision-free guess passes
        it on the side that its author intended. Later motions are on that side, and planes along them
        restrict them less than planes along the guess.
        """
        starts = self.exchange.starts(solution, sideless and self.exchange.guess_is_clear())
        least = math.ceil(GIVE_UP_LEAST / unknowns_on_mesh(self.problem, mesh))
        most = patience * max(GIVE_UP * solution.statistics.iterations, least)
        given_up: list[tuple[Problem, Solution | None]] = []
        for problem, start in starts:
            solved = self._solved(mesh, start, problem, most)
            if solved is None and start is not None and self._may_be_pushed():
                solved = self._solved(mesh, start, problem, most, IPOPT_PUSHED)
            if solved is not None or self._is_over():
                break
            if self.rounds[-1].iterations >= most:
                given_up.append((problem, start))
        while solved is None and given_up and not self._is_over():
            problem, start = given_up.pop(0)
            solved = self._solved(mesh, start, problem)
        if solved is not None:
            before, after = (s.statistics.objective or 0.0 for s in (solution, solved))
            near = abs(after - before) <= OBJECTIVE_CHANGE * max(abs(before), abs(after))
            self.settled = near or not self.exchange.moments
        return solved

    def _may_be_pushed(self) -> bool:
        """Return whether a start farther from the bounds may help: for IPOPT, unless infeasible."""
        ipopt = self.settings.get("solver", DEFAULT_SOLVER) == DEFAULT_SOLVER
        certified = self.last is not None and self.last.statistics.certified_infeasible
        return ipopt and not certified and not self._is_over()

    def _examine(self, solution: Solution) -> _Examined:
        """Check and measure the solution of the last round; keep it if it is the best so far."""
        begun = time.perf_counter()
        accuracy = None if self.target is None else measure(solution)
        examination = examine(solution, self.tolerances)
        examined = _Examined(solution, self.solved or self.problem, examination, accuracy)
        self.examined += time.perf_counter() - begun
        if accuracy is not None:
            self.rounds[-1] = replace(self.rounds[-1], errors=phase_errors(accuracy))
        used = self._used(examined)
        if self.best is None or used < self.best[0] or used <= 1:
            self.best = used, examined
        return examined

    def _used(self, examined: _Examined) -> float:
        """Return the largest ratio of a figure or error to its tolerance; inf if unknown."""
        used = examined.examination.report.worst(self.tolerances)[1]
        if examined.accuracy is not None and self.target is not None:
            used = max(used, max(phase_errors(examined.accuracy)) / self.target)
        return math.inf if math.isnan(used) else used

    @property
    def _degree_is_free(self) -> bool:
        """Whether the degree may change: not that of a named scheme, nor that of calmed torques."""
        return self.problem.default_transcription == USUAL_SCHEME and not self.calm

    def _rings(self, mesh: Mesh, report: CheckReport) -> bool:
        """Return whether torques chatter at a degree that may be lowered; a requested accuracy needs it."""
        lower = self.refine and self._degree_is_free and mesh.transcription != CALM_SCHEME
        return lower and self.target is None and report.chatter != ""

    def _refined(self, mesh: Mesh, examined: _Examined) -> Mesh:
        examination, report = examined.examination, examined.examination.report
        if self._rings(mesh, report):
            self.calm = True  # with as many points as before
            calm = (one.with_scheme(CALM_SCHEME).split([one.method.s] * one.count) for one in mesh.phases)
            return Mesh(phases=tuple(calm))
        length = NaturalUnits.of(examined.solution.model).length
        aimed = np.zeros(len(mesh.phases))
        if examined.accuracy is not None and self.target is not None:
            aimed = np.array(phase_errors(examined.accuracy)) / self.target
        used = [self._error(report, index) for index in range(len(aimed))]
        parts = zip(
            np.split(examination.local.position, np.cumsum(mesh.counts)[:-1]),
            np.maximum(np.maximum(used, examination.drift), aimed).tolist(),
            unknowns_by_phase(self.problem),
            strict=True,
        )
        errors = [PhaseErrors(local=local, phase=worst, unknowns=sizes) for local, worst, sizes in parts]
        broken = self._pressed(mesh, errors, examination.broken)
        return remeshed(mesh, errors, broken, length, raise_degree=self._degree_is_free)

    def _pressed(self, mesh: Mesh, errors: Sequence[PhaseErrors], broken: np.ndarray) -> np.ndarray:
        """Return ``broken`` (I,), extended to neighbours in phases that fail round after round.

        In such phases the violation moves to intervals that are still wide.
        """
        parts = np.split(broken, np.cumsum(mesh.counts)[:-1])
        missed = [phase.phase > 1 or part.max() > 1 for phase, part in zip(errors, parts, strict=True)]
        self.missed = np.where(missed, self.missed + 1, 0)
        return np.concatenate([
            _balanced(np.array(phase.widths), part) if often else part
            for phase, part, often in zip(mesh.phases, parts, self.missed > PATIENCE, strict=True)
        ])  # fmt: skip

    def _error(self, report: CheckReport, index: int) -> float:
        """Return the largest local or open-loop error of a phase, over its tolerance."""
        phase = report.phases[index]
        names = ("local_position", "local_joints", *(OPEN_LOOP if phase.stable else ()))
        ratios = [
            getattr(phase, name) / limit
            for name in names
            if getattr(phase, name) is not None and (limit := getattr(self.tolerances, name)) is not None
        ]
        return max(ratios, default=0.0)

    def result(self, why: str, gains: bool = False) -> Graded:
        """Return the best motion with its verdict, also in its statistics, and with its gains."""
        best = None if self.best is None else self.best[1]
        solution, examination = (self.last, None) if best is None else (best.solution, best.examination)
        assert solution is not None
        if examination is not None:
            solution = judged_by(solution, examination.report, self.tolerances)
            if not (solution.success or self.last is None or self.last.converged):
                what, *_, remedy = self.last.statistics.advice.splitlines()
                kept = solution.statistics.advice.splitlines()[:-1]
                finer = f"a finer mesh was not solved, {what}: {remedy}"
                solution = solution.with_statistics(advice="\n".join([*kept, finer]))
        if gains and best is not None:
            solution = with_gains(best.problem, solution)
        made = Graded(
            solution=solution,
            examination=examination,
            rounds=tuple(self.rounds),
            why=why,
            examined=self.examined,
            exchange=self.exchange,
            target=self.target,
            accuracy=None if best is None else best.accuracy,
        )
        return replace(made, solution=solution.with_statistics(graded=made.statistics))


def _balanced(widths: np.ndarray, broken: np.ndarray) -> np.ndarray:
    """Return ``broken`` (n,), extended to neighbours and to intervals much wider than the next ones."""
    result, halved = broken.copy(), np.nextafter(1.0, 2.0)
    wide = np.convolve(broken > 1, np.ones(3), mode="same") > 0
    while wide.any():
        result[wide & (result <= 1)] = halved
        small = np.where(result > 1, widths / 2, widths)
        beside = np.minimum(np.append(small[1:], np.inf), np.insert(small[:-1], 0, np.inf))
        wide = (result <= 1) & (small > BALANCE * beside)
    return result
