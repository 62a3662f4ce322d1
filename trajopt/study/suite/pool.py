"""All pairs, each in a process of its own, as many at a time as there are processors.

A process that crashes, hangs or runs out of memory loses at most the solve it was in: what it had told is
kept, and the perturbed starts that were left go on in a new one.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol

from trajopt.solving.interruption import LOOK
from trajopt.study.suite.cases import Case
from trajopt.study.suite.outcome import Attempt, Ledger, Outcome
from trajopt.study.suite.process import Limits, LostError, Worker
from trajopt.study.suite.settings import Settings

# After so many lost processes the rest of a pair's starts count as failed without being run.
MOST_LOST = 3


class Display(Protocol):
    """What shows the progress; called from the main thread alone."""

    def event(self, slot: int, case: Case, event: dict[str, Any]) -> None:
        """A pair's process has told something."""

    def finished(self, slot: int, outcome: Outcome) -> None:
        """A pair has ended."""


class Pending:
    """Pairs that wait. One on a robot that is not being run comes first: two that start together on one
    robot would compile the same functions twice."""

    def __init__(self, cases: Sequence[Case]) -> None:
        self._waiting, self._busy = list(cases), list[str]()
        self._lock = threading.Lock()

    def take(self) -> Case | None:
        """The next pair, or None."""
        with self._lock:
            if not self._waiting:
                return None
            case = next((one for one in self._waiting if one.robot not in self._busy), self._waiting[0])
            self._waiting.remove(case)
            self._busy.append(case.robot)
            return case

    def done(self, case: Case) -> None:
        """The pair has ended."""
        with self._lock:
            self._busy.remove(case.robot)


def run_all(
    cases: Sequence[Case],
    settings: Settings,
    *,
    jobs: int,
    display: Display,
    limits: Limits | None = None,
    folder: Path | None = None,
    known: Mapping[str, Sequence[Mapping[str, Any]]] = MappingProxyType({}),
    check: Callable[[], object] = bool,
) -> Generator[Outcome, None, None]:
    """Yield the outcome of each pair as it ends. Closing the iterator kills all processes.

    known: events of an earlier run by pair; what they tell is not run again. check: called several times a
    second; what it raises ends the run.
    """
    pending, told = Pending(cases), queue.Queue[tuple[int, Case, Any]]()
    cancelled = threading.Event()

    def tell(slot: int, case: Case, event: dict[str, Any]) -> None:
        told.put((slot, case, event))

    def serve(slot: int) -> None:
        while not cancelled.is_set() and (case := pending.take()) is not None:
            tell(slot, case, {"event": "stage", "stage": "build"})
            try:
                pair = _Pair(case, settings, limits or Limits(), folder, cancelled)
                for event in known.get(case.name, ()):
                    pair.ledger.add(event)
                outcome: Any = pair.run(partial(tell, slot, case))
            except BaseException as error:  # of the suite itself: raised where it can be seen
                outcome = error
            pending.done(case)
            told.put((slot, case, outcome))

    threads = [threading.Thread(target=serve, args=(slot,)) for slot in range(min(jobs, len(cases)))]
    for thread in threads:
        thread.start()
    left = len(cases)
    try:
        while left:
            check()
            try:
                slot, case, news = told.get(timeout=LOOK)
            except queue.Empty:
                continue
            if isinstance(news, dict):
                display.event(slot, case, news)
                continue
            if isinstance(news, BaseException):
                raise news
            left -= 1
            yield news
            display.finished(slot, news)  # shown when it is recorded: Ctrl-C in between would lose it
    finally:
        cancelled.set()
        for thread in threads:
            thread.join()


class _Pair:
    """One pair and the processes it takes."""

    def __init__(
        self, case: Case, settings: Settings, limits: Limits, folder: Path | None, cancelled: threading.Event
    ) -> None:
        self.case, self.settings, self.limits = case, settings, limits
        self.folder, self.cancelled = folder, cancelled
        self.ledger = Ledger(case)
        self.stage: str = "build"
        self.seed: int | None = None

    def run(self, tell: Callable[[dict[str, Any]], None]) -> Outcome:
        """Run to the end, or until cancelled."""
        begin = time.perf_counter()
        known = self.ledger.own_known and (self.ledger.physics_known or not self.settings.simulate)
        own, lost = not known, 0
        seeds = [seed for seed in self.settings.seeds if seed not in self.ledger.seeds]
        while own or seeds:
            error = self._process(own, seeds, tell)
            if error is None:
                break
            lost += 1
            self._record(error)
            seeds = [seed for seed in seeds if seed not in self.ledger.seeds]
            if not seeds or self.stage == "build" or lost == MOST_LOST:
                self._give_up(seeds, error)
                break
            own = False
        return self.ledger.outcome(time.perf_counter() - begin)

    def _process(
        self, own: bool, seeds: Sequence[int], tell: Callable[[dict[str, Any]], None]
    ) -> LostError | None:
        """One process, to its end; the error where it was lost."""
        self.stage, self.seed = "build", None
        folder = None if self.folder is None else str(self.folder.resolve())
        job = {
            "case": asdict(self.case),
            "settings": self.settings.to_dict(),
            "own": own,
            "seeds": list(seeds),
            "folder": folder,
        }
        worker = Worker(job)
        try:
            for event in worker.events(self.settings, self.limits):
                if self.cancelled.is_set():
                    return None
                if event is not None:
                    self._take(event)
                    tell(event)
        except LostError as error:
            return error
        finally:
            worker.kill()
        return None

    def _take(self, event: dict[str, Any]) -> None:
        if event["event"] == "stage":
            self.stage, self.seed = event["stage"], event.get("seed")
        self.ledger.add(event)

    def _record(self, error: LostError) -> None:
        """What was lost: a perturbed start, or the pair's own solve or check."""
        if self.stage == "physics":
            self.ledger.add({"event": "physics", "values": {"detail": f"lost: {error.text}"}})
        elif self.seed is None:
            self.ledger.fail(error.text, error.mode)
        else:
            self.ledger.add_start(Attempt(seed=self.seed, mode=error.mode, status="lost", detail=error.text))

    def _give_up(self, seeds: Sequence[int], error: LostError) -> None:
        for seed in seeds:
            text = f"not run: {error.text}"
            self.ledger.add_start(Attempt(seed=seed, mode=error.mode, status="not_run", detail=text))
