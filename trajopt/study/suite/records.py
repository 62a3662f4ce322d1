"""Results on disk, one line of JSON a pair, appended as they come: what an interrupted suite goes on from."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from trajopt.errors import InputError
from trajopt.study.suite.cases import Case
from trajopt.study.suite.outcome import Ledger, Outcome
from trajopt.study.suite.settings import Settings

FILE = "results.jsonl"
# What is known of pairs that have not ended: their events as they come.
EVENTS = "events.jsonl"
LASTING = ("grid", "own", "check", "physics", "start")


class Records:
    """The results of one suite in a folder, or nowhere where there is none.

    versions: of what solves. A result of other settings or versions is not one of this suite.
    Raises InputError for a folder that cannot be written.
    """

    def __init__(self, folder: Path | None, settings: Settings, versions: Mapping[str, str]) -> None:
        self._head = {"settings": settings.to_dict(), "versions": dict(versions)}
        self.folder = folder
        self._file = None if folder is None else folder / FILE
        self._events = None if folder is None else folder / EVENTS

    def open(self, *, resume: bool) -> tuple[Outcome, ...]:
        """Make the folder; return what is known from before when resumed, otherwise begin anew.

        A pair that ended with an error (bad input, a lost process) is not taken over: it is tried again.
        """
        if self.folder is None or self._file is None:
            return ()
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            if not resume:
                self._file.write_text("", encoding="utf-8")
                self.close()
            with self._file.open("a+", encoding="utf-8") as stream:
                stream.seek(0)
                text = stream.read()
                if not text.endswith("\n"):  # a line cut off by a crash
                    stream.write("\n")
        except OSError as error:
            raise InputError(
                f"cannot write {self._file}: {error.strerror or error}",
                "allowed: a folder that can be written",
            ) from None
        return tuple(self._matching(text).values())

    def told(self, case: Case, event: Mapping[str, Any]) -> None:
        """Append one event of a pair that is running; those without figures are passed over."""
        if self._events is not None and event["event"] in LASTING:
            with self._events.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps({**self._head, "pair": case.name, "told": dict(event)}) + "\n")

    def close(self) -> None:
        """All pairs have ended: their events are in their results."""
        if self._events is not None:
            self._events.unlink(missing_ok=True)

    def unfinished(self) -> dict[str, list[Mapping[str, Any]]]:
        """Events of this suite's settings and versions by pair; what is no event is passed over."""
        found: dict[str, list[Mapping[str, Any]]] = {}
        if self._events is None or not self._events.is_file():
            return found
        for line in self._events.read_text(encoding="utf-8").splitlines():
            try:
                entry = json.loads(line)
                pair, event = entry["pair"], entry["told"]
                Ledger(Case(problem="", robot="", takes_robot=False)).add(event)
            except (ValueError, KeyError, TypeError):
                continue
            if {key: entry.get(key) for key in self._head} == self._head:
                found.setdefault(pair, []).append(event)
        return found

    def add(self, outcome: Outcome) -> None:
        """Append one result."""
        if self._file is not None:
            with self._file.open("a", encoding="utf-8") as stream:
                stream.write(self._line(outcome))

    def _line(self, outcome: Outcome) -> str:
        return json.dumps({**self._head, "outcome": outcome.to_dict()}) + "\n"

    def _matching(self, text: str) -> dict[str, Outcome]:
        """Results of this suite's settings and versions by pair; what is no result is passed over."""
        found = {}
        for line in text.splitlines():
            try:
                entry = json.loads(line)
                outcome = Outcome.from_dict(entry["outcome"])
            except (ValueError, KeyError, TypeError):
                continue
            if {key: entry.get(key) for key in self._head} == self._head and not outcome.error:
                found[outcome.name] = outcome
        return found


def left(cases: Sequence[Case], known: Sequence[Outcome]) -> tuple[tuple[Case, ...], tuple[Outcome, ...]]:
    """The cases that are still to be run, and those known results that are among the cases."""
    results = {outcome.name: outcome for outcome in known}
    names = {case.name for case in cases}
    return (
        tuple(case for case in cases if case.name not in results),
        tuple(outcome for name, outcome in results.items() if name in names),
    )
