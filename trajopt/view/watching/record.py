"""All iterations as text: a table for later plots, or lines for a reader."""

from __future__ import annotations

import contextlib
import csv
import warnings
from pathlib import Path
from typing import TextIO

from trajopt.errors import InputError, expanded
from trajopt.solving.monitoring import Iterate
from trajopt.view.watching.history import FIGURES, History

COLUMNS = ("solve", "label", "scheme", "intervals", "solver", "iteration", "time_s", *FIGURES)
# Lines after which the heading is repeated.
PAGE = 25
HEADING = f"{'iter':>5} {'objective':>14} {'primal':>9} {'dual':>9} {'barrier':>9} {'step':>9} {'time s':>8}"


class IterationTable:
    """A watch that writes every iteration as a row of a CSV file, at once, so that it can be followed.

    Where the disk is full the table ends, with a warning, and the solve goes on.
    """

    def __init__(self, path: str | Path) -> None:
        """Open the file; raises `InputError` where it cannot be written."""
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
        with contextlib.suppress(OSError):  # what could not be written is said already
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
    """A watch that writes a line an iteration to a stream."""

    def __init__(self, stream: TextIO, title: str) -> None:
        self._stream, self._title, self._history = stream, title, History()

    def __call__(self, iterate: Iterate) -> None:
        """Write an iteration, or where a solve begins and ends."""
        history = self._history
        history.add(iterate)
        if iterate.stage == "guess":
            self._write(f"{self._title}: {history.title}")
        elif iterate.stage == "end":
            self._write(f"{self._title}: {history.status}, {history.elapsed:.2f} s")
        else:
            if len(history.rows) % PAGE == 1:
                self._write(HEADING)
            self._write(_line(history))

    def _write(self, text: str) -> None:
        self._stream.write(text.rstrip() + "\n")
        self._stream.flush()


def _line(history: History) -> str:
    row = history.rows[-1]
    numbers = f"{row['iteration']:5.0f} {row['objective']:14.7g} {row['primal']:9.2e} {row['dual']:9.2e}"
    more = f"{row['barrier']:9.2e} {row['step']:9.2e} {row['time']:8.2f}"
    return f"{numbers} {more}  {'; '.join(history.troubles())}"


def _require_table(target: Path) -> None:
    """Raise `InputError` where a file is there that holds something else than a table of iterations."""
    with contextlib.suppress(OSError):
        if target.is_file():
            with target.open(encoding="utf-8", errors="replace") as old:
                first = old.readline().strip()
            if first not in ("", ",".join(COLUMNS)):
                raise InputError(
                    f"cannot write {target}: it is there and is no table of iterations",
                    "allowed: another name",
                )
