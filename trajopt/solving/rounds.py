"""Record of a solve to a grade: its rounds, and the motion it ends with."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from trajopt.certify.accuracy.measures import Accuracy
from trajopt.certify.check import Examination
from trajopt.certify.report import CheckReport
from trajopt.motion.meta import jsonable
from trajopt.motion.solution import Solution
from trajopt.motion.statistics import GradedStatistics, RoundStatistics
from trajopt.problem.problem import Problem
from trajopt.solvers.status import Status
from trajopt.solving.exchange import Exchange
from trajopt.solving.verdicts import finite_or_none
from trajopt.transcription.mesh import Mesh

# Status of a solve that the user interrupted: nothing starts from it.
INTERRUPTED = Status.INTERRUPTED.word


@dataclass(frozen=True, kw_only=True)
class Round:
    """One solve: its mesh, size, and the error of each phase in m (None if not measured)."""

    mesh: Mesh
    variables: int
    iterations: int
    wall_time: float
    status: str
    errors: tuple[float, ...] | None

    @classmethod
    def of(cls, mesh: Mesh, solution: Solution) -> Round:
        """Return the round of a solution on a mesh, without errors."""
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
        """The round as recorded in solutions; errors that are not finite are None."""
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
    """The best motion found, its examination, the rounds, and ``why`` they ended.

    Args:
        examined: Time of all checks, s.
        exchange: The collision rows; None without legs.
        target: Requested error of a phase, m; None if there is none.
        accuracy: Measured accuracy of the motion; None if not measured.
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
        """The check of the motion; None if it was not checked."""
        return None if self.examination is None else self.examination.report

    @property
    def error(self) -> float:
        """Largest error of a phase of the solution, m; inf if not measured."""
        return largest_error(self.accuracy)

    @property
    def reached(self) -> bool:
        """Whether the motion is within the grade and the requested accuracy."""
        return self.solution.success and (self.target is None or self.error <= self.target)

    @property
    def interrupted(self) -> bool:
        """Whether the user stopped the last round."""
        return self.rounds[-1].status == INTERRUPTED

    @property
    def spent(self) -> float:
        """Solver time of all rounds, s."""
        return sum(solved.wall_time for solved in self.rounds)

    @property
    def statistics(self) -> GradedStatistics:
        """The record of the solve as stored in solutions."""
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
        """Return the statistics, JSON-able."""
        return jsonable(asdict(self.statistics))


def largest_error(accuracy: Accuracy | None) -> float:
    """Return the largest error of a phase, m; inf if not measured."""
    return math.inf if accuracy is None else max(phase_errors(accuracy))


def phase_errors(accuracy: Accuracy) -> tuple[float, ...]:
    """Return the error of each phase, m: the larger of its open-loop error and its contact drift."""
    return tuple(max(phase.open_loop.position, phase.foot_drift or 0.0) for phase in accuracy.phases)


def unknowns_by_phase(problem: Problem) -> list[tuple[int, int]]:
    """Return the approximate number of variables per node and per collocation point of each phase."""
    robot = problem.robot
    wrenches = [
        sum(robot.contact(name).dimension for name in phase.contacts) for phase in problem.schedule.phases
    ]
    return [(2 * robot.nv, robot.nv + size) for size in wrenches]


def unknowns_on_mesh(problem: Problem, mesh: Mesh) -> int:
    """Return the approximate number of variables of a problem on a mesh."""
    return sum(
        phase.count * (node + phase.method.s * point)
        for phase, (node, point) in zip(mesh.phases, unknowns_by_phase(problem), strict=True)
    )
