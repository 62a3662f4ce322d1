"""A batch on disk as data: its index and its solutions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trajopt.arguments import checked
from trajopt.errors import InputError, expanded
from trajopt.solution.solution import Solution
from trajopt.study.batch.columns import FIGURES, FIRST, parameter_columns, schema
from trajopt.study.batch.records import cases_of, merged, read_request, read_rows, solution_file
from trajopt.study.batch.variation import BatchCase

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
def dataset(folder: str | Path) -> BatchDataset:
    """Load the batch in a folder, even while it runs.

    Args:
        folder: of `trajopt.batch` or ``trajopt batch --out``.

    Raises:
        InputError: for a folder without a batch, or without PyArrow.
    """
    place = expanded(folder)
    cases = cases_of(read_request(place))
    wanted = schema(parameter_columns(cases))
    index, new = read_rows(place, wanted)
    return BatchDataset(folder=place, cases=tuple(cases), index=merged(index, new, wanted))
