"""Tasks of a sweep: compile, run, solve the reference, time the fixed load."""

import math
import statistics
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.certify.accuracy.measures import measure
from trajopt.motion.solution import Solution
from trajopt.problem.problem import Problem
from trajopt.reduced.two_stage import base_rows_problem, recover_torques
from trajopt.reduced.wrench_distribution import redistribute_wrenches
from trajopt.solving.reference import converged_reference
from trajopt.solving.solving import prepare, solve
from trajopt.solving.warm_start import warm_start
from trajopt.study.solves import failure_text
from trajopt.study.sweep.records import Job, SweepRequest, TimedRun
from trajopt.study.sweep.setting import Setting, with_cone
from trajopt.transcription.compilation import compile_points
from trajopt.transcription.transcription import transcribe

# A warm start is the solution on this fraction of the intervals, with the same scheme.
COARSER = 0.5
# Columns of ``settings.csv`` about accuracy, named as in `trajopt.certify.accuracy`;
# the last two are against the reference.
COLUMNS = {
    "open_loop": "open_loop_m",
    "open_loop_motion": "open_loop_motion_m",
    "interval_error": "interval_error_m",
    "collocation_error": "collocation_error",
    "foot_drift": "foot_drift_m",
    "violation_between": "violation_between",
    "objective_gap": "objective_gap",
    "distance": "distance_m",
}
# A solve shorter than this, s, is done this many times in its process.
SHORT, TIMES = 0.1, 5


@dataclass(frozen=True)
class _Made:
    """Solves in order, of which the last gives the solution, and the time of stage two, s."""

    parts: tuple[Solution, ...]
    stage_two_time: float = 0.0

    def total(self, name: str) -> Any:
        """Sum of a figure over all solves."""
        return sum(getattr(part.statistics, name) or 0 for part in self.parts)

    @property
    def time(self) -> float:
        """Time of all solves, s."""
        return float(self.total("wall_time_s")) + self.stage_two_time


def run_job(request: SweepRequest, setting: Setting, job: Job, file: Path) -> TimedRun:
    """One run as a task, see `run_setting`."""
    return run_setting(request.load(), setting, job, request, file)


def run_setting(problem: Problem, setting: Setting, job: Job, request: SweepRequest, file: Path) -> TimedRun:
    """Solve between two calibrations, with times, and write the solution if there is one.

    request: noise of perturbed starts, limits of a solve. Raises InputError if the setting does not fit the
    problem.
    """
    asked = with_cone(problem, setting.cone)
    load = Load()
    before = load.seconds()
    begin, processor = time.perf_counter(), time.process_time()
    solves = _repeated(asked, setting, job, request)
    elapsed, busy = time.perf_counter() - begin, time.process_time() - processor
    after = load.seconds()
    made, first = sorted(solves, key=lambda made: made.time)[len(solves) // 2], solves[0]
    solution, statistics = made.parts[-1], made.parts[-1].statistics
    objective = statistics.objective
    if setting.model == "two-stage" and solution.converged:
        objective = objective_of(asked, setting, solution)
    if solution.converged:
        solution.with_statistics(objective=objective).save(file)
    # Only the first solve pays for graphs and compilation.
    compile_time = first.total("compile_time_s")
    return TimedRun(
        **asdict(job),
        status=statistics.status,
        success=statistics.converged,
        iterations=made.total("iterations"),
        wall_time=statistics.wall_time_s,
        start_time=sum((part.statistics.wall_time_s for part in made.parts[:-1]), 0.0),
        stage_two_time=made.stage_two_time,
        function_time=made.total("function_time_s"),
        build_time=first.total("build_time_s"),
        compile_time=compile_time,
        functions_compiled=first.total("functions_compiled"),
        variables=statistics.variables,
        constraints=statistics.constraints,
        objective=objective,
        max_violation=statistics.max_violation,
        calibration=max(before, after),
        cpu_share=min(1.0, busy / max(elapsed - compile_time, busy)),
        detail=failure_text(statistics),
    )


def compiled(request: SweepRequest, setting: Setting) -> dict[str, Any]:
    """Compile the functions of a setting that are not in the cache; returns times in s, and their number."""
    asked = with_cone(request.load(), setting.cone)
    first = base_rows_problem(asked) if setting.model == "two-stage" else asked
    points = transcribe(first, setting.transcription, setting.intervals).points
    _, report = compile_points(points.values(), setting.hessian)
    return {
        "build_time": report.build_time,
        "compile_time": report.compile_time,
        "functions_compiled": report.built,
    }


def solve_reference(request: SweepRequest, file: Path) -> dict[str, Any]:
    """Write the converged reference; returns its description. Raises TrajoptError if none is found."""
    reference = converged_reference(request.load(), max_time=request.reference_time)
    reference.solution.save(file)
    return {"text": str(reference)}


def calibrations(count: int) -> dict[str, Any]:
    """Times of the fixed load, s."""
    load = Load()
    return {"seconds": [load.seconds() for _ in range(count)]}


def figures(file: Path, reference: Path | None) -> dict[str, float | None]:
    """Figures of the solution in ``file`` by column; unknown ones are None. Raises TrajoptError."""
    with np.errstate(all="ignore"):  # an inaccurate motion may diverge: its figures show it
        accuracy: dict[str, Any] = measure(file, reference).to_dict()
    return {column: _number(accuracy.get(name)) for name, column in COLUMNS.items()}


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def _repeated(problem: Problem, setting: Setting, job: Job, request: SweepRequest) -> list[_Made]:
    """Repeat a solve that is short; others are done once.

    The first solve in a process pays for loading pages and libraries.
    """
    solves = [_solve(problem, setting, job, request)]
    while solves[0].time < SHORT and len(solves) < TIMES:
        solves.append(_solve(problem, setting, job, request))
    return solves


def _solve(problem: Problem, setting: Setting, job: Job, request: SweepRequest) -> _Made:
    """The solve of a setting with the steps before and after it."""
    first = base_rows_problem(problem) if setting.model == "two-stage" else problem
    arguments: dict[str, Any] = {
        "transcription": setting.transcription,
        "solver": setting.solver,
        "tolerance": setting.tolerance,
        "hessian": setting.hessian,
        "max_iterations": request.max_iterations,
        "max_time": request.max_time,
    }
    noise: dict[str, Any] = {"seed": job.start, "perturb": request.sigma if job.start else 0.0}
    parts: tuple[Solution, ...] = ()
    if setting.start == "warm":
        least = len(problem.schedule.phases)
        intervals = max(least, round(COARSER * setting.intervals))
        coarse = solve(first, intervals=intervals, **noise, **arguments)
        parts, noise = (coarse,), {"start": coarse} if coarse.converged else noise
    solution = solve(first, intervals=setting.intervals, **noise, **arguments)
    if first is problem or not solution.converged:
        return _Made((*parts, solution))
    begin = time.perf_counter()
    solution = with_torques(problem, solution)
    return _Made((*parts, solution), stage_two_time=time.perf_counter() - begin)


def with_torques(problem: Problem, solution: Solution) -> Solution:
    """Stage two: recover torques from the motion; if they exceed their limits, redistribute the wrenches.

    A solution already has the torques of its actuated rows, whether or not its problem had these rows.
    """
    _, report = recover_torques(problem, solution)
    return solution if report.within_limits else redistribute_wrenches(problem, solution)


def objective_of(problem: Problem, setting: Setting, solution: Solution) -> float:
    """The problem's objective at the solution of a variant with the same variables."""
    prepared = prepare(problem, transcription=setting.transcription, intervals=setting.intervals)
    return float(prepared.nlp.engine.f(warm_start(prepared.transcription, solution).x))


# Order of a matrix that fits the second-level cache, and number of doubles well beyond it (8 MB).
ORDER = 200
DOUBLES = 1_000_000
COUNTS = 20_000
# Loads of about 1 ms whose median is one calibration: short against a run, long enough to meet disturbances.
LOADS = 25


class Load:
    """The fixed load; its arrays are allocated once."""

    def __init__(self) -> None:
        generator = np.random.default_rng(0)
        square = generator.standard_normal((ORDER, ORDER))
        self._matrix = square @ square.T + ORDER * np.eye(ORDER)
        self._long = generator.standard_normal(DOUBLES)

    def seconds(self, loads: int = LOADS) -> float:
        """Median time of ``loads`` loads, s."""
        return statistics.median(self._once() for _ in range(loads))

    def _once(self) -> float:
        begin = time.perf_counter()
        np.linalg.cholesky(self._matrix)
        self._long.sum()
        total = 0
        for count in range(COUNTS):
            total += count
        return time.perf_counter() - begin
