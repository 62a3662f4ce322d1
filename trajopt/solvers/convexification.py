"""A Hessian without negative curvature, for programs that cannot be solved with the exact one.

The Hessian is block diagonal: no function of the NLP depends on unknowns of two stages. Every block's
eigenvalues are replaced by their magnitudes, so that a direction of negative curvature is left at the
speed of one as strongly curved upwards (Dauphin et al., "Identifying and attacking the saddle point problem
in high-dimensional non-convex optimization", NeurIPS 2014).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from trajopt.nlp import Nlp


@dataclass(frozen=True)
class _Blocks:
    """Blocks of one size: places of the Hessian's nonzeros in them, and of their lower triangles outside.

    ``entries`` are nonzeros of the Hessian, ``at`` (block, row, column) of each; ``lower`` (row, column) of
    a block's lower triangle.
    """

    count: int
    size: int
    entries: np.ndarray
    at: tuple[np.ndarray, np.ndarray, np.ndarray]
    lower: tuple[np.ndarray, np.ndarray]


class Convexified:
    """The Hessian's blocks with the magnitudes of their eigenvalues; ``row``, ``column`` of all nonzeros."""

    def __init__(self, nlp: Nlp) -> None:
        n = len(nlp.transcription.lower_x)
        ones = np.ones(len(nlp.hessian_row))
        graph = sparse.csr_matrix((ones, (nlp.hessian_row, nlp.hessian_column)), shape=(n, n))
        count, block = connected_components(graph, directed=False)
        sizes = np.bincount(block, minlength=count)
        order = np.argsort(block, kind="stable")  # unknowns by block, in their order
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

        ``share`` of the negative eigenvalues is taken away: 0 is the Hessian as it is, 1 is none.
        """
        parts = []
        for blocks in self._blocks:
            dense = np.zeros((blocks.count, blocks.size, blocks.size))
            dense[blocks.at] = hessian[blocks.entries]
            value, vectors = np.linalg.eigh(dense)  # reads the lower triangle alone
            value = np.maximum(value, (1 - share) * value)
            found = (vectors * value[:, None, :]) @ vectors.transpose(0, 2, 1)
            parts.append(found[:, blocks.lower[0], blocks.lower[1]].ravel())
        return np.concatenate(parts)
