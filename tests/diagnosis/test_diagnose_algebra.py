"""Ranks, dependent rows and reduced curvature of sparse matrices, against dense decompositions."""

import numpy as np
import pytest
from scipy import linalg, sparse

from trajopt.diagnosis import curvature as curving
from trajopt.diagnosis import rank
from trajopt.diagnosis.curvature import curvature, lanczos
from trajopt.diagnosis.rank import dependencies, spectrum

# The largest singular value against LAPACK's, relative; the smallest is iterated as far as it is told to.
SAME = 1e-6
# Smallest curvature by Lanczos, relative: 40 steps of a well-separated spectrum.
CURVATURE = 1e-4
# What a null vector leaves: rounding of a well-scaled matrix.
NULL = 1e-9


def banded(m: int, n: int, seed: int) -> sparse.csr_matrix:
    """Random rows over a sliding window of columns, as collocation makes them."""
    generator = np.random.default_rng(seed)
    dense = np.zeros((m, n))
    width = 30
    for row in range(m):
        start = int((n - width) * row / m)
        dense[row, start : start + width] = generator.standard_normal(width)
    return sparse.csr_matrix(dense)


def with_copies(matrix: sparse.csr_matrix) -> tuple[sparse.csr_matrix, list[set[int]]]:
    """The matrix with a copy of row 3, the sum of rows 10 and 20, and twice row 200; the groups they make."""
    m = matrix.shape[0]
    extra = [matrix[3], matrix[10] + matrix[20], 2 * matrix[200]]
    return sparse.vstack([matrix, *extra], format="csr"), [{3, m}, {10, 20, m + 1}, {200, m + 2}]


def test_the_sparse_spectrum_is_that_of_lapack():
    matrix = banded(450, 600, 0)
    found = rank._sparse(matrix)
    values = np.linalg.svd(matrix.toarray(), compute_uv=False)
    assert (found.rank, found.nullity, found.complete) == (450, 0, True)
    assert found.largest == pytest.approx(values[0], rel=SAME)
    assert found.smallest == pytest.approx(values[-1], rel=rank.ACCURACY)
    assert found.condition == pytest.approx(values[0] / values[-1], rel=rank.ACCURACY)


@pytest.mark.parametrize("method", [rank._sparse, rank._dense])
def test_dependent_rows_are_counted_and_grouped(method):
    matrix, groups = with_copies(banded(420, 600, 1))
    found = method(matrix)
    assert (found.rows, found.rank, found.nullity) == (423, 420, 3)
    assert np.abs(matrix.T @ found.vectors).max() < NULL
    assert {frozenset(group.rows.tolist()) for group in dependencies(found.vectors)} == {
        frozenset(group) for group in groups
    }
    assert [group.excess for group in dependencies(found.vectors)] == [1, 1, 1]


def test_more_dependent_rows_than_the_first_subspace_holds_are_all_found():
    matrix = banded(430, 900, 2)
    copies = 3 * rank.FIRST_SIZE
    found = rank._sparse(sparse.vstack([matrix, matrix[:copies]], format="csr"))
    assert (found.nullity, found.complete) == (copies, True)
    assert found.rank == 430


def test_more_rows_than_columns_are_too_many_by_the_difference():
    found = rank._sparse(banded(460, 440, 3))
    assert found.nullity >= 20
    assert found.rank == np.linalg.matrix_rank(banded(460, 440, 3).toarray(), tol=1e-8 * found.largest)


def test_small_and_empty_matrices_have_a_spectrum():
    nothing = spectrum(sparse.csr_matrix((0, 5)))
    assert (nothing.rank, nothing.condition) == (0, None)
    ones = spectrum(sparse.csr_matrix(np.ones((3, 2))))
    assert (ones.rank, ones.nullity) == (1, 2)
    zeros = spectrum(sparse.csr_matrix((2, 4)))
    assert (zeros.rank, zeros.nullity, zeros.condition) == (0, 2, None)


def quadratic(n: int, m: int, eigenvalues: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A Hessian (n, n) whose eigenvalues on the null space of rows (m, n) are the given ones (n - m,)."""
    generator = np.random.default_rng(seed)
    basis = linalg.qr(generator.standard_normal((n, n)))[0]
    free, held = basis[:, : n - m], basis[:, n - m :]
    cross = generator.standard_normal((n - m, m))
    hessian = free @ np.diag(eigenvalues) @ free.T - held @ held.T + free @ cross @ held.T
    hessian = (hessian + hessian.T) - (free @ np.diag(eigenvalues) @ free.T - held @ held.T)
    return hessian, generator.standard_normal((m, m)) @ held.T


@pytest.mark.parametrize("method", [curving._dense, None])
@pytest.mark.parametrize(
    ("values", "holds", "negative"),
    [([0.5, 2.0, 3.0], True, False), ([-0.1, 1.0, 2.0], False, True), ([0.0, 1.0, 4.0], False, False)],
)
def test_curvature_of_a_quadratic_problem_is_the_one_it_was_made_with(method, values, holds, negative):
    hessian, rows = quadratic(5, 2, np.array(values), 4)
    if method is None:
        found = curvature(sparse.csr_matrix(hessian), sparse.csr_matrix(rows))
    else:
        found = method(hessian, rows)
    assert found.directions == 3
    assert found.exact
    assert found.values == pytest.approx(np.sort(values), abs=NULL)
    assert (found.holds, found.negative) == (holds, negative)
    assert np.abs(rows @ found.vectors).max() < NULL


@pytest.mark.parametrize("lowest", [1e-3, -1e-3, -0.3])
def test_curvature_by_lanczos_is_that_of_a_dense_decomposition(lowest):
    n, m = 160, 60
    spread = np.concatenate([[lowest], np.geomspace(2e-3, 1.0, n - m - 1)])
    hessian, rows = quadratic(n, m, spread, 5)
    found = curving._sparse(sparse.csc_matrix(hessian), sparse.csc_matrix(rows))
    exact = curving._dense(hessian, rows)
    assert exact.smallest == pytest.approx(lowest, abs=NULL)
    assert found.smallest == pytest.approx(lowest, rel=CURVATURE)
    assert found.largest == pytest.approx(1.0, rel=1e-2)
    assert (found.directions, found.negative) == (n - m, lowest < 0)
    assert np.abs(rows @ found.vectors).max() < NULL
    assert abs(found.vectors[:, 0] @ exact.vectors[:, 0]) == pytest.approx(1.0, abs=1e-3)


def test_no_free_direction_leaves_no_curvature():
    found = curvature(sparse.eye(4), sparse.eye(4))
    assert (found.directions, found.smallest, found.holds) == (0, None, True)


def test_lanczos_finds_both_ends_of_a_spectrum():
    diagonal = np.concatenate([[-5.0], np.linspace(1.0, 2.0, 200), [9.0]])
    vectors = lanczos(lambda p: diagonal * p, np.ones(len(diagonal)))
    quotients = np.einsum("ij,i,ij->j", vectors, diagonal, vectors)
    assert quotients.min() == pytest.approx(-5.0)
    assert quotients.max() == pytest.approx(9.0)
