"""An NLP at one iterate: values, derivatives, multipliers, and which rows and bounds are active."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from trajopt.transcription.names import NlpNames
from trajopt.transcription.nlp import Nlp
from trajopt.transcription.transcription import Transcription
from trajopt.transcription.violations import row_violations

# Distance from its bound, natural units, at which a limit is active: interior-point iterates at the solvers'
# tolerance of 1e-6 come that close.
LIMIT_DISTANCE = 1e-5
# At a weakly active limit, slack and multiplier both approach the square root of the barrier parameter. A
# limit is strictly active if its multiplier is this many times its slack.
STRICT = 10.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Snapshot:
    """An NLP at scaled variables ``x`` (n_unknowns,).

    row_multiplier, bound_multiplier: (n_rows,), (n_unknowns,) of the Lagrangian f + row . g + bound . x; or
    None. tolerance: the solve's. equations_only: whether limits are left out of the active rows, as they
    should be far from feasible points, where it is accidental which limits an iterate reaches.
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
        """Names of variables and rows."""
        return NlpNames(self.nlp, self.x)

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
        """Violations of rows, then of bounds (n_rows + n_unknowns,)."""
        return row_violations(self.nlp, self.x)

    @cached_property
    def gradient(self) -> np.ndarray:
        """Gradient of the objective (n_unknowns,)."""
        return np.asarray(self.nlp.engine.gradient(self.x)).copy()

    @cached_property
    def jacobian(self) -> sparse.csr_matrix:
        """Jacobian of the rows (n_rows, n_unknowns)."""
        return self.nlp.jacobian(self.x)

    @cached_property
    def hessian(self) -> sparse.csr_matrix:
        """Hessian of the Lagrangian; without multipliers, of the objective."""
        known = np.zeros(self.transcription.n_rows) if self.row_multiplier is None else self.row_multiplier
        return self.nlp.lagrangian_hessian(self.x, known)

    @cached_property
    def stationarity(self) -> float | None:
        """Largest entry of the Lagrangian's gradient, scaled units; None without multipliers."""
        if self.row_multiplier is None or self.bound_multiplier is None:
            return None
        residual = self.gradient + self.jacobian.T @ self.row_multiplier + self.bound_multiplier
        return float(np.abs(residual).max(initial=0.0))

    @cached_property
    def complementarity(self) -> float:
        """Largest product of a row's multiplier and its slack at the bound given by the multiplier's sign."""
        if self.row_multiplier is None:
            return 0.0
        t = self.transcription
        slack = np.where(self.row_multiplier > 0, t.upper_g - self.g, self.g - t.lower_g)
        seen = np.isfinite(slack) & (self.row_multiplier != 0)
        return float(np.abs(slack[seen] * self.row_multiplier[seen]).max(initial=0.0))

    # Activity

    @cached_property
    def lower(self) -> np.ndarray:
        """Lower bounds of rows, then of variables (n_rows + n_unknowns,), the order of the arrays below."""
        return np.concatenate([self.transcription.lower_g, self.transcription.lower_x])

    @cached_property
    def upper(self) -> np.ndarray:
        """Upper bounds."""
        return np.concatenate([self.transcription.upper_g, self.transcription.upper_x])

    @cached_property
    def multiplier(self) -> np.ndarray | None:
        """Multipliers, or None."""
        if self.row_multiplier is None or self.bound_multiplier is None:
            return None
        return np.concatenate([self.row_multiplier, self.bound_multiplier])

    @cached_property
    def margins(self) -> tuple[np.ndarray, np.ndarray]:
        """Distances above the lower bounds and below the upper bounds."""
        values = np.concatenate([self.g, self.x])
        return values - self.lower, self.upper - values

    @property
    def equality(self) -> np.ndarray:
        """Whether each row is an equation (n_rows,)."""
        return (self.lower == self.upper)[: len(self.g)]

    @property
    def fixed(self) -> np.ndarray:
        """Whether each variable is fixed (n_unknowns,)."""
        return (self.lower == self.upper)[len(self.g) :]

    @cached_property
    def side(self) -> np.ndarray:
        """-1 for limits active at the lower bound, 1 at the upper one, else 0; 0 also for equations.

        A limit is active if it is reached, or if its multiplier exceeds its slack.
        """
        below, above = self.margins
        at_lower, at_upper = below <= LIMIT_DISTANCE, above <= LIMIT_DISTANCE
        if self.multiplier is not None:  # a row at its upper bound has a positive multiplier
            at_lower |= (-self.multiplier > np.maximum(below, self.tolerance)) & np.isfinite(below)
            at_upper |= (self.multiplier > np.maximum(above, self.tolerance)) & np.isfinite(above)
        upper = at_upper & ((above <= below) | ~at_lower)
        return np.where(self.lower == self.upper, 0, np.where(upper, 1, np.where(at_lower, -1, 0)))

    @property
    def strict(self) -> np.ndarray:
        """Whether each limit is strictly active; False without multipliers."""
        if self.multiplier is None:
            return np.zeros(len(self.lower), dtype=bool)
        slack = np.abs(np.minimum(*self.margins))
        return np.abs(self.multiplier) > np.maximum(STRICT * slack, self.tolerance)

    @property
    def active_rows(self) -> np.ndarray:
        """Sorted indices of rows that are equations or active limits."""
        at_bound = (self.side[: len(self.g)] != 0) & (not self.equations_only)
        return np.flatnonzero(self.equality | at_bound)

    @property
    def free(self) -> np.ndarray:
        """Sorted indices of variables that are neither fixed nor at a bound."""
        return np.flatnonzero(~self.fixed & ((self.side[len(self.g) :] == 0) | self.equations_only))

    @property
    def structure(self) -> Snapshot:
        """The same iterate with only equations and objective, without limits and multipliers."""
        return replace(self, row_multiplier=None, bound_multiplier=None, equations_only=True)
