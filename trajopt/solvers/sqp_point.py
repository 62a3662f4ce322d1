"""Iterates of the SQP: the NLP's functions there, their KKT errors, and their quadratic programs."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from trajopt.solvers.qp import QuadraticProgram
from trajopt.solvers.sqp_filter import FilterEntry
from trajopt.transcription.nlp import Nlp

# Mean multipliers larger than this relax optimality in proportion, as IPOPT's s_max does: the error of a
# sum of large terms is no smaller.
LARGE_MEAN = 100.0


@dataclass(frozen=True, kw_only=True)
class SqpIterate:
    """An iterate: variables, multipliers, violation and f (``pair``), rows, and nonzeros of derivatives."""

    x: np.ndarray
    lam_g: np.ndarray
    lam_x: np.ndarray
    pair: FilterEntry
    g: np.ndarray
    gradient: np.ndarray
    jacobian: np.ndarray

    @property
    def is_finite(self) -> bool:
        """Whether all values and first derivatives are finite."""
        return all(np.isfinite(part).all() for part in (self.pair.f, self.g, self.gradient, self.jacobian))


@dataclass(frozen=True, kw_only=True)
class KktErrors:
    """Largest violation of a row, entry of the Lagrangian's gradient, and multiplier times distance.

    ``optimality`` is the larger of the last two over the mean multiplier, where that is large.
    """

    primal: float
    dual: float
    complementarity: float
    optimality: float


class Evaluator:
    """Evaluates an NLP for the SQP, with the bounds of its transcription."""

    def __init__(self, nlp: Nlp) -> None:
        t = nlp.transcription
        self.nlp, self.engine = nlp, nlp.engine
        self.low, self.high, self.x_low, self.x_high = t.lower_g, t.upper_g, t.lower_x, t.upper_x
        starts = np.searchsorted(nlp.row, np.arange(len(self.low) + 1))
        shape = (len(self.low), len(self.x_low))
        nothing = np.zeros(len(nlp.column))
        self.matrix = sparse.csr_matrix((nothing, nlp.column, starts), shape=shape)

    def inside(self, x: np.ndarray) -> np.ndarray:
        """The nearest point within the bounds of the variables."""
        return np.clip(x, self.x_low, self.x_high)

    def pair(self, x: np.ndarray) -> FilterEntry:
        """Sum of the rows' violations, and the objective."""
        f, g = float(self.engine.f(x)), np.asarray(self.engine.g(x))
        return FilterEntry(float(_outside(g, self.low, self.high).sum()), f)

    def at(self, x: np.ndarray, lam_g: np.ndarray, lam_x: np.ndarray) -> SqpIterate:
        """The iterate at ``x``, projected onto its bounds."""
        x = self.inside(x)
        return SqpIterate(
            x=x,
            lam_g=lam_g,
            lam_x=lam_x,
            pair=self.pair(x),
            g=np.asarray(self.engine.g(x)),
            gradient=np.asarray(self.engine.gradient(x)),
            jacobian=np.asarray(self.engine.jacobian(x)),
        )

    def errors(self, point: SqpIterate) -> KktErrors:
        """Residuals of the Karush-Kuhn-Tucker conditions at the iterate."""
        slope = point.gradient + self._jacobian(point).T @ point.lam_g + point.lam_x
        products = np.concatenate(
            [
                _complementarity(point.lam_g, point.g, self.low, self.high),
                _complementarity(point.lam_x, point.x, self.x_low, self.x_high),
            ]
        )
        multipliers = np.concatenate([point.lam_g, point.lam_x])
        relaxed = max(LARGE_MEAN, float(np.abs(multipliers).mean())) / LARGE_MEAN
        dual, complementarity = _largest(slope), _largest(products)
        return KktErrors(
            primal=_largest(_outside(point.g, self.low, self.high)),
            dual=dual,
            complementarity=complementarity,
            optimality=max(dual, complementarity) / relaxed,
        )

    def program(self, point: SqpIterate, lam_g: np.ndarray) -> QuadraticProgram:
        """The quadratic program at an iterate, with the Hessian for multipliers ``lam_g``."""
        return QuadraticProgram(
            hessian=np.asarray(self.engine.hessian(point.x, 1.0, lam_g)),
            gradient=point.gradient,
            jacobian=point.jacobian,
            low=self.low - point.g,
            high=self.high - point.g,
            x_low=self.x_low - point.x,
            x_high=self.x_high - point.x,
        )

    def corrected_program(self, point: SqpIterate, q: QuadraticProgram, d: np.ndarray) -> QuadraticProgram:
        """The program of a second-order correction: rows take their values at the end of ``d``."""
        g = np.asarray(self.engine.g(self.inside(point.x + d))) - self._jacobian(point) @ d
        return replace(q, low=self.low - g, high=self.high - g)

    def _jacobian(self, point: SqpIterate) -> sparse.csr_matrix:
        self.matrix.data = point.jacobian
        return self.matrix


def _outside(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    return np.maximum(0.0, np.maximum(low - values, values - high))


def _complementarity(
    multiplier: np.ndarray, value: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Multiplier times distance from its bound; the multiplier itself where there is no bound."""
    bound = np.where(multiplier > 0, high, low)
    with np.errstate(invalid="ignore"):
        product = np.abs(multiplier * (bound - value))
    return np.where(low == high, 0.0, np.where(np.isfinite(bound), product, np.abs(multiplier)))


def _largest(values: np.ndarray) -> float:
    return float(np.abs(values).max(initial=0.0))
