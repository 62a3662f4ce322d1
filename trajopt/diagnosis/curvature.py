"""Curvature of the Lagrangian on the null space of the active constraints.

With H the Hessian of the Lagrangian and A the active rows over the free variables, the second-order condition
asks p^T H p > 0 for all p with A p = 0. Eigenvalues of H on that null space near zero come from Lanczos on

    p -> first block of [H - s I   A^T   ]^-1 [p]        (shift and invert)
                        [A         -beta I]   [0]

whose eigenvalues are 1 / (lambda - s), and those far from it from Lanczos on P H P, P the projector on the
null space by the same system with H - s I replaced by I. Ritz values are quotients p^T H p / p^T p of vectors
that are in the null space to rounding: a negative one proves negative curvature. Finding none proves its
absence only as far as Lanczos goes; small problems take a dense decomposition, which is a proof. (Nocedal,
Wright, "Numerical Optimization", 2006, ch. 12.5 and 16; Parlett, "The Symmetric Eigenvalue Problem", ch. 13.)
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, sparse
from scipy.sparse import linalg as sparse_linalg

from trajopt.diagnosis.rank import DENSE, RANK_TOLERANCE, quiet_factor

# Curvature below this part of the largest counts as zero: rounding of a Hessian in natural units, or
# a cost of negligible weight.
FLAT = 1e-8
BETA = 1e-14
# Lanczos vectors, relative error at which an eigenvalue has converged, restarts; eigenvalues sought.
STEPS, CONVERGED, RESTARTS = 40, 1e-8, 30
SOUGHT = 16
# Ritz vectors of different runs that differ by less than this are the same up to rounding.
DISTINCT = 1e-5
# One more shift, between flat and largest curvature, finds what runs at both ends miss.
BETWEEN = -1e-2


@dataclass(frozen=True, kw_only=True, eq=False)
class Curvature:
    """Eigenvalues of the reduced Hessian, per unit of scaled variables squared.

    directions: number of free directions. values (k,), vectors (n, k): those found, ascending, with unit
    directions over the free variables; where nothing could be found, a NaN without a direction. exact: all of
    them, by a dense decomposition.
    """

    directions: int
    values: np.ndarray
    vectors: np.ndarray
    exact: bool

    @property
    def smallest(self) -> float | None:
        """Least curvature, None where there is no free direction."""
        return float(self.values[0]) if len(self.values) else None

    @property
    def largest(self) -> float | None:
        """Largest curvature, None where there is no free direction."""
        return float(self.values[-1]) if len(self.values) else None

    @property
    def flat(self) -> float:
        """Curvature below this magnitude counts as zero."""
        return FLAT * max(abs(self.largest or 0.0), abs(self.smallest or 0.0))

    @property
    def negative(self) -> bool:
        """Whether some direction has negative curvature: the second-order condition does not hold."""
        return self.smallest is not None and self.smallest < -self.flat

    @property
    def holds(self) -> bool:
        """Whether every free direction has positive curvature: the second-order sufficient condition."""
        return self.smallest is None or self.smallest > self.flat


def curvature(hessian: sparse.spmatrix, active: sparse.spmatrix) -> Curvature:
    """Smallest eigenvalues of ``hessian`` (n, n) on the null space of ``active`` (m, n)."""
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
    if project is None:  # the factorisation of the rows fails: no result
        return replace(_none(n, exact=False), directions=max(0, n - m), values=np.array([np.nan]))
    start = project(np.random.default_rng(0).standard_normal(n))
    if np.linalg.norm(start) < np.sqrt(np.finfo(float).eps) * np.sqrt(n):
        return _none(n, exact=False)
    vectors = [lanczos(lambda p: project(scaled @ p), start)]
    for shift in (0.0, BETWEEN):
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
    """Eigenvectors (n, k) of a symmetric operator at both ends of its spectrum, those that converge."""
    n = len(start)
    symmetric = sparse_linalg.LinearOperator((n, n), matvec=operator, dtype=float)
    settings = {"which": "BE", "v0": start, "ncv": min(STEPS, n), "tol": CONVERGED, "maxiter": RESTARTS}
    try:
        return np.asarray(sparse_linalg.eigsh(symmetric, k=min(SOUGHT, n - 1), **settings)[1])
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
    """Rayleigh-Ritz on the span of all vectors found, projected onto the null space again."""
    m, n = active.shape
    basis = _orthonormal(_orthonormal(vectors, project), project)
    small = basis.T @ (hessian @ basis)
    values, rotation = np.linalg.eigh((small + small.T) / 2)
    return Curvature(directions=max(0, n - m), values=values * unit, vectors=basis @ rotation, exact=False)


def _orthonormal(vectors: np.ndarray, project: Operator) -> np.ndarray:
    """Orthonormal basis of the projected vectors, without vectors that are only rounding."""
    inside = np.column_stack([project(column) for column in vectors.T])
    basis, values, _ = np.linalg.svd(inside, full_matrices=False)
    return basis[:, values > DISTINCT * values[0]]
