"""Many cases solved on any executor, and the batch on disk as data: its index and its solutions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trajopt.arguments import PositiveCount, checked
from trajopt.errors import InputError, expanded
from trajopt.motion.solution import Solution
from trajopt.study.batch.engine import run_batch
from trajopt.study.batch.records import (
    FIGURES,
    FIRST,
    BatchRecords,
    BatchRows,
    cases_of,
    read_request,
    solution_file,
)
from trajopt.study.batch.solved_case import BatchSettings
from trajopt.study.batch.variation import BatchCase, checked_cases
from trajopt.study.records import versions
from trajopt.study.tasks import open_workers

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True, kw_only=True)
class BatchEntry:
    """A case with its row.

    case: problem and parameters. figures: row of the index by column. file: of its solution, or None.
    """

    case: BatchCase
    figures: Mapping[str, Any]
    file: Path | None

    @property
    def solution(self) -> Solution:
        """The solution, read from its file. Raises `InputError` for a case without one."""
        if self.file is None:
            raise InputError(f"{self.case.name} has no solution: {self.figures['detail']}")
        return Solution.load(self.file)


@dataclass(frozen=True, kw_only=True)
class BatchDataset:
    """A batch in a folder, finished or not; iterates over its solved cases, in order.

    folder: its path. cases: all of them. index: a `pyarrow.Table` with one row per case that is done.
    """

    folder: Path
    cases: tuple[BatchCase, ...]
    index: pa.Table = field(repr=False)

    def __len__(self) -> int:
        return sum(self.index["success"].to_pylist())

    def __iter__(self) -> Iterator[BatchEntry]:
        return (entry for entry in self.entries() if entry.figures["success"])

    @property
    def parameters(self) -> list[str]:
        """Names of the columns of parameters."""
        return [name for name in self.index.column_names if name not in FIGURES and name not in FIRST]

    def entries(self) -> Iterator[BatchEntry]:
        """All cases that have a row, solved or not."""
        for batch in self.index.to_batches():
            for row in batch.to_pylist():
                file = None if row["file"] is None else self.folder / solution_file(row["case"])
                yield BatchEntry(case=self.cases[row["case"]], figures=row, file=file)


@checked
def batch(
    cases: Iterable[BatchCase],
    folder: str | Path,
    *,
    executor: Executor | None = None,
    jobs: PositiveCount | None = None,
    resume: bool = False,
    on_row: Callable[[dict[str, Any]], object] | None = None,
    **settings: Any,
) -> BatchDataset:
    """Solve many cases; results are written to a folder as they arrive, and depend only on the cases.

    Args:
        cases: problems with values of their parameters, such as from `trajopt.study.batch_cases`.
        folder: new or empty; with ``resume``, that of the same cases.
        executor: any of `concurrent.futures`, such as that of a Dask client; default: processes on this
            machine. While it runs, a case has a process of its worker to itself.
        jobs: number of these processes; default: one per processor.
        resume: continue an interrupted batch; cases that were lost or not saved are run again.
        on_row: called with every row of the index as it is written.
        **settings: fields of `trajopt.study.BatchSettings`.

    Returns:
        The batch as data.

    Raises:
        InputError: for invalid cases, settings or folders, or if the executor breaks down.
    """
    known = checked_cases(cases)
    chosen = BatchSettings(**settings)
    with (
        open_workers(executor=executor, jobs=jobs) as workers,
        BatchRecords(Path(folder), known, chosen, versions(), resume=resume) as records,
    ):
        for row in run_batch(known, chosen, records, workers):
            if on_row is not None:
                on_row(row)
    return dataset(folder)


@checked
def dataset(folder: str | Path) -> BatchDataset:
    """Load the batch in a folder, even while it runs.

    Args:
        folder: of `trajopt.batch` or of the command ``trajopt batch``.

    Raises:
        InputError: for a folder without a batch, or without PyArrow.
    """
    place = expanded(folder)
    cases = cases_of(read_request(place))
    return BatchDataset(folder=place, cases=tuple(cases), index=BatchRows(place, cases).table())
