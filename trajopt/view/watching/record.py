"""All iterations of a solve: the figures of each, as a table for later plots, or as lines for a reader."""

from __future__ import annotations

import contextlib
import csv
import time
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

from trajopt.errors import InputError, expanded
from trajopt.solving.monitoring import Iterate

FIGURES = ("objective", "primal", "dual", "barrier", "step", "regularization", "line_search", "restoration")
# Trials of a line search from which it is reported: the step is a sixteenth of the first, or less.
MANY_TRIALS = 5
# A step below this fraction of the full step makes hardly any progress.
SHORT_STEP = 1e-3
COLUMNS = ("solve", "label", "scheme", "intervals", "solver", "iteration", "time_s", *FIGURES)
# Lines after which the heading is repeated.
PAGE = 25
HEADING = f"{'iter':>5} {'objective':>14} {'primal':>9} {'dual':>9} {'barrier':>9} {'step':>9} {'time s':>8}"


@dataclass(kw_only=True, eq=False)
class History:
    """Figures of the current solve, a row per iteration; ``number`` counts solves, 0 before the first."""

    number: int = 0
    title: str = ""
    status: str = ""
    begun: float = 0.0
    ended: float = 0.0
    rows: list[dict[str, float]] = field(default_factory=list)

    def add(self, iterate: Iterate) -> None:
        """Add an iterate; a guess begins a new solve."""
        now = time.perf_counter()
        if iterate.stage == "guess":
            unknowns = iterate.transcription.layout.n_unknowns
            parts = (iterate.label, iterate.grid, f"{unknowns} variables", iterate.solver)
            self.number, self.title = self.number + 1, ", ".join(part for part in parts if part)
            self.begun, self.rows, self.status = now, [], ""
        elif iterate.stage == "iteration":
            row = {name: float(iterate.figures.get(name, 0.0)) for name in FIGURES}
            self.rows.append(
                {"iteration": float(iterate.figures["iteration"]), "time": now - self.begun, **row}
            )
        else:
            self.status = iterate.status
        self.ended = now

    @property
    def elapsed(self) -> float:
        """Duration of the current solve so far, or in total if it has ended, s."""
        return (self.ended if self.status else time.perf_counter()) - self.begun

    @property
    def step_time(self) -> float | None:
        """Mean time per iteration, s; None before the second."""
        if len(self.rows) < 2:
            return None
        first, last = self.rows[0], self.rows[-1]
        return (last["time"] - first["time"]) / (len(self.rows) - 1)

    def state(self) -> str:
        """The solver's state, in a word or two."""
        if self.status:
            return self.status
        if not self.rows:
            return "starting"
        return "restoring feasibility" if self.rows[-1]["restoration"] else "solving"

    def troubles(self) -> list[str]:
        """Difficulties of the last step, in words."""
        if not self.rows:
            return []
        row, troubles = self.rows[-1], []
        if row["restoration"]:
            troubles.append("restoration: the objective waits until the rows hold better")
        if row["regularization"] > 0:
            troubles.append(f"Hessian regularised by {row['regularization']:.0e}")
        if row["line_search"] >= MANY_TRIALS:
            troubles.append(f"line search cut the step {row['line_search'] - 1:.0f} times")
        elif len(self.rows) > 1 and 0 < row["step"] < SHORT_STEP:
            troubles.append("a very short step")
        return troubles


class IterationTable:
    """A watch that writes every iteration as a row of a CSV file, at once, so that it can be followed.

    If a write fails, as on a full disk, the table ends with a warning and the solve continues.
    """

    def __init__(self, path: str | Path) -> None:
        """Open the file; raises `InputError` if it cannot be written."""
        target = expanded(path)
        _require_table(target)
        try:
            self._file = target.open("w", encoding="utf-8", newline="", buffering=1)
            self._rows, self._history = csv.writer(self._file, lineterminator="\n"), History()
            self._rows.writerow(COLUMNS)
        except OSError as error:
            raise InputError(
                f"cannot write {target}: {error.strerror or error}", "allowed: a file in an existing folder"
            ) from None
        self._path, self._ended = target, False

    def __enter__(self) -> IterationTable:
        return self

    def __exit__(self, *error: object) -> None:
        with contextlib.suppress(OSError):  # a failed write has been reported
            self._file.close()

    def __call__(self, iterate: Iterate) -> None:
        """Write an iteration."""
        self._history.add(iterate)
        if iterate.stage != "iteration" or self._ended:
            return
        layout, row = iterate.transcription.layout, self._history.rows[-1]
        solve = (self._history.number, iterate.label, layout.mesh.transcription, layout.n_intervals)
        figures = [f"{row[name]:.9g}" for name in FIGURES]
        try:
            self._rows.writerow(
                [*solve, iterate.solver, int(row["iteration"]), f"{row['time']:.6f}", *figures]
            )
        except OSError as error:
            self._ended = True
            text = f"cannot write {self._path}: {error.strerror or error}; iterations are no longer logged"
            warnings.warn(text, stacklevel=2)


class IterationLines:
    """A watch that writes a line per iteration to a stream."""

    def __init__(self, stream: TextIO, title: str) -> None:
        self._stream, self._title, self._history = stream, title, History()

    def __call__(self, iterate: Iterate) -> None:
        """Write an iteration, or that a solve begins or ends."""
        history = self._history
        history.add(iterate)
        if iterate.stage == "guess":
            self._write(f"{self._title}: {history.title}")
        elif iterate.stage == "end":
            self._write(f"{self._title}: {history.status}, {history.elapsed:.2f} s")
        else:
            if len(history.rows) % PAGE == 1:
                self._write(HEADING)
            row = history.rows[-1]
            numbers = (
                f"{row['iteration']:5.0f} {row['objective']:14.7g} {row['primal']:9.2e} {row['dual']:9.2e} "
                f"{row['barrier']:9.2e} {row['step']:9.2e} {row['time']:8.2f}"
            )
            self._write(f"{numbers}  {'; '.join(history.troubles())}")

    def _write(self, text: str) -> None:
        self._stream.write(text.rstrip() + "\n")
        self._stream.flush()


def _require_table(target: Path) -> None:
    """Raise `InputError` if the file exists and is not a table of iterations."""
    with contextlib.suppress(OSError):
        if target.is_file():
            with target.open(encoding="utf-8", errors="replace") as old:
                first = old.readline().strip()
            if first not in ("", ",".join(COLUMNS)):
                raise InputError(
                    f"cannot write {target}: it is there and is no table of iterations",
                    "allowed: another name",
                )
