"""From a task to schedules with hard contacts: propose, screen, certify, choose."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from trajopt.arguments import checked
from trajopt.discovery.proposals import Proposal, key_frames, known_proposals, relaxed_name, relaxed_proposal
from trajopt.discovery.records import REJECTED, SCREENED, UNTRIED, Candidate, Discovery, Records
from trajopt.discovery.relaxation import intervals_of
from trajopt.discovery.task import ContactTask
from trajopt.discovery.trials import ROUNDS, certified, screened, untried
from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.solvers.status import Status
from trajopt.solving.graded import MOST_ROUNDS
from trajopt.study.cluster import chosen_cluster
from trajopt.study.runner import DONE, TimedCall, run_tasks
from trajopt.study.workers.executor import processors
from trajopt.study.workers.task import end_unguarded_import

SEEDS, MOST, MAX_TIME, KEEP, EFFORT = 4, 12, 30.0, 3, 15.0
# Solves at a time on a cluster; known schedules and neighbours that are screened at a time.
AHEAD, AT_A_TIME = 4, 4
# A schedule beside the best is certified if on the coarse mesh it costs at most so much more, relative; one
# beside those that are kept if it costs so much less.
CLOSE, BETTER = 0.1, 0.02
# Durations that differ by less in all, over that of the motion, are the same schedule.
ALIKE = 0.2
# Beside the solver's limit of time: to build, to examine and to solve once more without phases that vanish.
BESIDE = 4.0
INFEASIBLE = Status.INFEASIBLE.word
# Index and value of each call as it ends; as text why its process was lost or took too long.
Run = Callable[[Callable[..., Any], Sequence[tuple[Any, ...]]], Iterator[tuple[int, Any]]]


@checked
def discover(
    problem: Problem | ContactTask,
    *,
    seeds: int = SEEDS,
    known: bool = True,
    keep: int = KEEP,
    most: int = MOST,
    effort: float = EFFORT,
    max_time: float = MAX_TIME,
    jobs: int | None = 1,
    scheduler: str | None = None,
    folder: Path | str | None = None,
    resume: bool = False,
    told: Callable[[Candidate], object] = id,
) -> Discovery:
    """Find schedules of contacts for a task, and motions with hard contacts that hold at any time.

    A relaxed motion comes first, then known schedules, more relaxed motions, and neighbours of the best
    schedule, as long as effort is left. All are solved on a coarse mesh, and those with the least objective
    there until their motion holds.

    Args:
        problem: whose phases are not used, or a task, as from `task_to`.
        seeds: relaxed motions, the first from legs that stand still, others from noise beside it.
        known: whether gaits, hops and steps that are known are proposed, too.
        keep: schedules about as good as the best that are certified, too, up to so many in all.
        most: schedules that are tried until their motion holds, at most.
        effort: of all solves, over that of the easiest schedule that is certified, on its first mesh, in
            iterations times variables: beyond it nothing is begun.
        max_time: s of the solver, for each relaxed motion and each schedule.
        jobs: processes; 1 stays in this one; None: one for each processor.
        scheduler: address of a running Dask scheduler, instead of processes here.
        folder: where candidates are kept as they end; None keeps nothing.
        resume: whether candidates that are there are not tried again.
        told: called with each candidate as it ends.

    Raises:
        InputError: for a problem whose schedule cannot be found, and a folder that cannot be written.
    """
    if min(seeds, most, keep) < 0 or seeds + known == 0 or 0 in (most, keep) or min(max_time, effort) <= 0:
        raise InputError(
            "nothing is proposed or solved",
            "allowed: seeds or known ones, most >= 1, keep >= 1, max_time > 0, effort > 0",
        )
    end_unguarded_import()
    task = problem if isinstance(problem, ContactTask) else ContactTask.of(problem)
    records = Records(task, folder, resume=resume)
    done = {each.source for each in records.candidates}
    with _workers(jobs, scheduler, BESIDE * max_time) as run:
        wave = AHEAD if scheduler is not None else processors() if jobs is None else jobs
        search = _ScheduleSearch(task, records, run, wave, keep, most, effort, max_time, told)
        seed = deque(each for each in range(seeds) if relaxed_name(each) not in done)
        search.tried(search.relaxed([seed.popleft()] if seed else []))
        names = search.in_turn(search.ordered(known), least=AT_A_TIME)
        while seed and search.has_effort(relaxed=True):
            search.tried(search.relaxed([seed.popleft() for _ in range(min(wave, len(seed)))]))
        if not search.best and intervals_of(task, fine=True) > intervals_of(task, fine=False):
            again = [each for each in range(seeds) if relaxed_name(each, fine=True) not in done]
            search.tried(search.relaxed(again, fine=True))
        search.improved()
        search.finished([*names, *(Proposal(source=relaxed_name(each)) for each in seed)])
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


@dataclass
class _ScheduleSearch:
    """Proposals that wait, the least objective on a coarse mesh first; all that were screened; attempts.

    given_up: what was not certified on the first meshes, with its proposal. relaxing: effort of the last
    relaxed motion.
    """

    task: ContactTask
    records: Records
    run: Run
    wave: int
    keep: int
    most: int
    effort: float
    max_time: float
    told: Callable[[Candidate], object]
    waiting: list[Proposal] = field(default_factory=list)
    screened: list[Proposal] = field(default_factory=list)
    given_up: list[tuple[Proposal, Candidate]] = field(default_factory=list)
    attempts: int = 0
    relaxing: float = 0.0

    @property
    def best(self) -> tuple[Candidate, ...]:
        return Discovery(task=self.task, candidates=tuple(self.records.candidates)).best

    @property
    def spent(self) -> float:
        ended = [*self.records.candidates, *(each for _, each in self.given_up)]
        return sum(each.effort for each in ended) + sum(each.effort for each in self.waiting)

    def has_effort(self, *, relaxed: bool = False) -> bool:
        """Whether effort is left; for relaxed motions as much as the last ones took."""
        first = (each.solution.statistics.rounds[0] for each in self.best if each.solution)
        easiest = min((each.iterations * each.variables for each in first), default=math.inf)
        return self.spent + (self.relaxing if relaxed else 0.0) <= self.effort * easiest

    def relaxed(self, seeds: Sequence[int], fine: bool = False) -> Iterator[Proposal]:
        """Proposals of relaxed motions."""
        arguments = [(self.task, seed, self.max_time, fine) for seed in seeds]
        for k, value in self.run(relaxed_proposal, arguments):
            proposal = value
            if not isinstance(value, Proposal):
                proposal = Proposal(source=relaxed_name(seeds[k], fine), why=str(value))
            self.relaxing = proposal.effort
            yield proposal

    def ordered(self, known: bool) -> list[Proposal]:
        """Known proposals: of cycles the most like the relaxed motion first, else the fewest phases first."""
        found = next((each.modes for each in self.screened if each.modes), None)

        def place(proposal: Proposal) -> tuple[float, int]:
            modes = proposal.modes
            if modes is None:
                return 0.0, 0
            return found.apart(modes) if found and self.task.periodic else 0.0, len(modes.modes)

        return sorted(known_proposals(self.task), key=place) if known else []

    def tried(self, proposals: Iterable[Proposal]) -> None:
        """Screen proposals, and certify the best of all that wait."""
        proposals = [*proposals]
        new: list[Proposal] = []
        for each in proposals:
            same = next((other.source for other in (*self.screened, *new) if _alike(other, each)), "")
            why = each.why or (same and f"the same modes as {same}")
            if why:
                self._tell(untried(each, why, REJECTED))
            else:
                new.append(each)
        for k, value in self.run(screened, [(self.task, each, self.max_time) for each in new]):
            new[k] = value if isinstance(value, Proposal) else replace(new[k], why=str(value))
        for each in new:
            if each.why:
                self._tell(untried(each, each.why, REJECTED))
            else:
                self.waiting.append(each)
                self.screened.append(each)
        self.waiting.sort(key=_promise)
        while chosen := self._chosen():
            self._certify(chosen, ROUNDS)

    def _chosen(self) -> list[Proposal]:
        """Those that are certified next, as many as there are processes.

        Those about as good as the best while effort is left and until enough are certified, better ones
        always.
        """
        best, chosen = self.best, list[Proposal]()
        reference = min((each.screened or each.objective or 0.0 for each in best), default=math.inf)
        failed = {each.modes and each.modes.key for each, _ in self.given_up} if best else set()
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

    def _certify(self, proposals: Sequence[Proposal], rounds: int) -> None:
        arguments = [(self.task, each, self.max_time, rounds) for each in proposals]
        for k, value in self.run(certified, arguments):
            proposal = proposals[k]
            candidate = value if isinstance(value, Candidate) else untried(proposal, str(value), REJECTED)
            hopeless = INFEASIBLE in candidate.why
            if candidate.objective is None and rounds == ROUNDS and not hopeless:
                self.given_up.append((proposal, candidate))
                continue
            self._tell(candidate)

    def improved(self) -> None:
        """Try neighbours of the best schedule until none is better or the effort is used."""
        keep, self.keep, best = self.keep, 1, None
        while self.best and self.best[0] is not best:
            best = self.best[0]
            assert best.modes is not None
            assert best.solution is not None
            motion = key_frames(self.task, best.solution)
            self.in_turn(
                Proposal(source=f"{best.source}:{name}", modes=modes, motion=motion)
                for name, modes in best.modes.neighbours(self.task.periodic)
                if not (self.task.periodic and modes.shift != best.modes.shift)
            )
        self.keep = keep

    def in_turn(self, proposals: Iterable[Proposal], least: int = 0) -> list[Proposal]:
        """Try proposals that are not on record, some at a time; those for which no effort was left.

        ``least`` of them are tried in any case.
        """
        done = {each.source for each in self.records.candidates}
        left = [each for each in proposals if each.source not in done]
        while left and (least > 0 or self.has_effort()):
            self.tried(left[:AT_A_TIME])
            left, least = left[AT_A_TIME:], least - AT_A_TIME
        return left

    def finished(self, unsolved: Iterable[Proposal]) -> None:
        """Take up what was given up where nothing is certified, and tell of all that was not tried."""
        self.given_up.sort(key=lambda pair: _promise(pair[0]))
        for _ in range(self.keep):
            if self.best or not self.given_up:
                break
            proposal, first = self.given_up.pop(0)
            more = replace(proposal, seconds=first.seconds, effort=first.effort)
            self._certify([more], MOST_ROUNDS)
        for _, candidate in self.given_up:
            self._tell(candidate)
        for each in self.waiting:
            told = "not solved" if each.screened is None else f"objective {each.screened:.5g}"
            self._tell(untried(each, f"on a coarse mesh {told}", SCREENED))
        for each in unsolved:
            self._tell(untried(each, each.why or "the effort was used", UNTRIED))

    def _tell(self, candidate: Candidate) -> None:
        self.told(self.records.add(candidate))


def _promise(proposal: Proposal) -> tuple[float, str]:
    """The least objective on a coarse mesh first; those that were not solved there last."""
    return math.inf if proposal.screened is None else proposal.screened, proposal.source


def _alike(one: Proposal, other: Proposal) -> bool:
    """Whether two have the same contacts in the same order for about as long."""
    if one.modes is None or other.modes is None or one.modes.key != other.modes.key:
        return False
    apart = [abs(a - b) for (_, a), (_, b) in zip(one.modes.modes, other.modes.modes, strict=True)]
    return sum(apart) < ALIKE * one.modes.duration


@contextmanager
def _workers(jobs: int | None, scheduler: str | None, limit: float) -> Iterator[Run]:
    """Where calls run: in this process, in others, or on a Dask cluster, with a limit of time in s."""

    def here(function: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, Any]]:
        return ((index, function(*each)) for index, each in enumerate(arguments))

    if jobs == 1 and scheduler is None:
        yield here
        return
    with chosen_cluster(scheduler, jobs) as cluster:

        def run(
            function: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]
        ) -> Iterator[tuple[int, Any]]:
            def make(index: int) -> TimedCall:
                return TimedCall(name=str(index), limit=limit, function=function, args=arguments[index])

            waiting = deque(range(len(arguments)))
            for ended in run_tasks(
                waiting, make, cluster.executor, window=cluster.window, check=cluster.check
            ):
                yield ended.key, ended.value if ended.kind == DONE else ended.detail

        yield run
