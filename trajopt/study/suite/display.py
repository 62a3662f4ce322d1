"""What a suite shows while it runs, on stderr: a live table on a terminal, else one line a pair."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from trajopt.study.suite.cases import Case
from trajopt.study.suite.outcome import Outcome
from trajopt.study.suite.records import Records
from trajopt.study.suite.table import line

STAGES = {
    "build": "building and compiling",
    "own": "own guess",
    "check": "checking",
    "physics": "simulating",
    "start": "start",
}


class Lines:
    """One line on stderr for each pair that has ended."""

    def __init__(self, count: int, done: int) -> None:
        self._count, self._done = count, done

    def __enter__(self) -> Lines:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def event(self, slot: int, case: Case, event: dict[str, Any]) -> None:
        """Nothing: a log wants results only."""

    def finished(self, slot: int, outcome: Outcome) -> None:
        """Write the pair's line."""
        self._done += 1
        print(f"{self._done}/{self._count} {line(outcome)}", file=sys.stderr, flush=True)


class Bars:
    """A bar over all pairs, a line for each process, and above them one line for each pair that has ended."""

    def __init__(self, console: Console, count: int, done: int, jobs: int, starts: int) -> None:
        self._progress = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=20),
            MofNCompleteColumn(),
            TextColumn("{task.fields[state]}", markup=False),
            TimeElapsedColumn(),
            console=console,
            transient=True,
        )
        self._all = self._progress.add_task("suite", total=count, completed=done, state="")
        self._solves = 1 + starts
        self._slots: list[TaskID] = [
            self._progress.add_task("", total=self._solves, state="", visible=False) for _ in range(jobs)
        ]

    def __enter__(self) -> Bars:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def event(self, slot: int, case: Case, event: dict[str, Any]) -> None:
        """Show what the process of a slot does."""
        task = self._slots[slot]
        kind = event["event"]
        if kind == "stage" and event["stage"] == "build":
            self._progress.reset(task, description=case.name, visible=True, completed=0, total=self._solves)
        if kind == "stage":
            seed = event.get("seed")
            state = STAGES[event["stage"]] + ("" if seed is None else f" {seed}")
            self._progress.update(task, state=state)
        elif kind in ("own", "start"):
            self._progress.advance(task)
        elif kind == "iteration":
            self._progress.update(task, state=f"iteration {event['iteration']}")

    def finished(self, slot: int, outcome: Outcome) -> None:
        """Write the pair's line above the bars."""
        self._progress.update(self._slots[slot], visible=False)
        self._progress.advance(self._all)
        self._progress.console.print(line(outcome), markup=False, highlight=False, soft_wrap=True)


class Recorded:
    """A display that has every event recorded first, so that Ctrl-C loses no solve that has ended."""

    def __init__(self, shown: Lines | Bars, records: Records) -> None:
        self._shown, self._records = shown, records

    def event(self, slot: int, case: Case, event: dict[str, Any]) -> None:
        """Record and show."""
        self._records.told(case, event)
        self._shown.event(slot, case, event)

    def finished(self, slot: int, outcome: Outcome) -> None:
        """Show the pair's line."""
        self._shown.finished(slot, outcome)


def display(count: int, done: int, jobs: int, starts: int) -> Lines | Bars:
    """Bars where stderr is a terminal that can move its cursor, otherwise lines.

    count: all pairs. done: those known from before. starts: perturbed starts of a pair.
    """
    console = Console(stderr=True)
    if sys.stderr.isatty() and not console.is_dumb_terminal:
        return Bars(console, count, done, jobs, starts)
    return Lines(count, done)
