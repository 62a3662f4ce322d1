"""A batch on disk: its request, an index in Parquet, and the solution files.

Rows are appended to a journal as they arrive. From time to time all rows are written to the index in one
step, and the journal starts anew: whenever a process is killed, each reported row is in one of the two.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from trajopt.errors import InputError, expanded
from trajopt.motion.file import write_bytes
from trajopt.motion.output import replacing
from trajopt.problem.catalogue import families
from trajopt.problem.family import PLAIN_NAME, choose
from trajopt.study.batch.solved_case import BatchSettings, CaseResult
from trajopt.study.batch.variation import BatchCase
from trajopt.study.processes import LOST
from trajopt.study.records import JsonLines, require_same
from trajopt.versions import optional_package

if TYPE_CHECKING:
    import pyarrow as pa

REQUEST, INDEX, JOURNAL, SOLUTIONS = "batch.json", "index.parquet", "journal.jsonl", "solutions"
# The index is written once the journal has 1 / JOURNAL_PART of its rows, and at least LEAST_JOURNAL.
JOURNAL_PART, LEAST_JOURNAL = 8, 100
# Solution files per folder.
FILES_PER_FOLDER = 1000
# Outcomes that are run again when a batch is resumed, since another attempt may succeed.
NOT_SAVED = "not_saved"
RERUN = (LOST, NOT_SAVED)
# Part of the request -> what another batch has instead.
DIFFERENCES = {
    "cases": "other cases",
    "settings": "other settings",
    "versions": "other versions of the libraries",
}
# Columns of figures, with the names of their PyArrow types.
FIGURES = {
    "success": "bool_",
    "status": "string",
    "detail": "string",
    "start": "int64",
    "warm_start": "bool_",
    "iterations": "int64",
    "solver_time_s": "float64",
    "case_time_s": "float64",
    "objective": "float64",
    "motion_time_s": "float64",
    "energy_j": "float64",
    "cost_of_transport": "float64",
    "max_violation": "float64",
    "tolerance_used": "float64",
    "worst_figure": "string",
    "variables": "int64",
    "intervals": "int64",
    "attempts": "int64",
    "file": "string",
}
FIRST = ("case", "problem")


class BatchRows:
    """The rows of a batch: those of its index, and newer ones of its journal.

    Raises `InputError` for a damaged index, or without PyArrow.
    """

    def __init__(self, folder: Path, cases: Sequence[BatchCase]) -> None:
        self._cases, self.journal, self._index = cases, JsonLines(folder / JOURNAL), folder / INDEX
        # The parameters, and whether each is a word in any case.
        self._words: dict[str, bool] = {}
        for case in cases:
            for name, value in case.values.items():
                self._words[name] = self._words.get(name, False) or isinstance(value, str)
        # The journal first: rows that move to the index meanwhile are then in both instead of neither.
        rows = self.journal.read()
        self._old = self._read_index()
        self._new = {row["case"]: row for row in rows if isinstance(row.get("case"), int)}

    def table(self) -> pa.Table:
        """All rows, by case."""
        pyarrow, old = arrow(), self._old
        fresh = pyarrow.Table.from_pylist([dict(row) for row in self._new.values()], schema=old.schema)
        kept = old.filter(pyarrow.compute.invert(pyarrow.compute.is_in(old["case"], fresh["case"])))
        return pyarrow.concat_tables([kept, fresh]).sort_by("case")

    def add(self, index: int, figures: Mapping[str, Any]) -> dict[str, Any]:
        """Append the row of a case to the journal; returns the row."""
        case = self._cases[index]
        values = {
            column_of(name): str(value) if self._words[name] else float(value)
            for name, value in case.values.items()
        }
        row = {"case": index, "problem": case.problem, **values, **figures}
        self.journal.append(row)
        self._new[index] = row
        if len(self._new) >= max(LEAST_JOURNAL, self._old.num_rows // JOURNAL_PART):
            with contextlib.suppress(InputError):  # a full disk: the journal has all rows
                self.checkpoint()
        return row

    def checkpoint(self) -> None:
        """Write all rows to the index and restart the journal. Raises `InputError` if that fails."""
        if not self._new and self._index.exists():
            return
        table = self.table()
        with replacing(self._index) as unfinished:
            arrow().parquet.write_table(table, unfinished)
        self._old, self._new = table, {}
        self.journal.open(resume=False)

    def _read_index(self) -> pa.Table:
        pyarrow, index = arrow(), self._index
        kinds = [("case", "int64"), ("problem", "string")]
        kinds += [(column_of(name), "string" if word else "float64") for name, word in self._words.items()]
        kinds += FIGURES.items()
        wanted = pyarrow.schema([(name, getattr(pyarrow, kind)()) for name, kind in kinds])
        if not index.exists():
            return wanted.empty_table()
        try:
            table = pyarrow.parquet.read_table(index)
        except (OSError, pyarrow.ArrowException) as error:
            reason = str(error).splitlines()[0]
            raise InputError(f"cannot read {index}: {reason}", "allowed: the index of a batch") from None
        if not table.schema.equals(wanted):
            raise InputError(f"{index} has other columns", "allowed: the index of this batch")
        return table


class BatchRecords:
    """The folder of a batch while it runs.

    solved: whether each case that has a row was solved.

    Args:
        folder: created if it does not exist.
        cases: all of them.
        settings: how they are solved.
        versions: of the libraries.
        resume: continue with what is there.

    Raises:
        InputError: for a folder that cannot be written, holds something else, another batch or one that runs.
    """

    def __init__(
        self,
        folder: Path,
        cases: Sequence[BatchCase],
        settings: BatchSettings,
        versions: Mapping[str, str],
        *,
        resume: bool,
    ) -> None:
        self.folder = expanded(folder)
        head = {
            "cases": [[case.problem, dict(case.values)] for case in cases],
            "settings": asdict(settings),
            "versions": dict(versions),
        }
        arrow()  # refused before a folder is made
        self._begin(head, resume)
        self._lock = self._locked()
        self._rows = BatchRows(self.folder, cases)
        self._rows.journal.open(resume=True)
        columns = (self._rows.table()[name].to_pylist() for name in ("case", "success", "status"))
        self.solved: dict[int, bool] = {
            case: bool(success) for case, success, status in zip(*columns, strict=True) if status not in RERUN
        }

    def __enter__(self) -> BatchRecords:
        return self

    def __exit__(self, *error: object) -> None:
        try:
            self._rows.checkpoint()
        except InputError as failed:
            journal = self.folder / JOURNAL
            raise InputError(
                failed.what, f"all rows are kept in {journal}; free space, then `resume`"
            ) from None
        finally:
            self._lock.close()

    def add(self, index: int, result: CaseResult, *, start: int | None, attempts: int) -> dict[str, Any]:
        """Write the solution and the row of a case; returns the row.

        A case whose solution cannot be written becomes `NOT_SAVED`. Raises `InputError` if not even the row
        can be written.
        """
        figures = {**result.figures, "start": start, "attempts": attempts, "file": None}
        if result.content is not None:
            place = self.folder / solution_file(index)
            try:
                for part in (place.parent, place):
                    _require_no_link(part)
                place.parent.mkdir(parents=True, exist_ok=True)
                write_bytes(place, result.content)
                figures["file"] = solution_file(index)
            except (InputError, OSError) as error:
                figures |= {"success": False, "status": NOT_SAVED, "detail": f"{error}"}
        try:
            row = self._rows.add(index, figures)
        except OSError as error:
            raise InputError(
                f"cannot write {self.folder / JOURNAL}: {error.strerror}",
                f"{len(self.solved)} cases are done and kept; free space, then `resume`",
            ) from None
        self.solved[index] = bool(figures["success"])
        return row

    def content(self, index: int) -> bytes:
        """Content of a case's solution file. Raises `InputError` if it is missing."""
        place = self.folder / solution_file(index)
        try:
            return place.read_bytes()
        except OSError as error:
            raise InputError(f"cannot read {place}: {error.strerror}") from None

    def _begin(self, head: dict[str, Any], resume: bool) -> None:
        request = self.folder / REQUEST
        if resume:
            require_same(self.folder, "batch", read_request(self.folder), head, DIFFERENCES)
            return
        try:
            if self.folder.exists() and (not self.folder.is_dir() or any(self.folder.iterdir())):
                allowed = "`resume`, or another folder" if request.exists() else "a new or an empty folder"
                raise InputError(f"{self.folder} is there and not empty", f"allowed: {allowed}")
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(
                f"cannot write {self.folder}: {error.strerror}", "allowed: a folder that can be written"
            ) from None
        with replacing(request) as unfinished:
            unfinished.write_text(json.dumps(head), encoding="utf-8")

    def _locked(self) -> IO[str]:
        """Lock the folder against other processes; the lock ends with this process."""
        stream = (self.folder / REQUEST).open(encoding="utf-8")
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            stream.close()
            raise InputError(f"a batch runs in {self.folder}", "allowed: another folder, or wait") from None
        return stream


def solution_file(index: int) -> str:
    """Path of a case's solution within the folder."""
    return f"{SOLUTIONS}/{index // FILES_PER_FOLDER:05d}/{index:08d}.npz"


def read_request(folder: Path) -> dict[str, Any]:
    """The request of a batch: cases, settings, versions. Raises `InputError` for another folder."""
    place = expanded(folder)
    for name in (REQUEST, INDEX, JOURNAL, SOLUTIONS):
        _require_no_link(place / name)
    try:
        head = json.loads((place / REQUEST).read_text(encoding="utf-8"))
        kinds = {"cases": list, "settings": dict, "versions": dict}
        wrong = next((name for name, kind in kinds.items() if not isinstance(head[name], kind)), None)
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        raise InputError(f"{folder} holds no batch", "allowed: the folder of a batch") from None
    if wrong is not None:
        raise InputError(f"{wrong} in {place / REQUEST} is not a {kinds[wrong].__name__}")
    return dict(head)


def cases_of(head: Mapping[str, Any]) -> list[BatchCase]:
    """The cases of a request. Raises `InputError` for an invalid entry."""
    cases = []
    for number, entry in enumerate(head["cases"]):
        problem, values = entry if isinstance(entry, list) and len(entry) == 2 else (None, None)
        if not isinstance(problem, str) or not isinstance(values, dict):
            raise InputError(f"case {number} of the batch is {entry!r:.80}", "allowed: [problem, parameters]")
        for name, value in values.items():
            if not isinstance(value, (str, int, float)) or isinstance(value, bool):
                raise InputError(
                    f"{name} of case {number} of the batch is {value!r:.80}", "allowed: a number or a text"
                )
        cases.append(BatchCase(problem=problem, values=values))
    return cases


def looked_up_cases(head: Mapping[str, Any]) -> list[BatchCase]:
    """Cases as a folder names them, with problems and robots of the catalogue, never files that would run.

    Raises `InputError` for others.
    """
    cases, known = cases_of(head), families()
    for problem, robot in dict.fromkeys((case.problem, case.values.get("robot")) for case in cases):
        choose(known, problem)
        if robot is not None and Path(str(robot)).suffix and not PLAIN_NAME.fullmatch(str(robot)):
            raise InputError(
                f"the batch names the robot {robot!r:.200}, and files that a folder names are not run",
                "allowed: the call that began it, with `resume`",
            )
    return cases


def _require_no_link(place: Path) -> None:
    if place.is_symlink():
        raise InputError(f"{place} is a symbolic link", "allowed: files and folders of the batch itself")


def arrow() -> Any:
    """PyArrow with its Parquet module; if it is missing, raises an `InputError` that names the extra."""
    for name in ("pyarrow.parquet", "pyarrow"):
        package = optional_package(name, what="the index of a batch", extra="batch")
    return package


def column_of(name: str) -> str:
    """The column of a parameter: its name, with a prefix if another column has it."""
    return f"parameter_{name}" if name in FIGURES or name in FIRST else name
