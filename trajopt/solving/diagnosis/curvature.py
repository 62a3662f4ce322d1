"""Curvature of the Lagrangian on the null space of the active constraints.

With the Hessian H of the Lagrangian and the active rows A over the free variables, the second-order condition
requires p^T H p > 0 for all p != 0 with A p = 0. The eigenvalues of H on that null space near zero come from
Lanczos on the operator (shift and invert)

    p -> first block of [H - s I   A^T  ]^-1 [p]
                        [A      -beta I]     [0]

whose eigenvalues are 1 / (lambda - s), and those far from zero from Lanczos on P H P. P projects on the null
space by the same system with I in place of H - s I. Ritz values are quotients p^T H p / p^T p of vectors in
the null space up to rounding, so a negative one proves negative curvature. Its absence is proved only by the
dense decomposition of small problems. (Nocedal, Wright, "Numerical Optimization", 2006, ch. 12.5 and 16;
Parlett, "The Symmetric Eigenvalue Problem", ch. 13.)
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, sparse
from scipy.sparse import linalg as sparse_linalg

from trajopt.solving.diagnosis.rank import DENSE, RANK_TOLERANCE, quiet_factor

# Curvature below this fraction of the largest counts as zero: rounding of a Hessian in natural units, or a
# cost of negligible weight.
FLAT = 1e-8
BETA = 1e-14
# Number of Lanczos vectors, relative tolerance of eigenvalues, restarts; then number of eigenvalues sought.
VECTORS, ACCURACY, RESTARTS = 40, 1e-8, 30
EIGENVALUES = 16
# Singular values of the Ritz vectors below this fraction of the largest are rounding: vectors found twice.
COPY_SHARE = 1e-5
# An additional shift, between zero and the largest curvature, for eigenvalues that both other runs miss.
MIDDLE_SHIFT = -1e-2


@dataclass(frozen=True, kw_only=True, eq=False)
class Curvature:
    """Eigenvalues of the reduced Hessian, per squared unit of scaled variables.

    directions: number of free directions. values: (k,) eigenvalues found, ascending; a NaN if none could be
    found. vectors: (n, k) unit directions over the free variables; none for a NaN.
    exact: whether a dense decomposition found all of them.
    """

    directions: int
    values: np.ndarray
    vectors: np.ndarray
    exact: bool

    @property
    def smallest(self) -> float | None:
        """Smallest curvature, or None without free directions."""
        return float(self.values[0]) if len(self.values) else None

    @property
    def largest(self) -> float | None:
        """Largest curvature, or None without free directions."""
        return float(self.values[-1]) if len(self.values) else None

    @property
    def flat(self) -> float:
        """Magnitude below which curvature counts as zero."""
        return FLAT * max(abs(self.largest or 0.0), abs(self.smallest or 0.0))

    @property
    def negative(self) -> bool:
        """Whether a direction has negative curvature, so that the second-order necessary condition fails."""
        return self.smallest is not None and self.smallest < -self.flat

    @property
    def holds(self) -> bool:
        """Whether every free direction has positive curvature: the second-order sufficient condition."""
        return self.smallest is None or self.smallest > self.flat


def curvature(hessian: sparse.spmatrix, active: sparse.spmatrix) -> Curvature:
    """Return extreme eigenvalues of ``hessian`` (n, n) on the null space of ``active`` (m, n)."""
    full, rows = sparse.csc_matrix(hessian), sparse.csc_matrix(active)
    if min(rows.shape[1], rows.shape[0] + DENSE) <= DENSE or rows.shape[1] <= 2 * DENSE:
        return _dense(full.toarray(), rows.toarray())
    return _sparse(full, rows)


def _dense(hessian: np.ndarray, active: np.ndarray) -> Curvature:
    basis = linalg.null_space(active, rcond=RANK_TOLERANCE) if len(active) else np.eye(len(hessian))
    if basis.shape[1] == 0:
        return _none(len(hessian), exact=True)
    values, vectors = linalg.eigh(basis.T @ hessian @ basis)
    return Curvature(directions=len(values), values=values, vectors=basis @ vectors, exact=True)


def _none(n: int, *, exact: bool) -> Curvature:
    return Curvature(directions=0, values=np.zeros(0), vectors=np.zeros((n, 0)), exact=exact)


Operator = Callable[[np.ndarray], np.ndarray]


def _sparse(hessian: sparse.csc_matrix, active: sparse.csc_matrix) -> Curvature:
    m, n = active.shape
    unit = float(sparse.linalg.norm(hessian, np.inf)) or 1.0
    scaled = hessian / unit
    project = _operator(sparse.eye(n, format="csc"), active)
    if project is None:  # factorisation failed
        return replace(_none(n, exact=False), directions=max(0, n - m), values=np.array([np.nan]))
    start = project(np.random.default_rng(0).standard_normal(n))
    if np.linalg.norm(start) < np.sqrt(np.finfo(float).eps) * np.sqrt(n):
        return _none(n, exact=False)
    vectors = [lanczos(lambda p: project(scaled @ p), start)]
    for shift in (0.0, MIDDLE_SHIFT):
        inverse = _operator(scaled - shift * sparse.eye(n, format="csc"), active)
        if inverse is not None:
            vectors.append(lanczos(inverse, start))
    return _from_vectors(np.hstack(vectors), scaled, active, project, unit)


def _operator(first: sparse.csc_matrix, active: sparse.csc_matrix) -> Operator | None:
    m, n = active.shape
    factor = quiet_factor(sparse.bmat([[first, active.T], [active, -BETA * sparse.eye(m)]], format="csc"))
    if factor is None:
        return None
    rest = np.zeros(m)
    return lambda p: factor.solve(np.concatenate([p, rest]))[:n]


def lanczos(operator: Operator, start: np.ndarray) -> np.ndarray:
    """Return converged eigenvectors (n, k) of a symmetric operator at both ends of its spectrum."""
    n = len(start)
    symmetric = sparse_linalg.LinearOperator((n, n), matvec=operator, dtype=float)
    settings = {
        "which": "BE",
        "v0": start,
        "ncv": min(VECTORS, n),
        "tol": ACCURACY,
        "maxiter": RESTARTS,
    }
    try:
        return np.asarray(sparse_linalg.eigsh(symmetric, k=min(EIGENVALUES, n - 1), **settings)[1])
    except sparse_linalg.ArpackNoConvergence as error:
        return np.asarray(error.eigenvectors).reshape(n, -1)
    except sparse_linalg.ArpackError:
        return np.zeros((n, 0))


def _from_vectors(
    vectors: np.ndarray,
    hessian: sparse.csc_matrix,
    active: sparse.csc_matrix,
    project: Operator,
    unit: float,
) -> Curvature:
    """Apply Rayleigh-Ritz to the span of all vectors found, projected onto the null space again."""
    m, n = active.shape
    basis = _orthonormal(_orthonormal(vectors, project), project)
    small = basis.T @ (hessian @ basis)
    values, rotation = np.linalg.eigh((small + small.T) / 2)
    return Curvature(directions=max(0, n - m), values=values * unit, vectors=basis @ rotation, exact=False)


def _orthonormal(vectors: np.ndarray, project: Operator) -> np.ndarray:
    """Return an orthonormal basis of the projected vectors, without those that are only rounding."""
    inside = np.column_stack([project(column) for column in vectors.T])
    basis, values, _ = np.linalg.svd(inside, full_matrices=False)
    return basis[:, values > COPY_SHARE * values[0]]
