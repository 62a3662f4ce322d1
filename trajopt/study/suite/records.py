"""Results on disk, one line of JSON per pair, appended as they arrive, so that a suite can be resumed."""

import contextlib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from trajopt.solution.file import write_bytes
from trajopt.study.suite.cases import Case
from trajopt.study.suite.outcome import Ledger, Outcome
from trajopt.study.suite.settings import SuiteSettings
from trajopt.study.workers.records import JsonLines

FILE = "results.jsonl"
# Events of pairs that have not ended.
EVENTS = "events.jsonl"
# Suffix of files with a simulated motion.
SIMULATED = "-simulated"


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

    def told(self, pair: str, event: Mapping[str, Any]) -> None:
        """Append one event of a running pair."""
        self._events.append({**self._head, "pair": pair, "told": dict(event)})

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

    def unfinished(self) -> dict[str, list[Mapping[str, Any]]]:
        """Events by pair, of this suite's settings and versions; invalid lines are skipped."""
        events: dict[str, list[Mapping[str, Any]]] = {}
        for entry in filter(self._is_of_this_suite, self._events.read()):
            with contextlib.suppress(ValueError, KeyError, TypeError):
                pair, event = entry["pair"], entry["told"]
                Ledger(Case(problem="", robot="", takes_robot=False)).add(event)
                events.setdefault(pair, []).append(event)
        return events

    def add(self, outcome: Outcome) -> None:
        """Append one result."""
        self._results.append({**self._head, "outcome": outcome.to_dict()})

    def _is_of_this_suite(self, entry: Mapping[str, Any]) -> bool:
        return {key: entry.get(key) for key in self._head} == self._head
