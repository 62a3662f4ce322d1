"""One pair: solved to the grade from its default guess, then from perturbed starts.

Progress is sent as events, JSON-able dicts, because a pair runs in a separate process that may be killed at
any moment: events sent by then are not lost.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from trajopt.errors import TrajoptError
from trajopt.problem.catalogue import families
from trajopt.problem.family import choose
from trajopt.problem.problem import Problem
from trajopt.simulation.settings import Controller
from trajopt.solution.grid import mesh_of
from trajopt.solution.solution import Solution
from trajopt.solving.graded import solve
from trajopt.solving.ladder import total_effort
from trajopt.solving.monitoring import ProgressCallback
from trajopt.solving.time_limits import BESIDE, GRACE
from trajopt.study.suite.cases import Case
from trajopt.study.suite.failure import failure_text, mode_of
from trajopt.study.suite.optima import described
from trajopt.study.suite.outcome import Attempt, Ledger, Outcome
from trajopt.study.suite.physics import Physics, simulated
from trajopt.study.suite.settings import SuiteSettings
from trajopt.study.workers.task import limit_time, tell

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

    limits: seconds by stage; a solve has its own limit, which it checks between steps, `BESIDE` and `GRACE`.
    """
    last = 0.0

    def hear(event: Event) -> None:
        if event["event"] == "stage":
            stage = event["stage"]
            limit_time(limits.get(stage, settings.max_time + BESIDE + GRACE), stage)
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

    own: solve from the default guess; False when a run goes on after a lost process.
    seeds: perturbed starts, default those of the settings. folder: where the solution file is written. Raises
    TrajoptError if the pair cannot be built.
    """
    hear({"event": "stage", "stage": "build"})
    problem = choose(families(), case.problem).load(case.values)
    legged = problem.robot.base != "fixed"
    shared: dict[str, Any] = {
        "fixed_mesh": settings.fixed_mesh,
        "solver": settings.solver,
        "tolerance": settings.tolerance,
        "max_iterations": settings.max_iterations,
        "max_time": settings.max_time,
        "progress": progress,
    }
    if own:
        hear({"event": "stage", "stage": "own"})
        solution = solve(problem, **shared)
        if folder is not None:
            _save(solution, folder / f"{case.problem}@{Path(case.robot).stem}.npz")
        hear({"event": "own", "values": asdict(attempt(solution, None, legged))})
        if settings.simulate:
            hear({"event": "stage", "stage": "physics"})
            hear(
                {
                    "event": "physics",
                    "values": asdict(_physics(case, problem, solution, folder, settings.controller)),
                }
            )
    for seed in settings.seeds if seeds is None else seeds:
        hear({"event": "stage", "stage": "start", "seed": seed})
        solution = solve(problem, seed=seed, perturb=settings.sigma, **shared)
        hear({"event": "start", "values": asdict(attempt(solution, seed, legged))})


def measure_case(case: Case, settings: SuiteSettings) -> Outcome:
    """Run one pair in this process. Raises TrajoptError if the pair cannot be built."""
    ledger, begin = Ledger(case), time.perf_counter()
    run_stages(case, settings, ledger.add)
    return ledger.outcome(time.perf_counter() - begin)


def attempt(solution: Solution, seed: int | None, legged: bool) -> Attempt:
    """The figures of one solve to the grade, iterations and time of all its meshes."""
    statistics = solution.statistics
    mode, mesh, spent = mode_of(statistics), mesh_of(solution), total_effort([solution])
    return Attempt(
        seed=seed,
        mode=mode,
        status=statistics.status,
        legged=legged,
        scheme=mesh.transcription,
        intervals=sum(mesh.counts),
        meshes=len(solution.statistics.rounds),
        variables=statistics.variables,
        constraints=statistics.constraints,
        iterations=spent["iterations"],
        wall_time=spent["wall_time_s"],
        objective=statistics.objective,
        primal=statistics.primal_infeasibility,
        dual=statistics.dual_infeasibility,
        complementarity=statistics.complementarity,
        detail=failure_text(statistics),
        figure=statistics.worst_figure,
        used=statistics.tolerance_used,
        motion="" if mode else described(solution),
    )


def _physics(
    case: Case, problem: Problem, solution: Solution, folder: Path | None, controller: Controller
) -> Physics:
    """Simulate a solved plan of a legged robot; nothing for other robots, or if it was not solved."""
    if not solution.converged or problem.robot.base == "fixed":
        return Physics()
    name = f"{case.problem}@{Path(case.robot).stem}{SIMULATED}.npz"
    return simulated(solution, None if folder is None else folder / name, controller)


def _save(solution: Solution, target: Path) -> None:
    """Write the solution file; an iterate that is not a motion has none."""
    try:
        solution.save(target)
    except TrajoptError:
        target.unlink(missing_ok=True)
