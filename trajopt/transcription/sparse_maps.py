"""Constant sparse matrices and maps of derivatives through z = G xi: built once, applied by the engine.

For every stage, the engine computes target_t = sum_e coefficient_e * nonzero[source_e] over the entries e of
t. This maps nonzeros of a point function's derivatives to nonzeros of the NLP's matrices.
"""

from dataclasses import dataclass

import numpy as np

# Rows and columns of nonzeros.
Pattern = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class SparseMatrix:
    """A matrix of ``shape`` in compressed sparse row format; SciPy's class is slow to import.

    Row i holds ``data`` from ``indptr[i]`` to ``indptr[i + 1]``, in ascending columns ``indices``.
    """

    shape: tuple[int, int]
    indptr: np.ndarray
    indices: np.ndarray
    data: np.ndarray

    @classmethod
    def of_entries(
        cls, shape: tuple[int, int], row: np.ndarray, column: np.ndarray, value: np.ndarray
    ) -> "SparseMatrix":
        """Sum of entries given in any order; zeros are kept."""
        key = row.astype(np.int64) * shape[1] + column
        order = np.argsort(key, kind="stable")
        key = key[order]
        first = np.flatnonzero(np.diff(key, prepend=-1))
        of_row, of_column = np.divmod(key[first], max(shape[1], 1))
        data = np.add.reduceat(value[order], first) if len(first) else np.zeros(0)
        counts = np.bincount(of_row, minlength=shape[0])
        indptr = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        return cls(shape, indptr, of_column.astype(np.int32), data)

    @classmethod
    def of(cls, matrix: np.ndarray) -> "SparseMatrix":
        """Sparse form of a dense matrix."""
        row, column = np.nonzero(matrix)
        indptr = np.searchsorted(row, np.arange(len(matrix) + 1)).astype(np.int32)
        return cls(matrix.shape, indptr, column.astype(np.int32), matrix[row, column])

    @property
    def row(self) -> np.ndarray:
        """Row of every entry."""
        return np.repeat(np.arange(self.shape[0], dtype=np.int32), np.diff(self.indptr))

    def toarray(self) -> np.ndarray:
        """The matrix, dense."""
        dense = np.zeros(self.shape)
        dense[self.row, self.indices] = self.data
        return dense


@dataclass(frozen=True)
class DerivativeMap:
    """Targets (row, column) in local indices, with their sources and coefficients in CSR format."""

    row: np.ndarray
    column: np.ndarray
    indptr: np.ndarray
    source: np.ndarray
    coefficient: np.ndarray


def _expand(matrix: SparseMatrix, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Entries of the listed rows: (position in the list, column, value)."""
    counts = np.diff(matrix.indptr)[rows]
    which = np.repeat(np.arange(len(rows)), counts)
    start = np.repeat(matrix.indptr[rows], counts)
    within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    entry = start + within
    return which, matrix.indices[entry], matrix.data[entry]


def _collect(
    row: np.ndarray, column: np.ndarray, source: np.ndarray, coefficient: np.ndarray, width: int
) -> DerivativeMap:
    if not len(source):
        none = np.zeros(0, dtype=np.int32)
        return DerivativeMap(none, none, np.zeros(1, dtype=np.int32), none, np.zeros(0))
    target = row.astype(np.int64) * width + column
    order = np.lexsort((source, target))
    target, source = target[order], source[order]
    new_target = np.diff(target, prepend=-1) != 0
    new_entry = new_target | (np.diff(source, prepend=-1) != 0)
    first = np.flatnonzero(new_target)
    return DerivativeMap(
        (target[first] // width).astype(np.int32),
        (target[first] % width).astype(np.int32),
        np.append(np.cumsum(new_entry)[first] - 1, new_entry.sum()).astype(np.int32),
        source[new_entry].astype(np.int32),
        np.add.reduceat(coefficient[order], np.flatnonzero(new_entry)),
    )


def jacobian_map(pattern: Pattern, gather: SparseMatrix, row_scale: np.ndarray) -> DerivativeMap:
    """Map from d phi / dz, with nonzeros ``pattern``, to scaled rows over the window's variables."""
    rows, columns = (part.astype(np.int64) for part in pattern)
    which, unknown, value = _expand(gather, columns)
    return _collect(rows[which], unknown, which, value * row_scale[rows[which]], gather.shape[1])


def hessian_map(pattern: Pattern, gather: SparseMatrix) -> DerivativeMap:
    """Map from the lower triangle of d2 gamma / dz2 to that over the window's variables."""
    lower = [part.astype(np.int64) for part in pattern]
    off_diagonal = np.flatnonzero(lower[0] != lower[1])
    i = np.concatenate([lower[0], lower[1][off_diagonal]])
    j = np.concatenate([lower[1], lower[0][off_diagonal]])
    source = np.concatenate([np.arange(len(lower[0])), off_diagonal])
    first, m, left = _expand(gather, i)
    second, n, right = _expand(gather, j[first])
    m, source = m[second], source[first[second]]
    keep = m >= n
    return _collect(m[keep], n[keep], source[keep], (left[second] * right)[keep], gather.shape[1])
