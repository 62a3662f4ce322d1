"""A suite from its pairs to their outcomes: each solve and each simulation is a task, recorded as it ends."""

import contextlib
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from trajopt.motion.file import write_bytes
from trajopt.study.processes import REFUSED, TIME_LIMIT
from trajopt.study.records import JsonLines
from trajopt.study.solves import ERROR, TIME
from trajopt.study.suite.cases import Case
from trajopt.study.suite.outcome import Attempt, Outcome, Physics
from trajopt.study.suite.run import SuiteSettings, simulate_plan, solve_start
from trajopt.study.tasks import DONE, NOT_RUN, Ended, NotRunError, TimedCall, Workers

# Results of pairs that have ended, and events of the others.
FILE, EVENTS = "results.jsonl", "events.jsonl"
# Suffix of files with a simulated motion.
SIMULATED = "-simulated"
# After this many lost processes, a pair's remaining starts count as failed without being run.
MOST_LOST = 3
# Tasks of a pair other than the seeds of its perturbed starts.
OWN, PHYSICS = "own", "physics"


class SuiteRecords:
    """The results of one suite in a folder, or only in memory without one.

    versions: of the software. Results of other settings or versions do not belong to this suite. Raises
    InputError for a folder that cannot be written.
    """

    def __init__(self, folder: Path | None, settings: SuiteSettings, versions: Mapping[str, str]) -> None:
        self._head = {"settings": asdict(settings), "versions": dict(versions)}
        self.folder = folder
        self._results = JsonLines(None if folder is None else folder / FILE)
        self._events = JsonLines(None if folder is None else folder / EVENTS)

    def open(self, *, resume: bool) -> dict[str, Outcome]:
        """Create the folder; return earlier results by pair when resumed, otherwise start anew.

        A pair that ended with an error (bad input, a lost process) is run again.
        """
        entries = self._results.open(resume=resume)
        if not resume:
            self.close()
        known = {}
        for entry in filter(self._is_of_this_suite, entries):
            with contextlib.suppress(ValueError, KeyError, TypeError):  # invalid lines are skipped
                outcome = Outcome.from_dict(entry["outcome"])
                known[outcome.name] = outcome
        return {name: outcome for name, outcome in known.items() if not outcome.error}

    def unfinished(self) -> dict[str, Outcome]:
        """What is known of pairs that have not ended, by name; invalid lines are skipped."""
        outcomes: dict[str, Outcome] = {}
        for entry in filter(self._is_of_this_suite, self._events.read()):
            with contextlib.suppress(ValueError, KeyError, TypeError):
                name = entry["pair"]
                problem, _, robot = name.partition("@")
                known = outcomes.get(name, Outcome(problem=problem, robot=robot))
                outcomes[name] = known.with_event(entry["told"])
        return outcomes

    def add_event(self, pair: str, event: Mapping[str, Any]) -> None:
        """Append one event of a running pair."""
        self._events.append({**self._head, "pair": pair, "told": dict(event)})

    def add(self, outcome: Outcome) -> None:
        """Append one result."""
        self._results.append({**self._head, "outcome": outcome.to_dict()})

    def save(self, case: Case, content: bytes | None, *, simulated: bool) -> None:
        """Write the solution file of a pair; delete it if there is no content."""
        if self.folder is None:
            return
        name = f"{case.problem}@{Path(case.robot).stem}{SIMULATED if simulated else ''}.npz"
        if content is None:
            (self.folder / name).unlink(missing_ok=True)
        else:
            write_bytes(self.folder / name, content)

    def close(self) -> None:
        """Delete the events: the results of pairs that have ended contain them."""
        self._events.remove()

    def _is_of_this_suite(self, entry: Mapping[str, Any]) -> bool:
        return {key: entry.get(key) for key in self._head} == self._head


def run_suite(
    cases: Sequence[Case], settings: SuiteSettings, records: SuiteRecords, workers: Workers
) -> Iterator[Outcome]:
    """Yield the outcome of each pair as it ends; recorded parts of interrupted pairs are not run again."""
    begun = records.unfinished()
    pairs = {case: _PairRun(case, settings, records, begun.get(case.name)) for case in cases}
    yield from (pair.outcome for pair in pairs.values() if not pair.left)
    # In turns of robots: two pairs on one robot at a time would compile the same functions.
    turns = Counter[str]()
    order = []
    for case in cases:
        turns[case.robot] += 1
        order.append((turns[case.robot], case))
    waiting = deque(
        (case, part) for _, case in sorted(order, key=lambda one: one[0]) for part in pairs[case].first()
    )

    def make(key: tuple[Case, str | int]) -> TimedCall:
        return pairs[key[0]].task(key[1])

    for ended in workers.run(waiting, make):
        case, part = ended.key
        waiting.extendleft((case, other) for other in reversed(pairs[case].end(part, ended)))
        if not pairs[case].left:
            yield pairs[case].outcome


class _PairRun:
    """One pair: its ``outcome`` so far, and the parts ``left`` to run: `OWN`, `PHYSICS`, seeds of starts."""

    def __init__(
        self, case: Case, settings: SuiteSettings, records: SuiteRecords, begun: Outcome | None
    ) -> None:
        self._case, self._settings, self._records = case, settings, records
        self.outcome = begun or Outcome(problem=case.problem, robot=case.robot)
        known = {OWN: self.outcome.own, PHYSICS: self.outcome.physics}
        parts = [OWN, PHYSICS] if settings.simulate else [OWN]
        solved = all(known[part] is not None for part in parts)
        started = [start.seed for start in self.outcome.starts]
        seeds = [seed for seed in settings.seeds if seed not in started]
        self.left: list[str | int] = [*([] if solved else parts), *seeds]
        self._plan: bytes | None = None
        self._lost, self._reason = 0, ""

    def first(self) -> list[str | int]:
        """Parts to run first: the default guess, or all that are left if its result is known."""
        return [OWN] if OWN in self.left else self.left

    def task(self, part: str | int) -> TimedCall:
        """The task of a part. Raises `NotRunError` for one that is not started because of others."""
        case, settings = self._case, self._settings
        if self._reason:
            raise NotRunError(f"not run: {self._reason}")
        if part == PHYSICS:
            if self._plan is None:
                raise NotRunError("no motion to simulate")
            args = (self._plan, settings.controller)
            name = f"{case.name} simulating"
            return TimedCall(name=name, limit=settings.longest, function=simulate_plan, args=args)
        seed = None if part == OWN else part
        name = case.name if seed is None else f"{case.name} start {seed}"
        return TimedCall(name=name, limit=settings.longest, function=solve_start, args=(case, settings, seed))

    def end(self, part: str | int, ended: Ended[Any]) -> list[str | int]:
        """Take the outcome of a part; returns the parts that can run now."""
        self.left.remove(part)
        if ended.kind != DONE:
            self._fail(part, ended)
        else:
            result, content, seconds = ended.value
            kind = part if isinstance(part, str) else "start"
            event = {"event": kind, "values": asdict(result)}
            self._records.add_event(self._case.name, event)
            total = self.outcome.total_time + seconds
            self.outcome = replace(self.outcome.with_event(event), total_time=total)
            if kind != "start":
                self._records.save(self._case, content, simulated=kind == PHYSICS)
            if kind == OWN:
                self._plan = content if result.legged else None
        return list(self.left) if part == OWN else []

    def _fail(self, part: str | int, ended: Ended[Any]) -> None:
        text = f"bad input: {ended.detail}" if ended.kind == REFUSED else ended.detail
        mode = TIME if ended.kind == TIME_LIMIT else ERROR
        not_run = ended.kind == NOT_RUN
        self._lost += not not_run
        if part == PHYSICS:
            self.outcome = replace(self.outcome, physics=Physics(detail="" if not_run else f"lost: {text}"))
        elif part == OWN:
            self.outcome = replace(self.outcome, error=text, error_mode=mode)
        else:
            status = "not_run" if not_run else "lost"
            start = Attempt(seed=int(part), mode=mode, status=status, detail=text)
            self.outcome = self.outcome.with_start(start)
        if not not_run and (ended.kind == REFUSED or self._lost == MOST_LOST):
            self._reason = text
