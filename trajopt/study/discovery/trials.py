"""Trials of one schedule with hard contacts: its objective on a coarse mesh, and a motion with the grade."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from trajopt.errors import InputError
from trajopt.motion.solution import Solution
from trajopt.schedule.schedule import Motion
from trajopt.solving.graded import MOST_ROUNDS, solve_graded
from trajopt.solving.solving import solve as solve_on_mesh
from trajopt.study.discovery.modes import ModeSequence
from trajopt.study.discovery.proposals import key_frames
from trajopt.study.discovery.records import CERTIFIED, REJECTED, Candidate
from trajopt.study.discovery.task import FREE, ContactTask
from trajopt.transcription.mesh import Mesh

# Screening mesh: scheme and fraction of the problem's intervals; tolerance and iteration limit of its solve.
COARSE, PART, TOLERANCE, ITERATIONS = "legendre:2", 0.25, 1e-3, 40
# Meshes in a first attempt at certification, and iterations on each.
ROUNDS, PATIENCE = 3, 100
# A phase counts as vanished up to this multiple of its least duration.
AT_BOUND = 1.02


def screened(task: ContactTask, candidate: Candidate, max_time: float) -> Candidate:
    """The candidate with its objective on a coarse mesh; without one if that solve does not converge."""
    assert candidate.modes is not None
    assert candidate.motion is not None
    try:
        problem = task.with_modes(candidate.modes, candidate.motion)
        counts = problem.schedule.intervals(problem.default_intervals)
        mesh = Mesh.uniform(COARSE, [max(round(PART * count), 1) for count in counts])
        solution = solve_on_mesh(
            problem,
            mesh=mesh,
            tolerance=TOLERANCE,
            max_iterations=ITERATIONS,
            max_time=max_time,
            judge=False,
        )
    except InputError as error:
        return replace(candidate, why=f"{error}")
    objective = solution.statistics.objective if solution.converged else None
    return replace(_charged(candidate, solution), screened=objective)


def certified(
    task: ContactTask, candidate: Candidate, max_time: float, rounds: int = MOST_ROUNDS
) -> Candidate:
    """Solve a candidate with hard contacts until its motion has the grade, without vanished phases."""
    assert candidate.modes is not None
    assert candidate.motion is not None
    rejected = replace(candidate, status=REJECTED, why="")
    limits: dict[str, Any] = {"max_time": max_time, "max_rounds": rounds}
    if rounds == ROUNDS:
        limits["max_iterations"] = PATIENCE
    solution = _solved(task, candidate.modes, candidate.motion, limits)
    if solution is None:
        return replace(rejected, why="the problem cannot have this schedule")
    rejected = _charged(rejected, solution)
    best, modes, vanished = solution, candidate.modes, 0
    fewer = without_vanished(candidate.modes, solution, task.periodic)
    if solution.success and fewer is not None and not (task.periodic and fewer.shift):
        again = _solved(task, fewer, key_frames(task, solution), limits)
        if again is not None:
            rejected = _charged(rejected, again)
            if again.success and _objective(again) <= _objective(solution) * (1 + 1e-3):
                best, modes, vanished = again, fewer, len(candidate.modes.modes) - len(fewer.modes)
    figures = best.statistics
    if not best.success:
        missed = f": {', '.join(figures.failures)}" if figures.failures else ""
        return replace(rejected, why=f"with hard contacts {figures.status.replace('_', ' ')}{missed}")
    return replace(
        rejected,
        status=CERTIFIED,
        modes=replace(modes, modes=tuple(zip(modes.key, best.phase_durations, strict=True))),
        objective=figures.objective,
        vanished=vanished,
        solution=best,
    )


def _charged(candidate: Candidate, solution: Solution) -> Candidate:
    """The candidate with the time and the effort of another solve."""
    seconds, effort = spent(solution)
    return replace(candidate, seconds=candidate.seconds + seconds, effort=candidate.effort + effort)


def spent(solution: Solution) -> tuple[float, float]:
    """Solver time, s, and effort (iterations times variables), summed over all rounds."""
    rounds = solution.statistics.rounds
    return sum(each.wall_time_s for each in rounds), float(
        sum(each.iterations * each.variables for each in rounds)
    )


def without_vanished(modes: ModeSequence, solution: Solution, periodic: bool) -> ModeSequence | None:
    """The modes without those at their least duration in the solution; None if there are none."""
    durations = solution.phase_durations
    least = [AT_BOUND * FREE[0] * duration for _, duration in modes.modes]
    if len(durations) != len(least) or all(a > b for a, b in zip(durations, least, strict=True)):
        return None
    timed = [(key, 0.0 if a <= b else a) for key, a, b in zip(modes.key, durations, least, strict=True)]
    shortest = min((duration for _, duration in timed if duration), default=0.0)
    fewer = ModeSequence(tuple(timed), dropped=modes.dropped, unlifted=modes.unlifted)
    fewer = fewer.without_short(shortest / 2, periodic)
    return replace(fewer, dropped=modes.dropped) if shortest else None


def _solved(
    task: ContactTask, modes: ModeSequence, motion: Motion, limits: dict[str, Any]
) -> Solution | None:
    """The solution for a schedule; None if the problem cannot have it."""
    try:
        return solve_graded(task.with_modes(modes, motion), **limits).solution
    except InputError:
        return None


def _objective(solution: Solution) -> float:
    value = solution.statistics.objective
    return np.inf if value is None else value
