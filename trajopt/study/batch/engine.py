"""The loop of a batch: cases go to an executor as their starts are known, and their rows to the folder."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from typing import Any

from trajopt.errors import InputError
from trajopt.solvers.status import Status
from trajopt.study.batch.neighbours import StartTree
from trajopt.study.batch.records import LOST, REFUSED, BatchRecords
from trajopt.study.batch.solved_case import BatchSettings, CaseResult, run_case_alone, run_case_anywhere
from trajopt.study.batch.variation import BatchCase
from trajopt.study.workers.executor import ProcessPerTaskExecutor
from trajopt.study.workers.running import RunningTasks
from trajopt.study.workers.task import LostTaskError, RefusedTaskError, TaskTimeoutError

# A case whose process was lost is run again, up to so many times in all.
MOST_ATTEMPTS = 3


def run_batch(
    cases: Sequence[BatchCase],
    settings: BatchSettings,
    records: BatchRecords,
    executor: Executor,
    *,
    window: Callable[[], int],
    check: Callable[[], object] = bool,
) -> Iterator[dict[str, Any]]:
    """Yield the rows of all cases without one, as they are written.

    Args:
        cases: all of the batch.
        settings: how they are solved.
        records: the folder.
        executor: any; one that is not of processes of their own starts such processes.
        window: most tasks that it has at a time: more wait here.
        check: called several times a second; an exception from it ends the batch.

    Raises:
        InputError: where the executor has broken down, or no row can be written.
    """
    queue = _Queue(cases, settings, records)
    task = run_case_alone if isinstance(executor, ProcessPerTaskExecutor) else run_case_anywhere
    running, attempts = RunningTasks[tuple[int, int | None]](executor, check), Counter[int]()
    while queue.waiting or running:
        while queue.waiting and len(running) < max(1, window()):
            index = queue.waiting.popleft()
            attempts[index] += 1
            start = queue.start(index)
            content = None if start is None else records.content(start)
            try:
                running.submit((index, start), task, cases[index], settings, content)
            except (BrokenExecutor, RuntimeError) as error:
                check()
                raise _broken(error, records, cases) from None
        for (index, start), future in running.ended():
            try:
                result = _result(future, again=attempts[index] < MOST_ATTEMPTS)
            except (BrokenExecutor, CancelledError) as error:
                check()
                raise _broken(error, records, cases) from None
            if result is None:
                queue.waiting.append(index)
                continue
            yield records.add(index, result, start=start, attempts=attempts[index])
            queue.done(index)


class _Queue:
    """Cases whose ancestors are done, in the order of the tree."""

    def __init__(self, cases: Sequence[BatchCase], settings: BatchSettings, records: BatchRecords) -> None:
        self._solved = records.solved
        self._tree = StartTree(cases) if settings.neighbours else None
        self._children: dict[int, list[int]] = {}
        self.waiting: deque[int] = deque()
        for index in self._tree.order if self._tree else range(len(cases)):
            if index in self._solved:
                continue
            # Of all ancestors, not the parent alone: one that was lost is run again after its descendants.
            above = self._tree.ancestors(index) if self._tree else []
            missing = next((other for other in above if other not in self._solved), None)
            if missing is None:
                self.waiting.append(index)
            else:
                self._children.setdefault(missing, []).append(index)

    def start(self, index: int) -> int | None:
        """The case from which a case starts, None for its default guess."""
        above = self._tree.nearest(index) if self._tree else []
        return next((other for other in above if self._solved.get(other)), None)

    def done(self, index: int) -> None:
        """A case has its row: those that wait for it can run."""
        self.waiting.extend(self._children.pop(index, ()))


def _result(future: Future[CaseResult], *, again: bool) -> CaseResult | None:
    """The result of a case; None for a lost one that is run again."""
    try:
        return future.result()
    except RefusedTaskError as error:
        return _without(REFUSED, error)
    except TaskTimeoutError as error:
        return _without(Status.TIME_LIMIT.word, error)
    except LostTaskError as error:
        return None if again else _without(LOST, error)
    except (BrokenExecutor, CancelledError):
        raise
    except Exception as error:  # of the executor, such as a worker that was lost too often
        return _without(LOST, error)


def _without(status: str, error: Exception) -> CaseResult:
    text = " ".join(f"{error}".split()) or type(error).__name__
    return CaseResult(figures={"success": False, "status": status, "detail": text}, content=None)


def _broken(error: BaseException, records: BatchRecords, cases: Sequence[BatchCase]) -> InputError:
    text = " ".join(f"{error}".split()) or type(error).__name__
    return InputError(
        f"the executor has broken down: {text}",
        f"{len(records.solved)} of {len(cases)} cases are done and kept; go on with --resume",
    )
