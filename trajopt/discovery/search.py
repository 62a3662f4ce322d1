"""From a task to schedules with hard contacts: propose, certify, choose."""

from __future__ import annotations

import json
import re
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.arguments import checked
from trajopt.discovery.modes import ModeSequence
from trajopt.discovery.proposals import Proposal, known_proposals, relaxed_proposal
from trajopt.discovery.task import FREE, ContactTask
from trajopt.errors import InputError, expanded
from trajopt.problem.problem import Problem
from trajopt.schedule.gaits import Gait, gait_names, gait_of
from trajopt.solution.output import replacing
from trajopt.solution.solution import Solution
from trajopt.solving.graded import solve
from trajopt.study.cluster import local_or
from trajopt.study.runner import DONE, Task, run_tasks

SEEDS, MOST, MAX_TIME = 4, 12, 30.0
RECORD = "discovery.json"
# Durations that differ by less in all, over that of the motion, are the same schedule.
ALIKE = 0.2
# A phase at its least duration is meant to vanish; relative to the bound.
AT_BOUND = 1.02
# Beside the solver's limit of time: to build, to examine and to solve once more without phases that vanish.
BESIDE = 4.0
CERTIFIED, REJECTED = "certified", "rejected"


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """A schedule that was tried: where it is from, what rounding changed, and what became of it.

    relaxed_objective, slack: of the motion it was read from. dropped, unlifted: modes too short for the mesh
    and swings that were none, left out by rounding. vanished: phases that shrank to nothing and were taken
    out. objective: with hard contacts. why: it was rejected. seconds: of solvers. solution: if certified.
    """

    source: str
    modes: ModeSequence | None
    status: str
    relaxed_objective: float | None = None
    slack: float | None = None
    vanished: int = 0
    objective: float | None = None
    why: str = ""
    seconds: float = 0.0
    solution: Solution | None = field(default=None, repr=False)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able, without the solution."""
        modes = self.modes
        told = {name: value for name, value in vars(self).items() if name not in ("solution", "modes")}
        return told | {
            "modes": modes and [[list(contacts), duration] for contacts, duration in modes.modes],
            "dropped": modes and modes.dropped,
            "unlifted": modes and modes.unlifted,
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class Discovery:
    """All candidates of a task, in the order in which they ended; seconds of solvers in all."""

    task: ContactTask
    candidates: tuple[Candidate, ...]

    @property
    def best(self) -> tuple[Candidate, ...]:
        """Those that are certified, the least objective first."""
        certified = [each for each in self.candidates if each.status == CERTIFIED]
        return tuple(sorted(certified, key=lambda each: each.objective or 0.0))

    @property
    def seconds(self) -> float:
        """Of solvers, in all."""
        return sum(each.seconds for each in self.candidates)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able: the task, and every candidate."""
        return {
            "task": self.task.describe(),
            "left_out": list(self.task.left_out),
            "candidates": [each.to_dict() for each in self.candidates],
        }


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
    records = _Records(task, folder, resume)
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
            found = discover(make(part), **settings)
        except InputError:
            found = None
        if found is not None and found.best:
            low, best = part, (part, found)
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
    rejected = _rejected(proposal, "")
    try:
        problem = task.with_modes(proposal.modes, proposal.guess(task))
        solution = solve(problem, max_time=max_time)
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
        modes=replace(modes, modes=tuple(zip(modes.key, durations_of(best), strict=True))),
        objective=figures.objective,
        vanished=vanished,
        seconds=seconds,
        solution=best,
    )


def durations_of(solution: Solution) -> list[float]:
    """Durations of the phases, s."""
    ends = [
        float(solution.interval_t[solution.intervals_of(k).stop - 1, 1])
        for k in range(len(solution.phase_names))
    ]
    return np.diff([float(solution.t[0]), *ends]).tolist()


def without_vanished(modes: ModeSequence, solution: Solution, periodic: bool) -> ModeSequence | None:
    """The modes without those that a motion has at their least duration; None where there is none."""
    found = durations_of(solution)
    least = [AT_BOUND * FREE[0] * duration for _, duration in modes.modes]
    if len(found) != len(least) or all(a > b for a, b in zip(found, least, strict=True)):
        return None
    timed = [(key, 0.0 if a <= b else a) for key, a, b in zip(modes.key, found, least, strict=True)]
    shortest = min((duration for _, duration in timed if duration), default=0.0)
    fewer = ModeSequence(tuple(timed), dropped=modes.dropped, unlifted=modes.unlifted)
    fewer = fewer.without_short(shortest / 2, periodic)
    return replace(fewer, dropped=modes.dropped) if shortest else None


def _again(task: ContactTask, modes: ModeSequence, solution: Solution, max_time: float) -> Solution | None:
    times = solution.t[np.concatenate([[True], np.diff(solution.t) > 0])]
    moved = modes.shift if task.periodic else 0.0
    if moved:
        return None  # the cycle would begin elsewhere
    before = Proposal(source="", modes=modes, times=times, q=solution.sample(times=times).q)
    try:
        return solve(task.with_modes(modes, before.guess(task)), max_time=max_time)
    except InputError:
        return None


def _spent(solution: Solution) -> float:
    return sum(each.wall_time_s for each in solution.statistics.rounds)


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


class _Records:
    """Candidates as they end, in a folder where there is one: a file of all, and each certified motion."""

    def __init__(self, task: ContactTask, folder: Path | str | None, resume: bool) -> None:
        self.task, self.candidates = task, list[Candidate]()
        self.folder = None if folder is None else expanded(folder)
        if self.folder is None:
            return
        if self.folder.exists() and not self.folder.is_dir():
            raise InputError(f"{self.folder} is not a folder", "allowed: a folder, or a new one")
        self.folder.mkdir(parents=True, exist_ok=True)
        if resume and (self.folder / RECORD).exists():
            self.candidates = [self._read(each) for each in self._content()["candidates"]]

    def _content(self) -> dict[str, Any]:
        assert self.folder is not None
        try:
            content = json.loads((self.folder / RECORD).read_text())
            content["candidates"]
        except (ValueError, KeyError, TypeError):
            raise InputError(
                f"{self.folder / RECORD} is no record of a discovery", "allowed: without --resume"
            ) from None
        if content.get("task") != self.task.describe():
            raise InputError(
                f"{self.folder} has candidates of another task, or of other values",
                "allowed: without --resume",
            )
        return dict(content)

    def _read(self, told: dict[str, Any]) -> Candidate:
        modes = told.pop("modes")
        counts = {name: told.pop(name) or 0 for name in ("dropped", "unlifted")}
        read = modes and ModeSequence(tuple((tuple(names), float(time)) for names, time in modes), **counts)
        file = self._file(told["source"])
        solution = Solution.load(file) if told["status"] == CERTIFIED else None
        return Candidate(**told, modes=read, solution=solution)

    def _file(self, source: str) -> Path:
        assert self.folder is not None
        return self.folder / f"{re.sub(r'[^A-Za-z0-9]+', '-', source)}.npz"

    def add(self, candidate: Candidate) -> Candidate:
        """Keep a candidate; its file is complete before the record names it."""
        self.candidates.append(candidate)
        if self.folder is not None:
            if candidate.solution is not None:
                candidate.solution.save(self._file(candidate.source))
            content = Discovery(task=self.task, candidates=tuple(self.candidates)).to_dict()
            with replacing(self.folder / RECORD) as path:
                path.write_text(json.dumps(content, indent=1))
        return candidate


def schedule_source(modes: ModeSequence) -> str:
    """The schedule as Python that a problem can use."""
    lines = ["from trajopt.schedule import Phase, Schedule", "", "SCHEDULE = Schedule(", "    ("]
    for name, (contacts, duration) in zip(modes.names(), modes.modes, strict=True):
        lines.append(f"        Phase(name={name!r}, duration={duration:.6g}, contacts={contacts!r}),")
    return "\n".join([*lines, "    )", ")", ""])


def nearest_gait(task: ContactTask, modes: ModeSequence) -> tuple[str, float] | None:
    """The known gait whose touchdowns and duty factors are nearest, and how far, as part of a period."""
    try:
        names = gait_names(task.robot)
    except InputError:
        return None
    found = _as_gait(modes)
    if found is None or not task.periodic:
        return None
    away = {name: _apart(found, gait_of(task.robot, name)) for name in names}
    best = min(away, key=lambda name: away[name])
    return best, away[best]


def _as_gait(modes: ModeSequence) -> Gait | None:
    """Duty factors and touchdowns of a cycle in which every foot steps once; else None."""
    feet = {name for contacts in modes.key for name in contacts}
    begins = np.concatenate([[0.0], np.cumsum([duration for _, duration in modes.modes])]) / modes.duration
    duty, offsets = {}, {}
    for foot in sorted(feet):
        on = [foot in contacts for contacts in modes.key]
        lands = [i for i in range(len(on)) if on[i] and not on[i - 1]]
        if len(lands) != 1:
            return None
        offsets[foot] = float(begins[lands[0]])
        duty[foot] = sum(d for (c, d) in modes.modes if foot in c) / modes.duration
    return Gait(name="found", duty=duty, offsets=offsets) if feet else None


def _apart(one: Gait, other: Gait) -> float:
    """Mean difference of touchdowns, at the best shift in time, and of duty factors."""
    feet = [foot for foot in other.feet if foot in one.feet]
    if len(feet) < len(other.feet):
        return 1.0
    lags = np.array([one.offsets[foot] - other.offsets[foot] for foot in feet])
    apart = min(np.abs((lags - lag + 0.5) % 1.0 - 0.5).mean() for lag in lags)
    return float(apart + np.mean([abs(one.duty_of(foot) - other.duty_of(foot)) for foot in feet]) / 2)
