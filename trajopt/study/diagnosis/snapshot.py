"""An NLP at one iterate: values, derivatives, multipliers, and which rows and bounds are active."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from trajopt.study.diagnosis.names import NlpNames
from trajopt.transcription.nlp import Nlp
from trajopt.transcription.transcription import Transcription
from trajopt.transcription.violations import row_violations

# A limit this close to its bound is reached, in natural units: interior-point iterates at the solvers'
# tolerance of 1e-6 come that close, and a thousandth of a per cent of a limit is no reserve.
REACHED = 1e-5
# Slack and multiplier of a limit fall together to the root of the barrier where it is weakly active; a limit
# is strictly active where its multiplier is this many times its slack.
STRICT = 10.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Snapshot:
    """An NLP at scaled unknowns ``x`` (n_unknowns,).

    ``row_multiplier`` (n_rows,), ``bound_multiplier`` (n_unknowns,): of the Lagrangian
    f + row . g + bound . x; None where nothing is known of them. ``tolerance``: of the solve.
    ``equations_only``: limits are left out of the active rows, as far from feasible points, where those that
    an iterate happens to pass say nothing.
    """

    nlp: Nlp
    x: np.ndarray
    row_multiplier: np.ndarray | None = None
    bound_multiplier: np.ndarray | None = None
    tolerance: float = 1e-6
    equations_only: bool = False

    @property
    def transcription(self) -> Transcription:
        """Structure of the NLP."""
        return self.nlp.transcription

    @cached_property
    def names(self) -> NlpNames:
        """Unknowns and rows in words."""
        t = self.transcription
        return NlpNames(t, t.layout.times(self.x * t.scale), self._slopes)

    def _slopes(self, row: int) -> tuple[np.ndarray, np.ndarray]:
        own = slice(self.jacobian.indptr[row], self.jacobian.indptr[row + 1])
        return self.jacobian.indices[own], self.jacobian.data[own]

    @cached_property
    def finite(self) -> bool:
        """Whether all values and derivatives are finite."""
        return bool(np.isfinite(self.x).all()) and self.nlp.engine.first_nonfinite(self.x) is None

    @cached_property
    def g(self) -> np.ndarray:
        """Values of the rows."""
        return np.asarray(self.nlp.engine.g(self.x)).copy()

    @cached_property
    def violations(self) -> np.ndarray:
        """Of rows, then of bounds (n_rows + n_unknowns,)."""
        return row_violations(self.nlp, self.x)

    @cached_property
    def gradient(self) -> np.ndarray:
        """Of the objective (n_unknowns,)."""
        return np.asarray(self.nlp.engine.gradient(self.x)).copy()

    @cached_property
    def jacobian(self) -> sparse.csr_matrix:
        """Of the rows (n_rows, n_unknowns)."""
        values = np.asarray(self.nlp.engine.jacobian(self.x)).copy()
        shape = (self.transcription.n_rows, len(self.x))
        return sparse.csr_matrix((values, (self.nlp.row, self.nlp.column)), shape=shape)

    @cached_property
    def hessian(self) -> sparse.csr_matrix:
        """Of the Lagrangian; of the objective alone where no multipliers are known."""
        known = np.zeros(self.transcription.n_rows) if self.row_multiplier is None else self.row_multiplier
        values = np.asarray(self.nlp.engine.hessian(self.x, 1.0, known)).copy()
        place = (self.nlp.hessian_row, self.nlp.hessian_column)
        lower = sparse.csr_matrix((values, place), shape=(len(self.x),) * 2)
        return (lower + sparse.tril(lower, -1).T).tocsr()

    @cached_property
    def stationarity(self) -> float | None:
        """Largest entry of the Lagrangian's gradient, scaled units; None without multipliers."""
        if self.row_multiplier is None or self.bound_multiplier is None:
            return None
        residual = self.gradient + self.jacobian.T @ self.row_multiplier + self.bound_multiplier
        return float(np.abs(residual).max(initial=0.0))

    @cached_property
    def complementarity(self) -> float:
        """Largest product of a row's multiplier and its slack at the bound that its sign names."""
        if self.row_multiplier is None:
            return 0.0
        t = self.transcription
        slack = np.where(self.row_multiplier > 0, t.upper_g - self.g, self.g - t.lower_g)
        seen = np.isfinite(slack) & (self.row_multiplier != 0)
        return float(np.abs(slack[seen] * self.row_multiplier[seen]).max(initial=0.0))

    # Activity

    @cached_property
    def equality(self) -> np.ndarray:
        """Rows that are equations (n_rows,)."""
        t = self.transcription
        return t.lower_g == t.upper_g

    @cached_property
    def fixed(self) -> np.ndarray:
        """Unknowns that are fixed (n_unknowns,)."""
        t = self.transcription
        return t.lower_x == t.upper_x

    @cached_property
    def row_side(self) -> np.ndarray:
        """Of every row: -1 at its lower bound, 1 at its upper one, 0 within; of equations 0 too."""
        t = self.transcription
        side = _side(self.g, t.lower_g, t.upper_g, self.row_multiplier, self.tolerance)
        return np.where(self.equality, 0, side)

    @cached_property
    def bound_side(self) -> np.ndarray:
        """Of every unknown: at which bound it is; of fixed ones 0."""
        t = self.transcription
        side = _side(self.x, t.lower_x, t.upper_x, self.bound_multiplier, self.tolerance)
        return np.where(self.fixed, 0, side)

    @property
    def active_rows(self) -> np.ndarray:
        """Rows that are equations or at a bound, sorted."""
        return np.flatnonzero(self.equality | ((self.row_side != 0) & (not self.equations_only)))

    @property
    def free(self) -> np.ndarray:
        """Unknowns that are neither fixed nor at a bound, sorted."""
        return np.flatnonzero(~self.fixed & ((self.bound_side == 0) | self.equations_only))

    @property
    def structure(self) -> Snapshot:
        """The same iterate, judged by its equations and its objective alone."""
        return replace(self, row_multiplier=None, bound_multiplier=None, equations_only=True)

    def strict(self, slack: np.ndarray, multiplier: np.ndarray | None) -> np.ndarray:
        """Where a limit with that slack is strictly active; nowhere without multipliers."""
        if multiplier is None:
            return np.zeros(len(slack), dtype=bool)
        return np.abs(multiplier) > np.maximum(STRICT * np.abs(slack), self.tolerance)


def _side(
    values: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    multiplier: np.ndarray | None,
    tolerance: float,
) -> np.ndarray:
    """A limit is active where it is reached, or where its multiplier outweighs its slack."""
    below, above = values - lower, upper - values
    at_lower, at_upper = below <= REACHED, above <= REACHED
    if multiplier is not None:  # a row at its upper bound has a positive multiplier
        at_lower |= (-multiplier > np.maximum(below, tolerance)) & np.isfinite(below)
        at_upper |= (multiplier > np.maximum(above, tolerance)) & np.isfinite(above)
    return np.where(at_upper & (above <= below), 1, np.where(at_lower, -1, np.where(at_upper, 1, 0)))
