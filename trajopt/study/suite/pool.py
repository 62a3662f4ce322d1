"""All pairs, each in a separate process, as many at a time as there are processors.

A process that crashes, hangs or runs out of memory loses at most its current solve: the events it sent are
kept, and the remaining perturbed starts go on in a new process.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from trajopt.problem.catalogue import problem_modules
from trajopt.study.suite.cases import Case
from trajopt.study.suite.failure import ERROR, TIME
from trajopt.study.suite.outcome import Attempt, Ledger, Outcome
from trajopt.study.suite.physics import Physics
from trajopt.study.suite.records import SuiteRecords
from trajopt.study.suite.run import Event, run_case
from trajopt.study.suite.settings import SuiteSettings
from trajopt.study.workers.display import TaskDisplay
from trajopt.study.workers.executor import ProcessPerTaskExecutor
from trajopt.study.workers.running import RunningTasks
from trajopt.study.workers.task import RefusedTaskError, TaskError, TaskTimeoutError

# Seconds that a stage may take before its process is ended. A solve: see `run_case`.
LIMITS = {"build": 300.0, "physics": 300.0}
# After this many lost processes, the rest of a pair's starts count as failed without being run.
MOST_LOST = 3
STAGES = {
    "build": "building",
    "own": "default guess",
    "physics": "simulating",
    "start": "start",
}


def run_all(
    cases: Sequence[Case],
    settings: SuiteSettings,
    *,
    jobs: int,
    records: SuiteRecords,
    display: TaskDisplay,
    limits: Mapping[str, float] = LIMITS,
    check: Callable[[], object] = bool,
) -> Generator[Outcome, None, None]:
    """Yield the outcome of each pair as it ends. Closing the iterator ends all processes.

    records: recorded parts of interrupted pairs are not run again; events are added as they come.
    limits: seconds by stage, see `LIMITS`. check: called several times a second; an exception from it ends
    the run.
    """
    known = records.unfinished()
    pairs = {case.name: _CaseRun(case, settings, known.get(case.name, ())) for case in _interleaved(cases)}

    def hear(told: tuple[str, Event]) -> None:
        name, event = told
        records.told(name, event)
        pairs[name].add(event)
        _show(display, name, event, 1 + settings.perturbed)

    preload = (*problem_modules(), "trajopt.study.suite.run")
    with ProcessPerTaskExecutor(jobs, preload=preload, on_event=hear) as executor:
        running = RunningTasks[_CaseRun](executor, check)
        waiting = list(pairs.values())
        while waiting or running:
            for pair in waiting:
                if pair.is_done:
                    yield pair.outcome()
                else:
                    running.submit(pair, run_case, *pair.task(limits, records.folder))
            ended = running.ended()
            waiting = [pair for pair, _ in ended]
            for pair, future in ended:
                pair.end(future.exception())


def _interleaved(cases: Sequence[Case]) -> list[Case]:
    """The cases, alternating between robots: two on one robot at a time would compile the same functions."""
    turns: Counter[str] = Counter()

    def turn(case: Case) -> int:
        turns[case.robot] += 1
        return turns[case.robot]

    return sorted(cases, key=turn)


def _show(display: TaskDisplay, name: str, event: Event, solves: int) -> None:
    """Show an event of a pair's process."""
    kind = event["event"]
    if kind == "stage":
        seed = event.get("seed")
        state = STAGES[event["stage"]] + ("" if seed is None else f" {seed}")
        display.show(name, state, steps=solves)
    elif kind == "iteration":
        display.show(name, f"iteration {event['iteration']}")
    elif kind in ("own", "start"):
        display.show(name, "", advance=1)


class _CaseRun:
    """One pair and its processes: results so far, and what is left to run."""

    def __init__(self, case: Case, settings: SuiteSettings, known: Iterable[Mapping[str, Any]]) -> None:
        self._settings, self._ledger = settings, Ledger(case)
        for event in known:
            self._ledger.add(event)
        needed = {"own", "physics"} if settings.simulate else {"own"}
        self._own = not needed <= self._ledger.found.keys()
        self._stage: str = "build"
        self._seed: int | None = None
        self._begin: float | None = None
        self._lost, self._seconds = 0, 0.0

    @property
    def is_done(self) -> bool:
        return not (self._own or self._seeds)

    @property
    def _seeds(self) -> list[int]:
        """Perturbed starts that are left."""
        return [seed for seed in self._settings.seeds if seed not in self._ledger.starts]

    def task(self, limits: Mapping[str, float], folder: Path | None) -> tuple[Any, ...]:
        """The arguments of `run_case` for what is left."""
        self._stage, self._seed, self._begin = "build", None, None
        place = None if folder is None else folder.resolve()
        return self._ledger.case, self._settings, dict(limits), self._own, self._seeds, place

    def add(self, event: Mapping[str, Any]) -> None:
        """Take an event of its process."""
        self._begin = self._begin or time.perf_counter()
        if event["event"] == "stage":
            self._stage, self._seed = event["stage"], event.get("seed")
        self._ledger.add(event)

    def end(self, error: BaseException | None) -> None:
        """Its process has ended, with an error if it was lost; raises errors that are not a task's."""
        now = time.perf_counter()
        self._seconds += now - (self._begin or now)
        self._own = False
        if error is None:
            return
        if not isinstance(error, TaskError):
            raise error
        self._lost += 1
        text = f"bad input: {error}" if isinstance(error, RefusedTaskError) else str(error)
        mode = TIME if isinstance(error, TaskTimeoutError) else ERROR
        if self._stage == "physics":
            self._ledger.found["physics"] = Physics(detail=f"lost: {text}")
        elif self._seed is None:
            self._ledger.found |= {"error": text, "error_mode": mode}
        else:
            self._fail(self._seed, mode, "lost", text)
        if self._stage == "build" or self._lost == MOST_LOST:
            for seed in self._seeds:
                self._fail(seed, mode, "not_run", f"not run: {text}")

    def _fail(self, seed: int, mode: str, status: str, detail: str) -> None:
        self._ledger.starts[seed] = Attempt(seed=seed, mode=mode, status=status, detail=detail)

    def outcome(self) -> Outcome:
        return self._ledger.outcome(self._seconds)
