"""How a solution was found: solver, status, size, times, residuals, and refinement rounds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from trajopt.arguments import Count, NonNegative, checked
from trajopt.transcription.mesh import Mesh


@checked
@dataclass(frozen=True, kw_only=True)
class RoundStatistics:
    """One solve of a refinement: mesh in words, size, effort, and error of each phase in m."""

    transcription: str
    intervals: tuple[int, ...]
    variables: int
    iterations: int
    wall_time_s: float
    status: str
    errors_m: tuple[float | None, ...] | None = None


@checked
@dataclass(frozen=True, kw_only=True)
class GradedStatistics:
    """A solve to an accuracy grade: whether and why it ended, all rounds, times of solver and checks in s.

    target_m: required accuracy of each phase. error_m: largest error of the result.
    """

    reached: bool
    why: str
    spent_s: float
    examined_s: float
    rounds: tuple[RoundStatistics, ...] = ()
    target_m: float | None = None
    error_m: float | None = None


@checked
@dataclass(frozen=True, kw_only=True)
class TermExcess:
    """Largest violation of a term between its points, judged by the solve.

    Args:
        term: name of the term.
        phase: phase in which it is largest.
        time: its time, s.
        excess: violation over the row's unit, or over half the range of two bounds if that is smaller.
    """

    term: str
    phase: str
    time: float
    excess: NonNegative


@dataclass(frozen=True, kw_only=True)
class SolveStatistics:
    """How a solution was found; times in s, residuals scaled, None where a value is unknown.

    Attributes:
        success: Whether the solver converged and the motion meets the tolerances of the check.
        converged: Whether the solver met its tolerance: all rows hold at the points.
        status, solver_status: The library's and the solver's status in words.
        advice: Lines that say what fails, where, and what to try.
        worst_blocks: Largest violations by block, with phase, node, point, time, violation.
        failures, worst_figure, tolerance_used: Figures beyond a tolerance; the worst one, over its tolerance.
        row_names: Blocks of rows to which the multiplier arrays refer.
        mesh: None if it follows from the sample times.
        terms_between, excess_by_interval: Terms that a check of the file cannot evaluate, at moments between
            their points: the worst of each, and of each interval.
        graded: Refinement rounds. simulation: Report of a simulated motion.
        more: Further values of the solver and entries of other programs, JSON-able.
    """

    transcription: str
    solver: str
    status: str
    success: bool
    converged: bool
    iterations: Count
    objective: float | None
    tolerance: float
    wall_time_s: float
    versions: Mapping[str, Any] = field(default_factory=dict)
    solver_status: str = ""
    advice: str = ""
    hessian: str | None = None
    mesh: Mesh | None = None
    variables: Count = 0
    constraints: Count = 0
    max_violation: float | None = None
    primal_infeasibility: float | None = None
    dual_infeasibility: float | None = None
    complementarity: float | None = None
    worst_blocks: tuple[Mapping[str, Any], ...] = ()
    function_time_s: float | None = None
    build_time_s: float | None = None
    compile_time_s: float | None = None
    verdict_time_s: float | None = None
    functions_compiled: Count | None = None
    warm_start: bool = False
    seed: Count | None = None
    perturb: float | None = None
    failures: tuple[str, ...] = ()
    worst_figure: str = ""
    tolerance_used: float | None = None
    certified_infeasible: bool = False
    gimbal_margin: float | None = None
    rotation_norm_error: float | None = None
    redundant_contact_rows: Mapping[str, Any] = field(default_factory=dict)
    row_names: tuple[str, ...] = ()
    terms_between: tuple[TermExcess, ...] = ()
    excess_by_interval: tuple[float, ...] = ()
    graded: GradedStatistics | None = None
    simulation: Mapping[str, Any] | None = None
    more: Mapping[str, Any] = field(default_factory=dict)

    @property
    def advice_in_line(self) -> str:
        """The advice in one line."""
        return "; ".join(self.advice.splitlines())

    @property
    def simulated(self) -> bool:
        """Whether the motion was simulated by a physics engine."""
        return self.simulation is not None

    @property
    def rounds(self) -> tuple[RoundStatistics | SolveStatistics, ...]:
        """All solves that led to the solution: those of its refinement, or itself."""
        return (self.graded and self.graded.rounds) or (self,)
