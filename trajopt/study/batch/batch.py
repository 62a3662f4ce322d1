"""Solve many cases on any executor."""

from collections.abc import Callable, Iterable
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from trajopt.arguments import PositiveCount, checked
from trajopt.errors import InputError
from trajopt.study.batch.dataset import BatchDataset, dataset
from trajopt.study.batch.engine import run_batch
from trajopt.study.batch.records import BatchRecords
from trajopt.study.batch.solved_case import BatchSettings
from trajopt.study.batch.variation import BatchCase, checked_cases
from trajopt.study.cluster import local_or
from trajopt.study.suite.versions import versions


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
    """Solve many cases; results are written to a folder as they come, and depend on the cases alone.

    Args:
        cases: problems with values of their parameters, as of `trajopt.study.batch_cases`.
        folder: a new or an empty one, or with ``resume`` that of the same cases.
        executor: any of `concurrent.futures`, such as that of a Dask client; default: processes on this
            machine. A case runs in a process that does no other at that time, where its worker runs.
        jobs: of these processes; default: one for each processor.
        resume: go on with a batch that was ended; cases that were lost or not saved are run again.
        on_row: called with every row of the index as it is written.
        **settings: those of `trajopt.study.BatchSettings`.

    Returns:
        The batch as data.

    Raises:
        InputError: for cases, settings or a folder that are not allowed, or where the executor breaks down.
    """
    known = checked_cases(cases)
    chosen = BatchSettings(**settings)
    if executor is not None and jobs is not None:
        raise InputError("jobs has no effect with an executor", "allowed: one of them")
    with (
        local_or(executor, jobs) as cluster,
        BatchRecords(Path(folder), known, chosen, versions(), resume=resume) as records,
    ):
        for row in run_batch(
            known, chosen, records, cluster.executor, window=cluster.window, check=cluster.check
        ):
            if on_row is not None:
                on_row(row)
    return dataset(folder)
