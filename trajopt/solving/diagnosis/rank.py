"""Rank, condition and dependent rows of sparse constraint Jacobians.

The smallest singular values of A (m, n) and their left vectors u, A^T u = sigma u', come from inverse
subspace iteration with a sparse LU factorisation of

    [alpha I   A^T  ]
    [A       -beta I]

Its Schur complement is -(A A^T / alpha + beta I), so one factorisation serves any number of vectors without
forming A A^T. A small alpha separates the values sigma^2 / alpha of independent rows from beta. The singular
values are those of A^T U for the basis U found (Rayleigh-Ritz), accurate to rounding. Small matrices use a
dense singular value decomposition. (Golub, Van Loan, "Matrix Computations", ch. 8 and 10.)
"""

import warnings
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import linalg as sparse_linalg

# Singular values below this fraction of the largest count as zero: scaled rows are dependent up to rounding,
# or up to the error of an iterate at a solver's tolerance.
RANK_TOLERANCE = 1e-8
# Up to this smaller dimension the decomposition is dense: exact, and at most a second.
DENSE = 400
ALPHA, BETA = 1e-6, 1e-13
# Initial and largest subspace dimension; it doubles until the subspace has a nonzero singular value.
FIRST_SIZE, LAST_SIZE = 8, 256
ITERATIONS, ACCURACY = 12, 1e-3
# Projector entries, relative to the rows' shares, above which two rows depend on each other.
COUPLING = 1e-2
# Digits of shares that are compared, so that rounding does not decide the order of two rows.
SHARE_DIGITS = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class Spectrum:
    """Singular values of a matrix with m rows.

    largest, smallest: extreme nonzero singular values (smallest: None if all are zero). nullity: number of
    redundant rows, or a lower bound of it unless ``complete``. vectors: (m, k) orthonormal basis of the left
    null space found.
    """

    rows: int
    largest: float
    smallest: float | None
    nullity: int
    vectors: np.ndarray
    complete: bool = True

    @property
    def rank(self) -> int:
        """Number of independent rows."""
        return self.rows - self.nullity

    @property
    def condition(self) -> float | None:
        """Largest over smallest nonzero singular value."""
        return None if self.smallest is None else self.largest / self.smallest


@dataclass(frozen=True, kw_only=True, eq=False)
class RowDependency:
    """Rows that depend on each other, largest share first, and the number of redundant ones."""

    rows: np.ndarray
    excess: int


def spectrum(matrix: sparse.spmatrix) -> Spectrum:
    """Return the smallest and largest singular values of a sparse matrix (m, n)."""
    csr = sparse.csr_matrix(matrix)
    return _dense(csr) if min(csr.shape) <= DENSE else _sparse(csr)


def _dense(matrix: sparse.csr_matrix) -> Spectrum:
    m, n = matrix.shape
    left, values, _ = np.linalg.svd(matrix.toarray(), full_matrices=m > n)
    values = np.concatenate([values, np.zeros(max(0, m - n))])
    return _found(values, left, float(values.max(initial=0.0)))


def _found(values: np.ndarray, vectors: np.ndarray, largest: float, *, complete: bool = True) -> Spectrum:
    """Build the spectrum from singular values (k,), including the smallest, and left vectors (m, k)."""
    zero = values <= RANK_TOLERANCE * largest
    return Spectrum(
        rows=len(vectors),
        largest=largest,
        smallest=None if zero.all() else float(values[~zero].min()),
        nullity=int(zero.sum()),
        vectors=vectors[:, zero],
        complete=complete,
    )


def _sparse(matrix: sparse.csr_matrix) -> Spectrum:
    m, n = matrix.shape
    csc = sparse.csc_matrix(matrix)
    largest = float(sparse_linalg.svds(csc, k=1, return_singular_vectors=False, random_state=0)[0])
    scaled = csc / largest
    alpha, beta = sparse.eye(n) * ALPHA, sparse.eye(m) * BETA
    factor = sparse_linalg.splu(sparse.bmat([[alpha, scaled.T], [scaled, -beta]], format="csc"))
    size, limit = (
        min(m, max(FIRST_SIZE, m - n + FIRST_SIZE)),
        min(m, max(LAST_SIZE, m - n + FIRST_SIZE)),
    )
    basis = np.zeros((m, 0))
    while True:
        generator = np.random.default_rng(basis.shape[1])
        fresh = generator.standard_normal((m, size - basis.shape[1]))
        basis = np.linalg.qr(np.hstack([basis, fresh]))[0]
        values, basis = _iterated(factor, scaled, basis)
        zero = values <= RANK_TOLERANCE
        if not zero.all() or size >= limit:
            break
        size = min(2 * size, limit)
    return _found(largest * values, basis, largest, complete=not zero.all() or size == m)


def _iterated(
    factor: sparse_linalg.SuperLU, matrix: sparse.csc_matrix, basis: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Iterate until the smallest singular value settles; return ascending values and their left vectors."""
    n = matrix.shape[1]
    values = np.full(basis.shape[1], np.inf)
    for _ in range(ITERATIONS):
        solved = factor.solve(np.vstack([np.zeros((n, basis.shape[1])), basis]))[n:]
        basis = np.linalg.qr(solved)[0]
        _, singular, right = np.linalg.svd(matrix.T @ basis, full_matrices=False)
        basis, singular = basis @ right[::-1].T, singular[::-1]
        first = int(np.argmax(singular > RANK_TOLERANCE))
        settled = abs(singular[first] - values[first]) <= ACCURACY * singular[first]
        values = singular
        if settled or singular[-1] <= RANK_TOLERANCE:
            break
    return values, basis


def dependencies(vectors: np.ndarray) -> list[RowDependency]:
    """Return groups of rows that depend on each other, given a basis (m, k) of their left null space.

    The basis V is orthonormal; the projector V V^T does not depend on its choice and does not couple rows of
    different groups. Its diagonal is each row's share, and adds up to the number of redundant rows.
    """
    if vectors.shape[1] == 0:
        return []
    share = np.einsum("ij,ij->i", vectors, vectors)
    members = np.flatnonzero(share > COUPLING)
    inner = vectors[members] @ vectors[members].T
    scale = np.sqrt(np.outer(share[members], share[members]))
    count, which = sparse.csgraph.connected_components(
        sparse.csr_matrix(np.abs(inner) > COUPLING * scale), directed=False
    )
    groups = []
    for group in range(count):
        rows = members[which == group]
        order = np.lexsort((rows, -np.round(share[rows], SHARE_DIGITS)))
        excess = max(1, round(float(share[rows].sum())))
        groups.append(RowDependency(rows=rows[order], excess=excess))
    return groups


def quiet_factor(matrix: sparse.csc_matrix) -> sparse_linalg.SuperLU | None:
    """Return a sparse LU factorisation, or None if the matrix is singular to rounding."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return sparse_linalg.splu(matrix)
        except RuntimeError:
            return None
