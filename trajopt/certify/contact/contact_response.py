"""Response of contacts to wrenches in the metric of the mass matrix: ranks and minimum-norm solutions.

With M = L L^T, D the scale of the rows and B = L^-1 (D J)^T, wrenches D phi change velocity or acceleration
by x = L^-T B phi, and the contacts' motion by D J x = B^T B phi. The singular values of B are the square
roots of the eigenvalues of D J M^-1 J^T D; they separate independent from dependent rows with twice as many
digits.
"""

from dataclasses import dataclass

import numpy as np

from trajopt.certify.contact.contact_set import ContactSet
from trajopt.errors import InputError

# Singular values below this fraction of the largest count as zero: the square root of rounding, far above the
# error of exactly dependent rows (1e-15) and far below the effect of a useful lever arm.
RANK_TOLERANCE = 1e-8
# Smallest entry of the projector for dependent rows; coupled rows have entries of order one.
COUPLING = 1e-6
# Smallest reciprocal condition number for which B^T B is solved directly, losing at most half the digits.
# Below it, the singular values of B are used.
WELL_CONDITIONED = 1e-8


@dataclass(frozen=True, kw_only=True)
class DependentContactRow:
    """Linearly dependent ``rows``, the ``contacts`` they belong to, and the number of redundant ones."""

    rows: tuple[str, ...]
    contacts: tuple[str, ...]
    excess: int


@dataclass(frozen=True, kw_only=True)
class ContactRank:
    """Rank of the rows of a contact set at one configuration.

    Args:
        rows: Number of rows.
        jacobian: Rank of J.
        delassus: Rank of J M^-1 J^T (equal in exact arithmetic).
        condition: Largest over smallest nonzero singular value of J M^-1/2, angular rows times the arm.
        dependencies: Groups of rows with internal wrenches that move nothing, J^T f = 0.
    """

    rows: int
    jacobian: int
    delassus: int
    condition: float
    dependencies: tuple[DependentContactRow, ...]

    @property
    def redundant(self) -> bool:
        """Whether wrenches are not unique, so that those reported have minimum norm."""
        return self.delassus < self.rows

    def __str__(self) -> str:
        if not self.redundant:
            return f"{self.rows} independent contact rows (condition {self.condition:.1e})"
        groups = [f"{group.excess} too many among {', '.join(group.rows)}" for group in self.dependencies]
        return f"{self.rows} contact rows of rank {self.delassus}: " + "; ".join(groups)


@dataclass(frozen=True)
class ContactResponse:
    """``lower`` L (nv, nv) and ``whitened`` B (nv, n_rows) of contacts at a configuration.

    ``unit`` is the typical size of B's entries if a contact can move at all: the moment arm over the root of
    the largest inertia. Relative to it, a set whose rows all vanish to rounding has rank zero.
    """

    lower: np.ndarray
    whitened: np.ndarray
    unit: float

    def least(self, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the least x (nv,), in the metric of M, with D J x = ``wanted`` (n_rows,), and the least phi.

        If no x satisfies this, return the least-squares solution.
        """
        left, singular, right = np.linalg.svd(self.whitened, full_matrices=False)
        rank = numeric_rank(singular, self.unit)
        along = (right[:rank] @ wanted) / singular[:rank]
        return self._unwhitened(left[:, :rank] @ along), right[:rank].T @ (along / singular[:rank])

    def least_change(self, wanted: np.ndarray) -> np.ndarray:
        """Return only x of `least`, faster if B^T B is well conditioned; NaN if B is not finite."""
        gram = self.whitened.T @ self.whitened
        norm = float(np.abs(gram).sum(axis=0).max())
        if not np.isfinite(norm):
            return np.full(len(self.lower), np.nan)
        try:
            solved = np.linalg.solve(gram, np.column_stack([np.eye(len(gram)), wanted]))
        except np.linalg.LinAlgError:
            return self.least(wanted)[0]
        of_inverse = float(np.abs(solved[:, :-1]).sum(axis=0).max())
        if WELL_CONDITIONED * max(norm, self.unit**2) * of_inverse < 1.0:
            return self._unwhitened(self.whitened @ solved[:, -1])
        return self.least(wanted)[0]

    def _unwhitened(self, y: np.ndarray) -> np.ndarray:
        return np.linalg.solve(self.lower.T, y)


def mass_factor(mass: np.ndarray) -> np.ndarray:
    """Return L with M = L L^T from M's upper triangle; raises `InputError` unless M is positive definite."""
    lower = cholesky(mass.T)
    if lower is None:
        raise InputError("the mass matrix is not positive definite", "bodies with mass, or armature")
    return lower


def cholesky(matrix: np.ndarray) -> np.ndarray | None:
    """Return the Cholesky factor from a matrix's lower triangle; None unless it is positive definite."""
    try:
        return np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return None


def cholesky_solve(lower: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the solution x of L L^T x = ``right``."""
    return np.linalg.solve(lower.T, np.linalg.solve(lower, right))


def contact_response(lower: np.ndarray, contacts: ContactSet, jacobian: np.ndarray) -> ContactResponse:
    """Return the response of ``contacts`` with J (n_rows, nv) and M = L L^T."""
    unit = contacts.moment_arm / float(np.sqrt((lower * lower).sum(axis=1).max()))
    if not contacts.n_rows:
        return ContactResponse(lower, np.zeros((len(lower), 0)), unit)
    return ContactResponse(lower, np.linalg.solve(lower, (contacts.scale[:, None] * jacobian).T), unit)


def numeric_rank(singular: np.ndarray, unit: float) -> int:
    """Return the number of singular values above `RANK_TOLERANCE` times the largest, or times ``unit``."""
    return int(np.sum(singular > RANK_TOLERANCE * singular.max(initial=unit)))


def contact_rank(contacts: ContactSet, jacobian: np.ndarray, response: ContactResponse) -> ContactRank:
    """Return the rank report of ``contacts`` with J (n_rows, nv) and their response."""
    _, singular, right = np.linalg.svd(response.whitened)
    rank = numeric_rank(singular, response.unit)
    internal = right[rank:]
    plain = np.linalg.svd(contacts.scale[:, None] * jacobian, compute_uv=False)
    return ContactRank(
        rows=contacts.n_rows,
        jacobian=numeric_rank(plain, contacts.moment_arm),
        delassus=rank,
        condition=float(singular[0] / singular[rank - 1]) if rank else 1.0,
        dependencies=_dependencies(contacts, internal.T @ internal),
    )


def _dependencies(contacts: ContactSet, projector: np.ndarray) -> tuple[DependentContactRow, ...]:
    """Return the dependent rows: the blocks of the projector (n_rows, n_rows) onto internal wrenches."""
    coupled = np.abs(projector) > COUPLING
    owner = np.repeat(np.array(contacts.names, dtype=str), contacts.dimensions).tolist()
    remaining, dependent = set(np.flatnonzero(coupled.diagonal()).tolist()), []
    while remaining:
        group: set[int] = set()
        reached = {min(remaining)}
        while reached - group:
            group |= reached
            reached = set(np.flatnonzero(coupled[sorted(group)].any(axis=0)).tolist())
        rows = sorted(group)
        remaining -= group
        dependent.append(
            DependentContactRow(
                rows=tuple(contacts.row_names[row] for row in rows),
                contacts=tuple(dict.fromkeys(owner[row] for row in rows)),
                excess=round(float(projector[rows, rows].sum())),
            )
        )
    return tuple(dependent)
