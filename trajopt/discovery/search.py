"""From a task to schedules with hard contacts: propose, certify, choose."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.arguments import checked
from trajopt.discovery.modes import ModeSequence
from trajopt.discovery.proposals import Proposal, known_proposals, relaxed_proposal
from trajopt.discovery.records import CERTIFIED, REJECTED, Candidate, Discovery, Records
from trajopt.discovery.task import FREE, ContactTask
from trajopt.errors import InputError
from trajopt.motion.configurations import geodesic_motion
from trajopt.problem.problem import Problem
from trajopt.solution.solution import Solution
from trajopt.solving.graded import solve
from trajopt.solving.ladder import total_effort
from trajopt.study.cluster import local_or
from trajopt.study.runner import DONE, Task, run_tasks

SEEDS, MOST, MAX_TIME = 4, 12, 30.0
# Durations that differ by less in all, over that of the motion, are the same schedule.
ALIKE = 0.2
# A phase at its least duration is meant to vanish; relative to the bound.
AT_BOUND = 1.02
# Beside the solver's limit of time: to build, to examine and to solve once more without phases that vanish.
BESIDE = 4.0


@checked
def discover(
    problem: Problem | ContactTask,
    *,
    seeds: int = SEEDS,
    known: bool = True,
    most: int = MOST,
    max_time: float = MAX_TIME,
    jobs: int | None = 1,
    folder: Path | str | None = None,
    resume: bool = False,
    told: Callable[[Candidate], object] = id,
) -> Discovery:
    """Find schedules of contacts for a task, and motions with hard contacts that hold at any time.

    Args:
        problem: whose phases are not used, or a task, as from `task_to`.
        seeds: relaxed motions, the first from legs that stand still, others from noise beside it.
        known: whether gaits, hops and steps that are known are proposed, too.
        most: schedules that are solved with hard contacts, at most.
        max_time: s of the solver, for each relaxed motion and each schedule.
        jobs: processes; 1 stays in this one; None: one for each processor.
        folder: where candidates are kept as they end; None keeps nothing.
        resume: whether candidates that are there are not tried again.
        told: called with each candidate as it ends.

    Raises:
        InputError: for a problem whose schedule cannot be found, and a folder that cannot be written.
    """
    if min(seeds, most) < 0 or seeds + known == 0 or most == 0 or max_time <= 0:
        raise InputError(
            "nothing is proposed or solved", "allowed: seeds or known ones, most >= 1, max_time > 0"
        )
    task = problem if isinstance(problem, ContactTask) else ContactTask.of(problem)
    records = Records(task, folder, resume=resume)
    done = {each.source for each in records.candidates}
    wanted = [seed for seed in range(seeds) if f"relaxed:{seed}" not in done]
    limit = BESIDE * max_time
    tried = _each(jobs, relaxed_proposal, [(task, seed, max_time) for seed in wanted], limit)
    relaxed = [
        value if isinstance(value, Proposal) else Proposal(source=f"relaxed:{wanted[k]}", why=str(value))
        for k, value in tried
    ]
    proposals = [
        *relaxed,
        *(each for each in (known_proposals(task) if known else ()) if each.source not in done),
    ]
    trials: list[Proposal] = []
    for proposal in sorted(proposals, key=_order):
        same = next((each.source for each in trials if _alike(each, proposal)), "")
        why = proposal.why or (same and f"the same modes as {same}")
        if not why and len(trials) >= most:
            why = f"{most} schedules that come before are tried"
        if why:
            told(records.add(_rejected(proposal, why)))
        else:
            trials.append(proposal)
    ended = _each(jobs, certified, [(task, each, max_time) for each in trials], limit)
    for index, candidate in ended:
        if not isinstance(candidate, Candidate):
            candidate = _rejected(trials[index], str(candidate))
        told(records.add(candidate))
    return Discovery(task=task, candidates=tuple(records.candidates))


def nearest_reached(
    make: Callable[[float], ContactTask], *, halvings: int = 3, **settings: Any
) -> tuple[float, Discovery] | None:
    """The largest part of the way to a goal for which a schedule is found, by bisection; None for none.

    Args:
        make: the task of a part of the way, 0 to 1, of which the whole has no schedule.
        halvings: parts that are tried.
        settings: of `discover`.
    """
    low, high, best = 0.0, 1.0, None
    for _ in range(halvings):
        part = (low + high) / 2
        try:
            discovery = discover(make(part), **settings)
        except InputError:
            discovery = None
        if discovery is not None and discovery.best:
            low, best = part, (part, discovery)
        else:
            high = part
    return best


def _order(proposal: Proposal) -> tuple[bool, float, str]:
    """Relaxed ones by what they cost, then those that are known."""
    return proposal.objective is None, proposal.objective or 0.0, proposal.source


def _alike(one: Proposal, other: Proposal) -> bool:
    """Whether two have the same contacts in the same order for about as long."""
    if one.modes is None or other.modes is None or one.modes.key != other.modes.key:
        return False
    apart = [abs(a - b) for (_, a), (_, b) in zip(one.modes.modes, other.modes.modes, strict=True)]
    return sum(apart) < ALIKE * one.modes.duration


def _rejected(proposal: Proposal, why: str) -> Candidate:
    return Candidate(
        source=proposal.source,
        modes=proposal.modes,
        status=REJECTED,
        relaxed_objective=proposal.objective,
        slack=proposal.slack,
        why=why,
        seconds=proposal.seconds,
    )


def certified(task: ContactTask, proposal: Proposal, max_time: float) -> Candidate:
    """Solve a proposal with hard contacts until its motion holds, without phases that shrink to nothing."""
    assert proposal.modes is not None
    assert proposal.motion is not None
    rejected = _rejected(proposal, "")
    try:
        solution = solve(task.with_modes(proposal.modes, proposal.motion), max_time=max_time)
    except InputError as error:
        return replace(rejected, why=f"{error}")
    seconds = proposal.seconds + _spent(solution)
    best, modes, vanished = solution, proposal.modes, 0
    fewer = without_vanished(proposal.modes, solution, task.periodic)
    if solution.success and fewer is not None:
        again = _again(task, fewer, solution, max_time)
        if again is not None:
            seconds += _spent(again)
            if again.success and _objective(again) <= _objective(solution) * (1 + 1e-3):
                best, modes, vanished = again, fewer, len(proposal.modes.modes) - len(fewer.modes)
    figures = best.statistics
    if not best.success:
        missed = f": {', '.join(figures.failures)}" if figures.failures else ""
        return replace(
            rejected, why=f"with hard contacts {figures.status.replace('_', ' ')}{missed}", seconds=seconds
        )
    return replace(
        rejected,
        status=CERTIFIED,
        modes=replace(modes, modes=tuple(zip(modes.key, best.phase_durations, strict=True))),
        objective=figures.objective,
        vanished=vanished,
        seconds=seconds,
        solution=best,
    )


def without_vanished(modes: ModeSequence, solution: Solution, periodic: bool) -> ModeSequence | None:
    """The modes without those that a motion has at their least duration; None where there is none."""
    durations = solution.phase_durations
    least = [AT_BOUND * FREE[0] * duration for _, duration in modes.modes]
    if len(durations) != len(least) or all(a > b for a, b in zip(durations, least, strict=True)):
        return None
    timed = [(key, 0.0 if a <= b else a) for key, a, b in zip(modes.key, durations, least, strict=True)]
    shortest = min((duration for _, duration in timed if duration), default=0.0)
    fewer = ModeSequence(tuple(timed), dropped=modes.dropped, unlifted=modes.unlifted)
    fewer = fewer.without_short(shortest / 2, periodic)
    return replace(fewer, dropped=modes.dropped) if shortest else None


def _again(task: ContactTask, modes: ModeSequence, solution: Solution, max_time: float) -> Solution | None:
    """The problem of fewer modes, solved from a solution; None where its cycle would begin elsewhere."""
    if task.periodic and modes.shift:
        return None
    try:
        return solve(task.with_modes(modes, geodesic_motion(solution, task.robot)), max_time=max_time)
    except InputError:
        return None


def _spent(solution: Solution) -> float:
    """Time of the solver in all rounds, s."""
    return float(total_effort([solution])["wall_time_s"])


def _objective(solution: Solution) -> float:
    value = solution.statistics.objective
    return np.inf if value is None else value


def _each(
    jobs: int | None, function: Callable[..., Any], arguments: Sequence[tuple[Any, ...]], limit: float
) -> Iterator[tuple[int, Any]]:
    """Index and value of each call as it ends; as text why its process was lost or took too long."""
    if jobs == 1 or len(arguments) < 2:
        for index, each in enumerate(arguments):
            yield index, function(*each)
        return
    with local_or(None, jobs) as cluster:
        waiting = deque(range(len(arguments)))

        def make(index: int) -> Task:
            return Task(name=str(index), limit=limit, function=function, args=arguments[index])

        for ended in run_tasks(waiting, make, cluster.executor, window=cluster.window, check=cluster.check):
            yield ended.key, ended.value if ended.kind == DONE else ended.detail
