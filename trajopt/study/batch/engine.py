"""The engine of a batch: submits cases once their starts are known, and writes their rows to the folder."""

from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from trajopt.study.batch.records import BatchRecords
from trajopt.study.batch.solved_case import BatchSettings, CaseResult, solve_case
from trajopt.study.batch.variation import BatchCase
from trajopt.study.tasks import DONE, TimedCall, Workers

# Most attempts at a case whose process is lost.
MOST_ATTEMPTS = 3


def run_batch(
    cases: Sequence[BatchCase], settings: BatchSettings, records: BatchRecords, workers: Workers
) -> Iterator[dict[str, Any]]:
    """Solve all cases without a row, and yield their rows as they are written.

    Raises:
        InputError: if the executor breaks down, or a row cannot be written.
    """
    tree = StartTree(cases) if settings.neighbours else None
    starts: dict[int, int | None] = {}
    waiting: deque[int] = deque()
    # Cases by an ancestor that is not done. All ancestors count, not only the parent: a lost one is run again
    # after its descendants.
    held: dict[int, list[int]] = {}
    for index in tree.order if tree else range(len(cases)):
        if index not in records.solved:
            above = tree.ancestors(index) if tree else []
            missing = next((other for other in above if other not in records.solved), None)
            queue = waiting if missing is None else held.setdefault(missing, [])
            queue.append(index)

    def make(index: int) -> TimedCall:
        above = tree.nearest(index) if tree else []
        start = starts[index] = next((other for other in above if records.solved.get(other)), None)
        content = None if start is None else records.content(start)
        args = (cases[index], settings, content)
        return TimedCall(name=cases[index].name, limit=settings.longest, function=solve_case, args=args)

    for ended in workers.run(waiting, make, attempts=MOST_ATTEMPTS):
        figures = {"success": False, "status": ended.kind, "detail": ended.detail}
        result = ended.value if ended.kind == DONE else CaseResult(figures=figures, content=None)
        yield records.add(ended.key, result, start=starts[ended.key], attempts=ended.attempts)
        waiting.extend(held.pop(ended.key, ()))


class StartTree:
    """One tree of starts for each group of cases that differ only in numbers.

    parents: of each case; None for a root. order: of the cases, parents before children, level by level.
    """

    def __init__(self, cases: Sequence[BatchCase]) -> None:
        self.parents: list[int | None] = [None] * len(cases)
        self._points: list[np.ndarray] = [np.zeros(0)] * len(cases)
        levels: list[list[int]] = []
        for members in _groups(cases):
            names = [name for name, value in cases[members[0]].values.items() if not isinstance(value, str)]
            numbers = np.array([[float(cases[i].values[name]) for name in names] for i in members])
            size = np.ptp(numbers, axis=0)
            scaled = (numbers - numbers.min(axis=0)) / np.where(size > 0, size, 1.0)
            for index, point in zip(members, scaled, strict=True):
                self._points[index] = point
            self._grow(np.array(members), levels)
        self.order = [index for level in levels for index in sorted(level)]

    def ancestors(self, index: int) -> list[int]:
        """The parent of a case, its grandparent, and so on up to the root."""
        ancestors: list[int] = []
        above = self.parents[index]
        while above is not None:
            ancestors.append(above)
            above = self.parents[above]
        return ancestors

    def nearest(self, index: int) -> list[int]:
        """The ancestors of a case, nearest first; of equally near ones, the lower in the tree first."""
        point, ancestors = self._points[index], self.ancestors(index)
        return sorted(ancestors, key=lambda other: float(np.linalg.norm(self._points[other] - point)))

    def _grow(self, members: np.ndarray, levels: list[list[int]]) -> None:
        """Split cases at the median of their widest axis: it is the parent of the medians of both halves."""
        waiting: list[tuple[np.ndarray, int | None, int]] = [(members, None, 0)]
        while waiting:
            part, parent, depth = waiting.pop()
            points = np.array([self._points[i] for i in part])
            # Other axes and case numbers break ties, so that the tree depends only on the cases.
            keys = [part]
            if points.shape[1]:
                widest = int(np.argmax(np.ptp(points, axis=0)))
                keys += [*np.delete(points, widest, axis=1).T, points[:, widest]]
            ordered = part[np.lexsort(keys)]
            middle = len(ordered) // 2
            node = int(ordered[middle])
            self.parents[node] = parent
            if depth == len(levels):
                levels.append([])
            levels[depth].append(node)
            halves = (ordered[:middle], ordered[middle + 1 :])
            waiting += [(half, node, depth + 1) for half in halves if len(half)]


def _groups(cases: Sequence[BatchCase]) -> list[list[int]]:
    """Indices of the cases with the same problem, the same words and the same names of numbers."""
    groups: dict[tuple[Any, ...], list[int]] = {}
    for index, case in enumerate(cases):
        words = (value if isinstance(value, str) else None for _, value in sorted(case.values.items()))
        groups.setdefault((case.problem, *sorted(case.values), *words), []).append(index)
    return list(groups.values())
