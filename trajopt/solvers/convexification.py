"""A Hessian without negative curvature, for programs that cannot be solved with the exact one.

The Hessian is block diagonal: no function of the NLP depends on variables of two stages. A share of every
block's negative eigenvalues is removed. Replacing them by their magnitudes makes steps far too short:
bilinear terms, such as a force times its lever, have pairs of eigenvalues of both signs.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from trajopt.transcription.nlp import Nlp

# The least share of negative curvature that is removed; the factors by which it grows until a program is
# solved, and shrinks from step to step. After n failures in a row of a smaller one it stays for 2^n - 1
# steps.
LEAST, MORE, LESS = 1e-2, 8.0, 2.0
MOST_FAILURES = 3


@dataclass(frozen=True)
class _Blocks:
    """Blocks of one size: indices of the Hessian's nonzeros in them, and of their lower triangles.

    ``entries`` are nonzeros of the Hessian, ``at`` (block, row, column) of each; ``lower`` (row, column) of
    a block's lower triangle.
    """

    count: int
    size: int
    entries: np.ndarray
    at: tuple[np.ndarray, np.ndarray, np.ndarray]
    lower: tuple[np.ndarray, np.ndarray]


class ConvexifiedHessian:
    """The Hessian with less negative curvature; ``row``, ``column`` of its blocks' lower triangles."""

    def __init__(self, nlp: Nlp) -> None:
        n = len(nlp.transcription.lower_x)
        ones = np.ones(len(nlp.hessian_row))
        graph = sparse.csr_matrix((ones, (nlp.hessian_row, nlp.hessian_column)), shape=(n, n))
        count, block = connected_components(graph, directed=False)
        sizes = np.bincount(block, minlength=count)
        order = np.argsort(block, kind="stable")  # variables by block, in their order
        first = np.cumsum(sizes) - sizes
        within = np.empty(n, dtype=np.int64)
        within[order] = np.arange(n) - first[block[order]]
        self._blocks, rows, columns = [], [], []
        for size in np.unique(sizes):
            members = np.flatnonzero(sizes == size)
            number = np.full(count, -1)
            number[members] = np.arange(len(members))
            entries = np.flatnonzero(number[block[nlp.hessian_row]] >= 0)
            i, j = nlp.hessian_row[entries], nlp.hessian_column[entries]
            lower = np.tril_indices(size)
            unknowns = order[first[members][:, None] + np.arange(size)]
            rows.append(unknowns[:, lower[0]].ravel())
            columns.append(unknowns[:, lower[1]].ravel())
            at = (number[block[i]], within[i], within[j])
            self._blocks.append(_Blocks(len(members), int(size), entries, at, lower))
        self.row, self.column = np.concatenate(rows), np.concatenate(columns)

    def values(self, hessian: np.ndarray, share: float) -> np.ndarray:
        """Nonzeros in the order of ``row``, ``column``, from those of the Hessian's lower triangle.

        ``share`` of the negative eigenvalues is removed: at 0 none, at 1 all of them.
        """
        parts = []
        for blocks in self._blocks:
            dense = np.zeros((blocks.count, blocks.size, blocks.size))
            dense[blocks.at] = hessian[blocks.entries]
            value, vectors = np.linalg.eigh(dense)  # reads the lower triangle alone
            value = np.maximum(value, (1 - share) * value)
            positive = (vectors * value[:, None, :]) @ vectors.transpose(0, 2, 1)
            parts.append(positive[:, blocks.lower[0], blocks.lower[1]].ravel())
        return np.concatenate(parts)


class ConvexificationShare:
    """The share of negative curvature removed from step to step: as little as the programs require."""

    def __init__(self) -> None:
        self.share = 0.0
        self._patience = self._failures = 0
        self._lowering = False

    def shares(self) -> Iterator[float]:
        """Shares to try in turn for one step: less than the last step needed, then more, up to all.

        After one that was too small the last is kept for some steps: a program without a solution is costly.
        """
        last, self._lowering = self.share, self._patience == 0
        if self._lowering:
            less = last / LESS
            self.share = less if less >= LEAST else 0.0
            yield self.share
            self._lowering = False
            self._failures = min(self._failures + 1, MOST_FAILURES)
            self._patience = 2**self._failures
        self._patience -= 1
        self.share = last
        if last > 0:
            yield last
        while self.share < 1.0:
            self.share = min(1.0, max(LEAST, MORE * self.share))
            yield self.share

    def was_enough(self) -> None:
        """The present share led to a step: if it was a smaller one, try one again next time."""
        if self._lowering:
            self._failures = 0
