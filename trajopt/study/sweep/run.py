"""One run, and the accuracy of one solution: what a worker's child process does."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from trajopt.problem.problem import Problem
from trajopt.reduced.two_stage import base_rows_problem, recover_torques
from trajopt.reduced.wrench_distribution import redistribute_wrenches
from trajopt.solution.solution import Solution
from trajopt.solving.solving import prepare, solve
from trajopt.solving.warm_start import warm_start
from trajopt.study.sweep.calibration import Load
from trajopt.study.sweep.result import Job, Run
from trajopt.study.sweep.setting import Setting
from trajopt.study.sweep.variants import with_cone
from trajopt.transcription.compilation import compile_points
from trajopt.transcription.transcription import transcribe
from trajopt.transcription.violations import describe_block

# A warm start comes from the solution on this part of the intervals, in the same scheme.
COARSER = 0.5
# A solve that takes less than this, s, is made so many times in its process.
SHORT, TIMES = 0.1, 5


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a solve may take, and the noise (standard deviation, scaled units) of its perturbed starts."""

    sigma: float
    max_iterations: int
    max_time: float


@dataclass(frozen=True, kw_only=True)
class _Made:
    """A solution and what it took besides its own solve, s."""

    solution: Solution
    coarse: Solution | None
    stage_two_time: float = 0.0

    @property
    def time(self) -> float:
        """Time of all that was solved, s."""
        return sum(part.meta["wall_time_s"] for part in self.parts) + self.stage_two_time

    @property
    def parts(self) -> list[Solution]:
        """All that was solved, in order."""
        return [part for part in (self.coarse, self.solution) if part is not None]


def run(problem: Problem, setting: Setting, job: Job, limits: Limits, file: Path) -> Run:
    """Solve, timed between two calibrations, and write the solution where there is one.

    Raises InputError where the setting does not fit the problem.
    """
    asked = with_cone(problem, setting.cone)
    load = Load()
    before = load.seconds()
    begin, processor = time.perf_counter(), time.process_time()
    found = _repeated(asked, setting, job, limits)
    elapsed, busy = time.perf_counter() - begin, time.process_time() - processor
    after = load.seconds()
    made = sorted(found, key=lambda made: made.time)[len(found) // 2]
    solution = made.solution
    if setting.model == "two-stage" and solution.success:
        objective = objective_of(asked, setting, solution)
        solution = replace(solution, meta={**solution.meta, "objective": objective})
    if solution.success:
        solution.save(file)
    once = _preparation(found[0])
    return replace(
        _figures(replace(made, solution=solution), job),
        **once,
        calibration=max(before, after),
        cpu_share=min(1.0, busy / max(elapsed - once["compile_time"], busy)),
    )


def compiled(problem: Problem, setting: Setting) -> dict[str, Any]:
    """Compile what a setting needs, where it is not in the cache: times in s, and how many functions."""
    asked = with_cone(problem, setting.cone)
    first = base_rows_problem(asked) if setting.model == "two-stage" else asked
    groups = transcribe(first, setting.transcription, setting.intervals).groups
    points = {id(group.point): group.point for group in groups}
    _, report = compile_points(points.values(), setting.compile, setting.hessian)
    return {
        "build_time": report.build_time,
        "compile_time": report.compile_time,
        "functions_compiled": report.built,
    }


def _repeated(problem: Problem, setting: Setting, job: Job, limits: Limits) -> list[_Made]:
    """The same solve several times where it is short, else once.

    The first solve of a process pays for pages and libraries that the others find in place.
    """
    found = [_solve(problem, setting, job, limits)]
    while found[0].time < SHORT and len(found) < TIMES:
        found.append(_solve(problem, setting, job, limits))
    return found


def _preparation(first: _Made) -> dict[str, Any]:
    """What the first solve of a process paid for graphs and the compiler; the others find them made."""
    names = {"build_time": "build_time_s", "compile_time": "compile_time_s"}
    names["functions_compiled"] = "functions_compiled"
    return {name: sum(part.meta[key] for part in first.parts) for name, key in names.items()}


def _solve(problem: Problem, setting: Setting, job: Job, limits: Limits) -> _Made:
    """The solve of a setting with what it needs before and after."""
    first = base_rows_problem(problem) if setting.model == "two-stage" else problem
    arguments: dict[str, Any] = {
        "transcription": setting.transcription,
        "solver": setting.solver,
        "tolerance": setting.tolerance,
        "hessian": setting.hessian,
        "compile": setting.compile,
        "max_iterations": limits.max_iterations,
        "max_time": limits.max_time,
    }
    noise: dict[str, Any] = {"seed": job.start, "perturb": limits.sigma if job.start else 0.0}
    coarse: Solution | None = None
    if setting.start == "warm":
        least = len(problem.schedule.phases)
        intervals = max(least, round(COARSER * setting.intervals))
        coarse = solve(first, intervals=intervals, **noise, **arguments)
        noise = {"start": coarse} if coarse.success else noise
    solution = solve(first, intervals=setting.intervals, **noise, **arguments)
    if first is problem or not solution.success:
        return _Made(solution=solution, coarse=coarse)
    begin = time.perf_counter()
    solution = with_torques(problem, solution)
    return _Made(solution=solution, coarse=coarse, stage_two_time=time.perf_counter() - begin)


def with_torques(problem: Problem, solution: Solution) -> Solution:
    """Stage two: torques read off the motion; where they are beyond their limits, wrenches shared anew.

    A solution has the torques of its actuated rows already, whether its rows held them or not.
    """
    _, report = recover_torques(problem, solution)
    return solution if report.within_limits else redistribute_wrenches(problem, solution)


def objective_of(problem: Problem, setting: Setting, solution: Solution) -> float:
    """The problem's objective at a solution of another one with the same unknowns."""
    prepared = prepare(
        problem, transcription=setting.transcription, intervals=setting.intervals, compile="none"
    )
    return float(prepared.nlp.engine.f(warm_start(prepared.transcription, solution).x))


def _figures(made: _Made, job: Job) -> Run:
    meta = made.solution.meta

    def total(name: str) -> Any:
        return sum(part.meta[name] for part in made.parts)

    worst = "" if meta["success"] else f"{meta['status']}: {describe_block(meta['worst_blocks'][0])}"
    return Run(
        setting=job.setting,
        start=job.start,
        attempt=job.attempt,
        status=meta["status"],
        success=meta["success"],
        iterations=total("iterations"),
        wall_time=meta["wall_time_s"],
        start_time=0.0 if made.coarse is None else made.coarse.meta["wall_time_s"],
        stage_two_time=made.stage_two_time,
        function_time=total("function_time_s"),
        variables=meta["variables"],
        constraints=meta["constraints"],
        objective=meta["objective"],
        max_violation=meta["max_violation"],
        detail=worst,
    )
