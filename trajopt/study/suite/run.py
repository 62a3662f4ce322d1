"""One pair: prepared once, solved from its default guess, checked, then solved from perturbed starts.

Progress is sent as events, JSON-able dicts, because a pair runs in a separate process that may be killed at
any moment: events sent by then are not lost.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.certify.check import check
from trajopt.certify.report import AT_POINTS, FIGURES
from trajopt.errors import TrajoptError
from trajopt.problem.catalogue import families
from trajopt.problem.family import choose
from trajopt.solution.solution import Solution
from trajopt.solvers.result import StoppingCriteria
from trajopt.solving.interruption import GRACE
from trajopt.solving.monitoring import ProgressCallback
from trajopt.solving.solving import PreparedProblem, prepare, solve_prepared
from trajopt.study.suite.cases import Case
from trajopt.study.suite.failure import failure_text, mode_of
from trajopt.study.suite.optima import described
from trajopt.study.suite.outcome import Attempt, Checked, Grid, Ledger, Outcome
from trajopt.study.suite.physics import Physics, simulated
from trajopt.study.suite.settings import SuiteSettings
from trajopt.study.workers.task import limit_time, tell
from trajopt.transcription.guess import perturbed

Event = dict[str, Any]
# Suffix of files with a simulated motion.
SIMULATED = "-simulated"
# Shortest time between events about iterations, s: a display needs no more.
PAUSE = 0.2


def run_case(
    case: Case,
    settings: SuiteSettings,
    limits: Mapping[str, float],
    own: bool,
    seeds: Sequence[int],
    folder: Path | None,
) -> None:
    """Run one pair as a task: its events are sent with its name, and each stage has a time limit.

    limits: seconds by stage; a solve has its own limit, which it checks between steps, and `GRACE`.
    """
    last = 0.0

    def hear(event: Event) -> None:
        if event["event"] == "stage":
            stage = event["stage"]
            limit_time(limits.get(stage, settings.max_time + GRACE), stage)
        tell((case.name, event))

    def progress(figures: dict[str, float]) -> bool:
        nonlocal last
        now = time.monotonic()
        if now - last >= PAUSE:
            last = now
            tell((case.name, {"event": "iteration", "iteration": int(figures["iteration"])}))
        return True

    run_stages(case, settings, hear, own=own, seeds=seeds, progress=progress, folder=folder)


def run_stages(
    case: Case,
    settings: SuiteSettings,
    hear: Callable[[Event], None],
    *,
    own: bool = True,
    seeds: Sequence[int] | None = None,
    progress: ProgressCallback | None = None,
    folder: Path | None = None,
) -> None:
    """Run one pair and send its events: stages as they begin, figures once known.

    own: solve from the default guess and check; False when a run goes on after a lost process.
    seeds: perturbed starts, default those of the settings. folder: where the solution file is written. Raises
    TrajoptError if the pair cannot be built.
    """
    hear({"event": "stage", "stage": "build"})
    problem = choose(families(), case.problem).load(case.values)
    prepared = prepare(problem, compile=settings.compile)
    stop = StoppingCriteria(
        tolerance=settings.tolerance, max_iterations=settings.max_iterations, max_time=settings.max_time
    )
    shared: dict[str, Any] = {"solver": settings.solver, "stop": stop, "progress": progress}
    hear({"event": "grid", "values": asdict(_grid(prepared))})
    if own:
        hear({"event": "stage", "stage": "own"})
        solution = solve_prepared(prepared, prepared.guess, origin={"seed": 0, "perturb": 0.0}, **shared)
        hear({"event": "own", "values": asdict(attempt(solution, None))})
        hear({"event": "stage", "stage": "check"})
        hear({"event": "check", "values": asdict(checked(solution))})
        if folder is not None:
            _save(solution, folder / f"{case.problem}@{Path(case.robot).stem}.npz")
        if settings.simulate:
            hear({"event": "stage", "stage": "physics"})
            hear({"event": "physics", "values": asdict(_physics(case, prepared, solution, folder))})
    for seed in settings.seeds if seeds is None else seeds:
        hear({"event": "stage", "stage": "start", "seed": seed})
        start = perturbed(prepared.transcription, prepared.guess, seed, settings.sigma)
        origin = {"seed": seed, "perturb": settings.sigma}
        solution = solve_prepared(prepared, start, origin=origin, **shared)
        hear({"event": "start", "values": asdict(attempt(solution, seed))})


def measure_case(case: Case, settings: SuiteSettings) -> Outcome:
    """Run one pair in this process. Raises TrajoptError if the pair cannot be built."""
    ledger, begin = Ledger(case), time.perf_counter()
    run_stages(case, settings, ledger.add)
    return ledger.outcome(time.perf_counter() - begin)


def _grid(prepared: PreparedProblem) -> Grid:
    t = prepared.transcription
    return Grid(
        scheme=t.layout.mesh.transcription,
        intervals=t.layout.n_intervals,
        variables=t.layout.n_unknowns,
        constraints=t.n_rows,
        legged=t.problem.robot.base != "fixed",
        build_time=prepared.build_time,
        compile_time=prepared.compilation.compile_time,
    )


def attempt(solution: Solution, seed: int | None) -> Attempt:
    """The figures of one solve."""
    meta = solution.meta
    mode = mode_of(meta)
    return Attempt(
        seed=seed,
        mode=mode,
        status=meta["status"],
        iterations=meta["iterations"],
        wall_time=meta["wall_time_s"],
        objective=meta["objective"],
        primal=meta["primal_infeasibility"],
        dual=meta["dual_infeasibility"],
        complementarity=meta["complementarity"],
        detail=failure_text(meta),
        motion="" if mode else described(solution),
    )


def checked(solution: Solution) -> Checked:
    """The check of a solution at its points, its worst figure named; one that cannot be computed is not ok.

    Its mesh is fixed: what it misses between points is for a finer one.
    """
    try:
        with np.errstate(all="ignore"):  # an iterate far from a solution may overflow: its figures show it
            report = check(solution, integrate=False)
    except (TrajoptError, ArithmeticError, ValueError) as error:
        return Checked(ok=False, figure="", used=None, error=f"cannot be checked: {error}")
    name, used = report.worst(AT_POINTS)
    failures = tuple(FIGURES[failure].text for failure in report.failures(AT_POINTS))
    return Checked(
        ok=not failures,
        figure=FIGURES[name].text,
        used=used if np.isfinite(used) else None,
        failures=failures,
    )


def _physics(case: Case, prepared: PreparedProblem, solution: Solution, folder: Path | None) -> Physics:
    """Simulate a solved plan of a legged robot; nothing for other robots, or if it was not solved."""
    if not solution.converged or prepared.transcription.problem.robot.base == "fixed":
        return Physics()
    name = f"{case.problem}@{Path(case.robot).stem}{SIMULATED}.npz"
    return simulated(solution, None if folder is None else folder / name)


def _save(solution: Solution, target: Path) -> None:
    """Write the solution file; an iterate that is not a motion has none."""
    try:
        solution.save(target)
    except TrajoptError:
        target.unlink(missing_ok=True)
