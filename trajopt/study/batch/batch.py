"""Solving of many cases on any executor."""

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
