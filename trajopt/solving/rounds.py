"""What a solve to a grade did: its solves, and the motion it ends with."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from trajopt.certify.accuracy.measures import Accuracy
from trajopt.certify.check import Examination
from trajopt.certify.report import CheckReport
from trajopt.problem.problem import Problem
from trajopt.solution.meta import jsonable
from trajopt.solution.solution import Solution
from trajopt.solution.statistics import GradedStatistics, RoundStatistics
from trajopt.solvers.status import Status
from trajopt.solving.exchange import Exchange
from trajopt.solving.verdicts import finite_or_none
from trajopt.transcription.mesh import Mesh

# The status of a solve that the user interrupted: nothing starts from it.
INTERRUPTED = Status.INTERRUPTED.word


@dataclass(frozen=True, kw_only=True)
class Round:
    """One solve: its mesh, size, and the error of each phase in m (None where it was not measured)."""

    mesh: Mesh
    variables: int
    iterations: int
    wall_time: float
    status: str
    errors: tuple[float, ...] | None

    @classmethod
    def of(cls, mesh: Mesh, solution: Solution) -> Round:
        """The round of a solution on a mesh, not yet measured."""
        statistics = solution.statistics
        return cls(
            mesh=mesh,
            variables=statistics.variables,
            iterations=statistics.iterations,
            wall_time=statistics.wall_time_s,
            status=statistics.status,
            errors=None,
        )

    @property
    def solved(self) -> bool:
        """Whether the solver converged."""
        return self.status == Status.SOLVED.word

    @property
    def error(self) -> float | None:
        """Largest error of a phase, m."""
        return None if self.errors is None else max(self.errors)

    @property
    def statistics(self) -> RoundStatistics:
        """The round as solutions record it; an error that is not finite is None."""
        return RoundStatistics(
            transcription=self.mesh.transcription,
            intervals=self.mesh.counts,
            variables=self.variables,
            iterations=self.iterations,
            wall_time_s=self.wall_time,
            status=self.status,
            errors_m=None if self.errors is None else tuple(map(finite_or_none, self.errors)),
        )


@dataclass(frozen=True, kw_only=True)
class Graded:
    """The best motion found, its examination, the solves, and what ended them.

    examined: s of all checks. exchange: the rows that keep bodies apart; None without legs. target: error of
    a phase that was asked for, m, or None; accuracy: of the motion then.
    """

    solution: Solution
    examination: Examination | None
    rounds: tuple[Round, ...]
    why: str
    examined: float
    exchange: Exchange | None = None
    target: float | None = None
    accuracy: Accuracy | None = None

    @property
    def report(self) -> CheckReport | None:
        """The check of the motion, where it was examined."""
        return None if self.examination is None else self.examination.report

    @property
    def error(self) -> float:
        """Largest error of a phase of the solution, m; inf where nothing was solved and measured."""
        return largest_error(self.accuracy)

    @property
    def reached(self) -> bool:
        """Whether the motion has the grade, and the accuracy that was asked for."""
        return self.solution.success and (self.target is None or self.error <= self.target)

    @property
    def interrupted(self) -> bool:
        """Whether the user stopped it."""
        return self.rounds[-1].status == INTERRUPTED

    @property
    def spent(self) -> float:
        """Time of the solver in all rounds, s."""
        return sum(solved.wall_time for solved in self.rounds)

    @property
    def statistics(self) -> GradedStatistics:
        """What was done, as solutions record it."""
        return GradedStatistics(
            reached=self.reached,
            why=self.why,
            spent_s=self.spent,
            examined_s=self.examined,
            rounds=tuple(each.statistics for each in self.rounds),
            target_m=self.target,
            error_m=None if self.target is None else finite_or_none(self.error),
        )

    def to_dict(self) -> dict[str, Any]:
        """The statistics, JSON-able."""
        return jsonable(asdict(self.statistics))


def largest_error(accuracy: Accuracy | None) -> float:
    """Largest error of a phase, m; inf where nothing was solved and measured."""
    return math.inf if accuracy is None else max(phase_errors(accuracy))


def phase_errors(accuracy: Accuracy) -> tuple[float, ...]:
    """Error of each phase in m: open loop from its planned start, or the drift of its contacts."""
    return tuple(max(phase.open_loop.position, phase.foot_drift or 0.0) for phase in accuracy.phases)


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
