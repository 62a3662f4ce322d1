"""Which case a case starts from: a tree over the parameters, whatever the order of work.

Cases of a problem that differ in numbers alone are the points of a k-d tree (Bentley, Commun. ACM 18, 1975).
A case starts from the nearest of its ancestors that was solved. Ancestors depend on the cases alone and are
solved before it, so that its result is the same on one worker and on many; it waits for about log2 n cases.
"""

from collections.abc import Sequence

import numpy as np

from trajopt.study.batch.variation import BatchCase

Words = tuple[tuple[str, str], ...]


class StartTree:
    """The trees of all groups of cases that differ in numbers alone.

    parents: of each case, None for a root. order: of the cases, parents before children, by levels.
    """

    def __init__(self, cases: Sequence[BatchCase]) -> None:
        self.parents: list[int | None] = [None] * len(cases)
        self._points: list[np.ndarray] = [np.zeros(0)] * len(cases)
        levels: list[list[int]] = []
        for members in _groups(cases):
            names = [name for name, value in cases[members[0]].values.items() if not isinstance(value, str)]
            numbers = np.array([[float(cases[i].values[name]) for name in names] for i in members])
            for index, point in zip(members, _scaled(numbers), strict=True):
                self._points[index] = point
            self._grow(np.array(members), levels)
        self.order = [index for level in levels for index in sorted(level)]

    def ancestors(self, index: int) -> list[int]:
        """The parent of a case, its parent and so on up to the root."""
        ancestors: list[int] = []
        above = self.parents[index]
        while above is not None:
            ancestors.append(above)
            above = self.parents[above]
        return ancestors

    def nearest(self, index: int) -> list[int]:
        """The ancestors of a case, the nearest first; of those as near, the lower in the tree."""
        point, ancestors = self._points[index], self.ancestors(index)
        return sorted(ancestors, key=lambda other: float(np.linalg.norm(self._points[other] - point)))

    def _grow(self, members: np.ndarray, levels: list[list[int]]) -> None:
        """Split cases at the median of their widest axis: the parent of the medians of both halves."""
        waiting: list[tuple[np.ndarray, int | None, int]] = [(members, None, 0)]
        while waiting:
            part, parent, depth = waiting.pop()
            points = np.array([self._points[i] for i in part])
            # Ties are broken by the other axes and by number: the tree depends on the cases alone.
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
    groups: dict[tuple[str, Words, tuple[str, ...]], list[int]] = {}
    for index, case in enumerate(cases):
        words = tuple((name, value) for name, value in sorted(case.values.items()) if isinstance(value, str))
        numbers = tuple(name for name, value in sorted(case.values.items()) if not isinstance(value, str))
        groups.setdefault((case.problem, words, numbers), []).append(index)
    return list(groups.values())


def _scaled(points: np.ndarray) -> np.ndarray:
    """Points (n, d) in the unit cube of their ranges."""
    size = np.ptp(points, axis=0)
    return np.asarray((points - points.min(axis=0)) / np.where(size > 0, size, 1.0))
