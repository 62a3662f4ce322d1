"""Maps of derivatives through z = G xi against dense matrix products."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse

from trajopt.transcription.sparse_maps import (
    DerivativeMap,
    Pattern,
    SparseMatrix,
    hessian_map,
    jacobian_map,
)

# Sums of a few products of numbers of order one.
ROUNDING = 1e-13
N_Z, N_WINDOW, N_ROWS = 9, 7, 5


def random_gather(generator: np.random.Generator) -> SparseMatrix:
    dense = generator.uniform(-1, 1, (N_Z, N_WINDOW)) * (generator.uniform(size=(N_Z, N_WINDOW)) < 0.4)
    dense[3] = 0.0  # an input that depends on nothing
    return SparseMatrix.of(dense)


def random_matrix(generator: np.random.Generator, rows: int, density: float) -> tuple[Pattern, np.ndarray]:
    """A pattern and a dense matrix that is zero outside it."""
    present = generator.uniform(size=(rows, N_Z)) < density
    return np.nonzero(present), generator.uniform(-1, 1, (rows, N_Z)) * present


def nonzeros(pattern: Pattern, dense: np.ndarray) -> np.ndarray:
    return dense[pattern]


def applied(found: DerivativeMap, values: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """What the engine computes from a map: each target a sum of coefficients times nonzeros."""
    dense = np.zeros(shape)
    for target, (row, column) in enumerate(zip(found.row, found.column, strict=True)):
        entries = slice(found.indptr[target], found.indptr[target + 1])
        dense[row, column] += found.coefficient[entries] @ values[found.source[entries]]
    return dense


@pytest.mark.parametrize("density", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_jacobian_map_is_the_scaled_product_with_the_gather_matrix(seed, density):
    generator = np.random.default_rng(seed)
    gather, (pattern, dense) = random_gather(generator), random_matrix(generator, N_ROWS, density)
    scale = generator.uniform(0.1, 2, N_ROWS)
    found = jacobian_map(pattern, gather, scale)
    expected = scale[:, None] * dense @ gather.toarray()
    assert_allclose(applied(found, nonzeros(pattern, dense), expected.shape), expected, atol=ROUNDING)


@pytest.mark.parametrize("density", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_hessian_map_is_the_lower_triangle_of_the_congruence(seed, density):
    generator = np.random.default_rng(seed)
    gather, (_, dense) = random_gather(generator), random_matrix(generator, N_Z, density)
    lower = np.tril(dense)
    pattern = np.nonzero(lower)
    found = hessian_map(pattern, gather)
    symmetric = lower + np.tril(lower, -1).T
    expected = np.tril(gather.toarray().T @ symmetric @ gather.toarray())
    assert_allclose(applied(found, nonzeros(pattern, lower), expected.shape), expected, atol=ROUNDING)
    assert np.all(found.row >= found.column)


@pytest.mark.parametrize("count", [0, 1, 40])
def test_matrices_are_scipys(count):
    """Entries at one place are added; those that are zero are kept."""
    generator = np.random.default_rng(3)
    row, column = generator.integers(0, N_ROWS, count), generator.integers(0, N_Z, count)
    value = generator.uniform(-1, 1, count) * (generator.uniform(size=count) < 0.8)
    expected = sparse.csr_matrix((value, (row, column)), shape=(N_ROWS, N_Z))
    found = SparseMatrix.of_entries((N_ROWS, N_Z), row, column, value)
    for made, scipys in ((found, expected), (SparseMatrix.of(found.toarray()), expected)):
        if made is not found:
            scipys.eliminate_zeros()
        assert_array_equal(made.indptr, scipys.indptr)
        assert_array_equal(made.indices, scipys.indices)
        assert_allclose(made.data, scipys.data, atol=ROUNDING)
        assert_array_equal(made.row, scipys.tocoo().row)
    assert_allclose(found.toarray(), expected.toarray(), atol=ROUNDING)


def test_every_target_of_a_map_is_named_once():
    generator = np.random.default_rng(2)
    gather, (pattern, _) = random_gather(generator), random_matrix(generator, N_ROWS, 0.5)
    found = jacobian_map(pattern, gather, np.ones(N_ROWS))
    places = np.stack([found.row, found.column])
    assert np.unique(places, axis=1).shape == places.shape
    assert np.all(np.diff(found.indptr) > 0)
