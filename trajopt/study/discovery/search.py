"""The search from a task to schedules with hard contacts: propose, screen, certify, choose."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from trajopt.arguments import checked
from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.solvers.status import Status
from trajopt.solving.graded import MOST_ROUNDS
from trajopt.study.discovery.proposals import key_frames, known_proposals, relaxed_name, relaxed_proposal
from trajopt.study.discovery.records import (
    REJECTED,
    SCREENED,
    UNTRIED,
    Candidate,
    Discovery,
    DiscoveryRecords,
)
from trajopt.study.discovery.relaxation import intervals_of
from trajopt.study.discovery.task import ContactTask
from trajopt.study.discovery.trials import ROUNDS, certified, screened
from trajopt.study.processes import end_unguarded_import, processors
from trajopt.study.tasks import DONE, TimedCall, open_workers

# Concurrent solves on a cluster.
CLUSTER_SOLVES = 4
# Known schedules and neighbours screened per batch.
BATCH_SIZE = 4
# Relative differences in objective on the coarse mesh: schedules up to CLOSE above the best are certified
# too; once enough are certified, only those at least BETTER below it.
CLOSE, BETTER = 0.1, 0.02
# Schedules whose durations differ in total by less than this fraction of the motion's are the same.
ALIKE = 0.2
# Time limit of a call over the solver's: it covers building, checking, and a solve without vanished phases.
TIME_FACTOR = 4.0
INFEASIBLE = Status.INFEASIBLE.word
# Yields index and value of each call as it ends; a text as value says why it was lost or too slow.
Run = Callable[[Callable[..., Any], Sequence[tuple[Any, ...]]], Iterator[tuple[int, Any]]]


@checked
def discover(
    problem: Problem | ContactTask,
    *,
    seeds: int = 4,
    known: bool = True,
    keep: int = 3,
    most: int = 12,
    effort: float = 15.0,
    max_time: float = 30.0,
    jobs: int | None = 1,
    scheduler: str | None = None,
    folder: Path | str | None = None,
    resume: bool = False,
    on_candidate: Callable[[Candidate], object] | None = None,
) -> Discovery:
    """Find contact schedules for a task, and motions with hard contacts that hold at any time.

    A relaxed motion comes first, then known schedules, further relaxed motions, and neighbours of the best
    schedule, while effort remains. All are screened on a coarse mesh; those with the lowest objective there
    are solved until their motion has the grade.

    Args:
        problem: a problem, whose phases are ignored, or a task, such as from `task_to`.
        seeds: number of relaxed motions; the first starts from still legs, the others from noise around them.
        known: whether to propose known gaits, hops and steps as well.
        keep: schedules about as good as the best are certified too, up to this number in all.
        most: largest number of schedules to try to certify.
        effort: limit on all solves, in iterations times variables, over those of the easiest certified
            schedule on its first mesh: beyond it nothing new is started.
        max_time: solver time for each relaxed motion and each schedule, s.
        jobs: number of processes; 1 runs in this one, None uses one per processor.
        scheduler: address of a running Dask scheduler to use instead of local processes.
        folder: where to store candidates as they finish; None stores nothing.
        resume: whether to keep the candidates in the folder and try only others.
        on_candidate: called with each candidate as it finishes.

    Raises:
        InputError: for a problem whose schedule cannot be found, or a folder that cannot be written.
    """
    if min(seeds, most, keep) < 0 or seeds + known == 0 or 0 in (most, keep) or min(max_time, effort) <= 0:
        raise InputError(
            "nothing is proposed or solved",
            "allowed: seeds or known ones, most >= 1, keep >= 1, max_time > 0, effort > 0",
        )
    end_unguarded_import()
    task = problem if isinstance(problem, ContactTask) else ContactTask.of(problem)
    records = DiscoveryRecords(task, folder, resume=resume)
    done = {each.source for each in records.candidates}
    with _open_runner(jobs, scheduler, TIME_FACTOR * max_time) as run:
        wave = CLUSTER_SOLVES if scheduler is not None else processors() if jobs is None else jobs
        search = _ScheduleSearch(task, records, run, wave, keep, most, effort, max_time, on_candidate)
        seed = deque(each for each in range(seeds) if relaxed_name(each) not in done)
        search.tried(search.relaxed([seed.popleft()] if seed else []))
        names = search.in_turn(search.ordered(known), least=BATCH_SIZE)
        while seed and search.has_effort(relaxed=True):
            search.tried(search.relaxed([seed.popleft() for _ in range(min(wave, len(seed)))]))
        if not search.best and intervals_of(task, fine=True) > intervals_of(task, fine=False):
            again = [each for each in range(seeds) if relaxed_name(each, fine=True) not in done]
            search.tried(search.relaxed(again, fine=True))
        search.improved()
        search.finished([*names, *(Candidate(source=relaxed_name(each)) for each in seed)])
    return Discovery(task=task, candidates=tuple(records.candidates))


def nearest_reached(
    make: Callable[[float], ContactTask], *, halvings: int = 3, **settings: Any
) -> tuple[float, Discovery] | None:
    """Find by bisection the largest fraction of the way to a goal that has a schedule; None if none has.

    Args:
        make: returns the task for a fraction of the way, 0 to 1; the whole way has no schedule.
        halvings: number of fractions to try.
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


@dataclass
class _ScheduleSearch:
    """State of a search.

    Args:
        waiting: proposals that wait for certification, lowest objective on a coarse mesh first.
        screened: all proposals that were screened.
        given_up: proposals that were not certified on the first meshes.
        attempts: number of certifications.
        relaxing: effort of the last relaxed motion.
    """

    task: ContactTask
    records: DiscoveryRecords
    run: Run
    wave: int
    keep: int
    most: int
    effort: float
    max_time: float
    on_candidate: Callable[[Candidate], object] | None
    waiting: list[Candidate] = field(default_factory=list)
    screened: list[Candidate] = field(default_factory=list)
    given_up: list[Candidate] = field(default_factory=list)
    attempts: int = 0
    relaxing: float = 0.0

    @property
    def best(self) -> tuple[Candidate, ...]:
        return Discovery(task=self.task, candidates=tuple(self.records.candidates)).best

    @property
    def spent(self) -> float:
        return sum(each.effort for each in (*self.records.candidates, *self.given_up, *self.waiting))

    def has_effort(self, *, relaxed: bool = False) -> bool:
        """Whether effort is left; for relaxed motions, as much as the last one took."""
        first = (each.solution.statistics.rounds[0] for each in self.best if each.solution)
        easiest = min((each.iterations * each.variables for each in first), default=math.inf)
        return self.spent + (self.relaxing if relaxed else 0.0) <= self.effort * easiest

    def relaxed(self, seeds: Sequence[int], fine: bool = False) -> Iterator[Candidate]:
        """Yield the proposals of relaxed motions."""
        arguments = [(self.task, seed, self.max_time, fine) for seed in seeds]
        for k, value in self.run(relaxed_proposal, arguments):
            failed = Candidate(source=relaxed_name(seeds[k], fine), why=str(value))
            proposal = value if isinstance(value, Candidate) else failed
            self.relaxing = proposal.effort
            yield proposal

    def ordered(self, known: bool) -> list[Candidate]:
        """Known proposals: of a cycle, most like the relaxed motion first, else fewest phases first."""
        found = next((each.modes for each in self.screened if each.modes), None)

        def place(proposal: Candidate) -> tuple[float, int]:
            modes = proposal.modes
            if modes is None:
                return 0.0, 0
            return found.apart(modes) if found and self.task.periodic else 0.0, len(modes.modes)

        return sorted(known_proposals(self.task), key=place) if known else []

    def tried(self, proposals: Iterable[Candidate]) -> None:
        """Screen proposals, then certify the best of all that wait."""
        proposals = [*proposals]
        new: list[Candidate] = []
        for each in proposals:
            same = next((other.source for other in (*self.screened, *new) if _alike(other, each)), "")
            why = each.why or (same and f"the same modes as {same}")
            if why:
                self._add(each, REJECTED, why)
            else:
                new.append(each)
        for k, value in self.run(screened, [(self.task, each, self.max_time) for each in new]):
            new[k] = value if isinstance(value, Candidate) else replace(new[k], why=str(value))
        for each in new:
            if each.why:
                self._add(each, REJECTED, each.why)
            else:
                self.waiting.append(each)
                self.screened.append(each)
        self.waiting.sort(key=_promise)
        while chosen := self._chosen():
            self._certify(chosen, ROUNDS)

    def _chosen(self) -> list[Candidate]:
        """Candidates to certify next, at most one per process.

        Those about as good as the best, while effort is left and until enough are certified; better ones
        always.
        """
        best, chosen = self.best, list[Candidate]()
        reference = min((each.screened or each.objective or 0.0 for each in best), default=math.inf)
        failed = {each.modes and each.modes.key for each in self.given_up} if best else set()
        for proposal in [*self.waiting]:
            enough = len(best) + len(chosen) >= self.keep or not self.has_effort()
            limit = reference * (1 - BETTER if enough else 1 + CLOSE)
            if len(chosen) == self.wave or self.attempts >= self.most:
                break
            if best and _promise(proposal)[0] > limit:
                break
            if proposal.modes and proposal.modes.key not in failed:
                chosen.append(proposal)
                self.waiting.remove(proposal)
                self.attempts += 1
        return chosen

    def _certify(self, proposals: Sequence[Candidate], rounds: int) -> None:
        arguments = [(self.task, each, self.max_time, rounds) for each in proposals]
        for k, value in self.run(certified, arguments):
            lost = replace(proposals[k], status=REJECTED, why=str(value))
            candidate = value if isinstance(value, Candidate) else lost
            hopeless = INFEASIBLE in candidate.why
            if candidate.objective is None and rounds == ROUNDS and not hopeless:
                self.given_up.append(candidate)
            else:
                self._add(candidate)

    def improved(self) -> None:
        """Try neighbours of the best schedule until none is better or the effort is used up."""
        keep, self.keep, best = self.keep, 1, None
        while self.best and self.best[0] is not best:
            best = self.best[0]
            assert best.modes is not None
            assert best.solution is not None
            motion = key_frames(self.task, best.solution)
            self.in_turn(
                Candidate(source=f"{best.source}:{name}", modes=modes, motion=motion)
                for name, modes in best.modes.neighbours(self.task.periodic)
                if not (self.task.periodic and modes.shift != best.modes.shift)
            )
        self.keep = keep

    def in_turn(self, proposals: Iterable[Candidate], least: int = 0) -> list[Candidate]:
        """Try proposals that are not on record, in batches; returns those for which no effort was left.

        At least ``least`` of them are tried.
        """
        done = {each.source for each in self.records.candidates}
        left = [each for each in proposals if each.source not in done]
        while left and (least > 0 or self.has_effort()):
            self.tried(left[:BATCH_SIZE])
            left, least = left[BATCH_SIZE:], least - BATCH_SIZE
        return left

    def finished(self, unsolved: Iterable[Candidate]) -> None:
        """If nothing is certified, retry what was given up; then report everything that was not tried."""
        self.given_up.sort(key=_promise)
        for _ in range(self.keep):
            if self.best or not self.given_up:
                break
            self._certify([self.given_up.pop(0)], MOST_ROUNDS)
        for each in self.given_up:
            self._add(each)
        for each in self.waiting:
            result = "not solved" if each.screened is None else f"objective {each.screened:.5g}"
            self._add(each, SCREENED, f"on a coarse mesh {result}")
        for each in unsolved:
            self._add(each, UNTRIED, each.why or "the effort was used")

    def _add(self, candidate: Candidate, status: str = "", why: str = "") -> None:
        """Record a candidate that has ended, with its status and reason unless it has them."""
        ended = replace(candidate, status=status, why=why) if status else candidate
        self.records.add(ended)
        if self.on_candidate is not None:
            self.on_candidate(ended)


def _promise(proposal: Candidate) -> tuple[float, str]:
    """Sort key: lowest objective on a coarse mesh first, unsolved proposals last."""
    return math.inf if proposal.screened is None else proposal.screened, proposal.source


def _alike(one: Candidate, other: Candidate) -> bool:
    """Whether two proposals have the same contact sequence with similar durations."""
    if one.modes is None or other.modes is None or one.modes.key != other.modes.key:
        return False
    apart = [abs(a - b) for (_, a), (_, b) in zip(one.modes.modes, other.modes.modes, strict=True)]
    return sum(apart) < ALIKE * one.modes.duration


@contextmanager
def _open_runner(jobs: int | None, scheduler: str | None, limit: float) -> Iterator[Run]:
    """Provide a function that runs calls here, or in other processes or on Dask with a time limit in s."""
    if jobs == 1 and scheduler is None:
        yield lambda function, arguments: ((k, function(*each)) for k, each in enumerate(arguments))
        return
    with open_workers(scheduler=scheduler, jobs=None if jobs == 1 else jobs) as workers:

        def run(
            function: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]
        ) -> Iterator[tuple[int, Any]]:
            def make(k: int) -> TimedCall:
                return TimedCall(name=str(k), limit=limit, function=function, args=arguments[k])

            for ended in workers.run(deque(range(len(arguments))), make):
                yield ended.key, ended.value if ended.kind == DONE else ended.detail

        yield run
