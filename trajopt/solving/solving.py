"""Problem -> transcription -> compiled NLP -> solver -> Solution, in one call."""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.errors import InputError
from trajopt.motion.input import solution_of
from trajopt.motion.solution import Solution
from trajopt.problem.problem import Problem
from trajopt.solvers.drivers import check_solver
from trajopt.solvers.result import LEAST_TIME, Option, Result, StoppingCriteria, WarmMultipliers
from trajopt.solvers.status import Status
from trajopt.solving.conflict import why_infeasible
from trajopt.solving.extraction import extract
from trajopt.solving.monitoring import ProgressCallback, ProgressReporter, Watch
from trajopt.solving.multipliers import with_multipliers
from trajopt.solving.stalling import solve_or_certify
from trajopt.solving.verdicts import (
    TRUSTED_VIOLATION,
    advice_for,
    certified_infeasible,
    fail_on_gimbal_lock,
    finite_or_none,
    judged,
    status_by_violation,
    terms_between,
)
from trajopt.solving.warm_start import warm_start
from trajopt.transcription.compilation import CompilationReport, compile_points, entry_key
from trajopt.transcription.guess import initial_guess, perturbed
from trajopt.transcription.hessians import DEFAULT_HESSIAN
from trajopt.transcription.mesh import Mesh
from trajopt.transcription.nlp import Nlp, assemble
from trajopt.transcription.transcription import Transcription, transcribe
from trajopt.transcription.violations import nonfinite_place, row_violations, worst_blocks

DEFAULT_SOLVER = "ipopt"
MAX_PERTURBATION = 100.0


@dataclass(frozen=True, kw_only=True)
class PreparedProblem:
    """A problem ready to be solved from its guess; ``build_time`` in s excludes compilation."""

    transcription: Transcription
    nlp: Nlp
    guess: np.ndarray
    compilation: CompilationReport
    build_time: float
    warm: WarmMultipliers | None = None


def prepare(
    problem: Problem,
    *,
    transcription: str | None = None,
    intervals: int | None = None,
    mesh: Mesh | None = None,
    hessian: str = DEFAULT_HESSIAN,
    threads: int = 1,
    start: Solution | str | Path | None = None,
    max_time: float = math.inf,
) -> PreparedProblem:
    """Transcribe, compile (or load from the cache) and assemble the NLP; arguments as in `solve`.

    The guess is the resampled solution ``start``, or the problem's guess, whose computation stops after
    ``max_time`` s. Raises `InputError`.
    """
    begun = time.perf_counter()
    transcribed = transcribe(problem, transcription, intervals, mesh)
    points = transcribed.points
    compiled, report = compile_points(points.values(), hessian)
    by_point = {key: compiled[entry_key(point)] for key, point in points.items()}
    nlp = assemble(transcribed, by_point, threads, hessian)
    if start is None:
        deadline = begun + report.compile_time + max_time
        guess, warm = initial_guess(transcribed, deadline), None
    else:
        resampled = warm_start(transcribed, solution_of(start))
        guess, warm = resampled.x, resampled.multipliers or WarmMultipliers()
    build_time = time.perf_counter() - begun - report.compile_time
    return PreparedProblem(
        transcription=transcribed,
        nlp=nlp,
        guess=guess,
        compilation=report,
        build_time=build_time,
        warm=warm,
    )


def solve(
    problem: Problem,
    *,
    transcription: str | None = None,
    intervals: int | None = None,
    mesh: Mesh | None = None,
    solver: str = DEFAULT_SOLVER,
    tolerance: float = 1e-6,
    max_iterations: int = 500,
    max_time: float = 600.0,
    seed: int = 0,
    perturb: float = 0.0,
    hessian: str = DEFAULT_HESSIAN,
    threads: int = 1,
    options: Mapping[str, Option] | None = None,
    progress: ProgressCallback | None = None,
    watch: Watch | None = None,
    label: str = "",
    start: Solution | str | Path | None = None,
    judge: bool = True,
    solver_time: bool = False,
) -> Solution:
    """Solve a problem on one mesh; never raises because the solver did not converge.

    Args:
        problem: The problem to solve.
        transcription: Name of the scheme, for example ``legendre:2``, or one for each phase, separated by
            commas; default: the problem's.
        intervals: Number of intervals over the whole schedule; default: the problem's.
        mesh: Schemes and widths of intervals by phase, instead of the two above.
        solver: Name in `trajopt.solvers.drivers.SOLVERS`: ``ipopt``, or one that you add.
        tolerance: Tolerance on feasibility and optimality, in natural units (weight, length, sqrt(l/g)).
        max_iterations: Limit of the solver's iterations.
        max_time: Limit of wall time, s, without compilation, which is done once.
        seed: Seed of the noise on the guess.
        perturb: Standard deviation of that noise, scaled units.
        hessian: ``exact``, ``gauss-newton`` (of costs that are squares, without curvature of constraints),
            or with IPOPT ``limited-memory`` (quasi-Newton: no second derivatives are compiled).
        threads: Threads for functions and linear systems; the result is the same, bit by bit.
        options: Options of the solver; unknown ones are rejected.
        progress: Called at each iteration with its figures; returns False to stop there.
        watch: Called with the guess, each `Iterate` and the end; exceptions in it become warnings.
        label: Which of several solves this is, for the watch.
        start: Solution, or its file, to start from instead of the problem's guess, with the same joints and
            phases, but on any mesh and with any durations and parameters (see `warm_start`).
        judge: Check a motion that converged; False if the caller does.
        solver_time: Whether ``max_time`` limits only the solver's time.

    Returns:
        A solution whose ``statistics`` have status, success, advice, iterations, objective, times and the
        worst blocks of rows.

    Raises:
        InputError: For a value that is not allowed.
    """
    check_settings(solver, tolerance, max_iterations, max_time, perturb, seed, hessian)
    prepared = prepare(
        problem,
        transcription=transcription,
        intervals=intervals,
        mesh=mesh,
        hessian=hessian,
        threads=threads,
        start=start,
        max_time=math.inf if solver_time else max_time,
    )
    left = max_time if solver_time else max(max_time - prepared.build_time, LEAST_TIME)
    guess = perturbed(prepared.transcription, prepared.guess, seed, perturb) if perturb else prepared.guess
    return solve_prepared(
        prepared,
        guess,
        origin={"seed": seed, "perturb": perturb},
        solver=solver,
        stop=StoppingCriteria(tolerance=tolerance, max_iterations=max_iterations, max_time=left),
        options=options,
        progress=progress,
        watch=watch,
        label=label,
        judge=judge,
    )


def solve_prepared(
    prepared: PreparedProblem,
    start: np.ndarray,
    *,
    origin: Mapping[str, Any],
    solver: str = DEFAULT_SOLVER,
    stop: StoppingCriteria | None = None,
    options: Mapping[str, Option] | None = None,
    progress: ProgressCallback | None = None,
    watch: Watch | None = None,
    label: str = "",
    judge: bool = True,
) -> Solution:
    """Solve a prepared problem, any number of times; never raises because the solver did not converge.

    Args:
        prepared: The result of `prepare`.
        start: Scaled variables (n_unknowns,).
        origin: Where the start comes from, for the statistics: at least ``seed`` and ``perturb``.
        solver: As in `solve`.
        stop: Tolerance, and limits of iterations and time.
        options: As in `solve`.
        progress: As in `solve`.
        watch: As in `solve`.
        label: As in `solve`.
        judge: As in `solve`.
    """
    stop = stop or StoppingCriteria()
    place = nonfinite_place(prepared.nlp, start)
    reporter = ProgressReporter(prepared.transcription, progress, watch, solver, label)
    reporter.see("guess", lambda: start)
    if place is None:
        result, certificate = solve_or_certify(
            prepared.nlp, start, solver, stop, options or {}, reporter, prepared.warm
        )
    else:
        result, certificate = _not_finite(prepared, start), None
    solution = _solution(prepared, result, solver, stop.tolerance, place, origin)
    if certificate is not None:
        solution = certified_infeasible(solution, why_infeasible(prepared.nlp, certificate))
    solution = fail_on_gimbal_lock(solution)
    if judge:
        solution = judged(solution)
    reporter.end(result, solution.statistics.status)
    return solution


def check_settings(
    solver: str,
    tolerance: float,
    max_iterations: int,
    max_time: float,
    perturb: float,
    seed: int,
    hessian: str = DEFAULT_HESSIAN,
) -> None:
    """Raise `InputError` for arguments of `solve` that are not allowed."""
    check_solver(solver, hessian)
    if not (math.isfinite(tolerance) and 0 < tolerance < 1):
        raise InputError(f"tolerance is {tolerance:g}", "allowed: between 0 and 1")
    if max_iterations < 0:
        raise InputError(f"max_iterations is {max_iterations}", "allowed: 0 or more")
    if not max_time > 0:
        raise InputError(f"max_time is {max_time:g} s", "allowed: > 0")
    if not (math.isfinite(perturb) and 0 <= perturb <= MAX_PERTURBATION):
        raise InputError(f"perturb is {perturb:g}", f"allowed: 0 to {MAX_PERTURBATION:g}")
    if seed < 0:
        raise InputError(f"seed is {seed}", "allowed: 0 or more")


def _not_finite(prepared: PreparedProblem, x: np.ndarray) -> Result:
    return Result(
        x=x,
        lam_g=np.zeros(prepared.transcription.n_rows),
        lam_x=np.zeros_like(x),
        status=Status.NOT_FINITE,
        solver_status="not started",
        iterations=0,
        objective=math.nan,
        wall_time=0.0,
        function_time=0.0,
    )


def _solution(
    prepared: PreparedProblem,
    result: Result,
    solver: str,
    tolerance: float,
    place: str | None,
    origin: Mapping[str, Any],
) -> Solution:
    t, report = prepared.transcription, prepared.compilation
    violations = row_violations(prepared.nlp, result.x)
    worst = float(violations.max()) if np.all(np.isfinite(violations)) else math.nan
    status = status_by_violation(result.status, worst, tolerance)
    success = status is Status.SOLVED
    points = {
        id(group.point): parts["value"]
        for group, parts in zip(t.groups, prepared.nlp.parts["groups"], strict=True)
    }
    feasible = min(worst, result.recent_primal) <= TRUSTED_VIOLATION * tolerance
    costless = not (t.problem.costs or t.problem.node_costs or t.problem.impact_costs)
    if status is Status.NOT_FINITE:
        place = place or nonfinite_place(prepared.nlp, result.x)
    solution = extract(
        t,
        result.x,
        **(terms_between(t, points, result.x) if success else {}),
        solver=solver,
        hessian=prepared.nlp.hessian,
        status=status.word,
        solver_status=result.solver_status,
        success=success,
        converged=success,
        advice=advice_for(status, place, feasible, costless),
        iterations=result.iterations,
        objective=finite_or_none(result.objective * t.objective_unit),
        tolerance=tolerance,
        variables=t.layout.n_unknowns,
        constraints=t.n_rows,
        max_violation=finite_or_none(worst),
        primal_infeasibility=finite_or_none(result.primal),
        dual_infeasibility=finite_or_none(result.dual),
        complementarity=finite_or_none(result.complementarity),
        worst_blocks=tuple(worst_blocks(t, result.x, violations, 3)),
        wall_time_s=result.wall_time,
        function_time_s=result.function_time,
        build_time_s=prepared.build_time,
        compile_time_s=report.compile_time,
        functions_compiled=report.built,
        warm_start=prepared.warm is not None,
        more=dict(result.figures),
        **origin,
    )
    return with_multipliers(solution, t, result.lam_g, result.lam_x)
