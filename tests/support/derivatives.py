"""Derivatives of an NLP as sparse matrices, and their comparison with differences."""

from collections.abc import Sequence

import numpy as np
from numpy.testing import assert_allclose
from scipy import sparse

from trajopt.transcription.nlp import Nlp
from trajopt.transcription.transcription import Transcription

# Central differences along a direction, step 1e-5, on values of order up to 1e3 in scaled units.
STEP = 1e-5
DIFFERENCES = {"rtol": 2e-6, "atol": 2e-6}


class Matrices:
    """The engine's derivatives of an NLP as sparse matrices."""

    def __init__(self, nlp: Nlp) -> None:
        self.nlp, self.n = nlp, nlp.transcription.layout.n_unknowns

    def jacobian(self, x: np.ndarray) -> sparse.csr_matrix:
        return self.nlp.jacobian(x)

    def hessian(self, x: np.ndarray, sigma: float, multipliers: np.ndarray) -> sparse.csr_matrix:
        values = self.nlp.engine.hessian(x, sigma, multipliers)
        places = (self.nlp.hessian_row, self.nlp.hessian_column)
        lower = sparse.csr_matrix((values, places), shape=(self.n, self.n))
        return lower + sparse.tril(lower, -1).T

    def lagrangian_gradient(self, x: np.ndarray, sigma: float, multipliers: np.ndarray) -> np.ndarray:
        return sigma * self.nlp.engine.gradient(x) + self.jacobian(x).T @ multipliers


def random_unknowns(t: Transcription, seed: int) -> np.ndarray:
    generator = np.random.default_rng(seed)
    x = generator.uniform(-0.5, 0.5, t.layout.n_unknowns)
    for k, form in enumerate(t.layout.forms):
        for i in range(form.coordinates.n_rotations):
            x[t.layout.node(k)][4 * i : 4 * i + 4] += [0, 0, 0, 1]
    return x


def assert_derivatives(nlp: Nlp, seed: int, ones: Sequence[int] = ()) -> None:
    """At random unknowns, those at ``ones`` near one: a clock is positive."""
    generator = np.random.default_rng(seed + 100)
    matrices, engine, x = Matrices(nlp), nlp.engine, random_unknowns(nlp.transcription, seed)
    x[list(ones)] += 1.3
    along = generator.uniform(-1, 1, len(x))
    multipliers = generator.uniform(-1, 1, nlp.transcription.n_rows)
    before, after = x - STEP * along, x + STEP * along
    assert_allclose(
        engine.gradient(x) @ along, (engine.f(after) - engine.f(before)) / (2 * STEP), **DIFFERENCES
    )
    rows = (np.asarray(engine.g(after)) - np.asarray(engine.g(before))) / (2 * STEP)
    assert_allclose(matrices.jacobian(x) @ along, rows, **DIFFERENCES)
    slopes = [matrices.lagrangian_gradient(point, 0.7, multipliers) for point in (before, after)]
    curvature = matrices.hessian(x, 0.7, multipliers) @ along
    scale = np.max(np.abs(curvature))
    assert_allclose(curvature / scale, (slopes[1] - slopes[0]) / (2 * STEP * scale), **DIFFERENCES)
