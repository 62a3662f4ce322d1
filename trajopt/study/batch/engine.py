"""The loop of a batch: cases go to an executor as their starts are known, and their rows to the folder."""

from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import Executor
from typing import Any

from trajopt.study.batch.neighbours import StartTree
from trajopt.study.batch.records import BatchRecords
from trajopt.study.batch.solved_case import BatchSettings, CaseResult, solve_case
from trajopt.study.batch.variation import BatchCase
from trajopt.study.runner import DONE, Ended, Task, run_tasks

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
    show: Callable[[Collection[str]], object] = len,
) -> Iterator[dict[str, Any]]:
    """Yield the rows of all cases without one, as they are written.

    Takes all cases of the batch, how they are solved, its folder, and what `run_tasks` takes.

    Raises:
        InputError: where the executor has broken down, or no row can be written.
    """
    queue = _Queue(cases, settings, records)
    starts: dict[int, int | None] = {}

    def make(index: int) -> Task:
        start = starts[index] = queue.start(index)
        content = None if start is None else records.content(start)
        args = (cases[index], settings, content)
        return Task(name=cases[index].name, limit=settings.longest, function=solve_case, args=args)

    ended = run_tasks(
        queue.waiting, make, executor, window=window, attempts=MOST_ATTEMPTS, check=check, show=show
    )
    for one in ended:
        result = one.value if one.kind == DONE else _without(one)
        yield records.add(one.key, result, start=starts[one.key], attempts=one.attempts)
        queue.done(one.key)


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


def _without(ended: Ended[int]) -> CaseResult:
    figures = {"success": False, "status": ended.kind, "detail": ended.detail}
    return CaseResult(figures=figures, content=None)
