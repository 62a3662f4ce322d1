"""Transcription schemes: points, weights and interpolant of one interval.

With ``y`` the second derivative of the local coordinates at the points ``c`` of an interval of
length h, the scheme gives at point i and at the interval's end

    xi'(c_i) = xi'_k + h sum_j A1_ij y_j                    xi'_(k+1) = xi'_k + h sum_j b1_j y_j
    xi(c_i)  = xi_k + h c_i xi'_k + h^2 sum_j A2_ij y_j     xi_(k+1)  = xi_k + h xi'_k + h^2 sum_j b2_j y_j

Gauss-Legendre and Radau IIA are collocation of the acceleration: A1 and A2 are the integrals and
double integrals of the Lagrange polynomials through the points (de Boor and Swartz, "Collocation
at Gaussian points", 1973: order 2 s and 2 s - 1 at the nodes). The classic schemes integrate the
velocity by the same rule as the acceleration, A2 = A1 A1, as when q' = v is collocated separately (Betts,
"Practical Methods for Optimal Control", 2010, ch. 4).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import casadi as ca
import numpy as np
from numpy.polynomial import Polynomial

from trajopt.errors import not_among

MAX_DEGREE = 4
SCHEME_NAMES = ("legendre:1..4", "radau:1..4", "trapezoidal", "hermite-simpson", "semi-implicit-euler")


@dataclass(frozen=True, kw_only=True)
class Scheme:
    """One interval's points and weights; arrays are dimensionless fractions of the interval.

    ``c`` (s,), ``A1``, ``A2`` (s, s), ``b1``, ``b2`` (s,); ``b1`` are also the quadrature weights of
    the running cost; ``order`` is the order of accuracy at the nodes.
    """

    name: str
    order: int
    c: np.ndarray
    A1: np.ndarray
    A2: np.ndarray
    b1: np.ndarray
    b2: np.ndarray
    s: int = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "s", len(self.c))
        for array in (self.c, self.A1, self.A2, self.b1, self.b2):
            array.setflags(write=False)

    def interpolation(self, fractions: np.ndarray) -> np.ndarray:
        """Matrix (len(fractions), s) that evaluates the Lagrange polynomials through the points."""
        return np.column_stack([basis(np.asarray(fractions, dtype=float)) for basis in _lagrange(self.c)])

    def lower_at(self, fraction: float) -> tuple[np.ndarray, np.ndarray]:
        """Weights (s,) of y in xi' (over h) and in xi (over h^2) at a fraction of the interval.

        Those of the interpolant that a solution file is read with: the integrals of the Lagrange polynomials,
        and for the classic schemes the cubic that closes their gap to the next node.
        """
        at, end = np.array([fraction]), np.ones(1)
        rate, position = _integrals(self.c, at, 1)[0], _integrals(self.c, at, 2)[0]
        ramp = fraction**2 * (3 - 2 * fraction)
        closing = self.b2 - _integrals(self.c, end, 2)[0]
        return rate + fraction * (self.b1 - _integrals(self.c, end, 1)[0]), position + ramp * closing

    def interpolation_rate(self, fractions: np.ndarray) -> np.ndarray:
        """Matrix (len(fractions), s) of the Lagrange polynomials' derivatives by the fraction."""
        where = np.asarray(fractions, dtype=float)
        return np.column_stack([basis.deriv()(where) + 0 * where for basis in _lagrange(self.c)])


def _lagrange(points: np.ndarray) -> list[Polynomial]:
    bases = []
    for i, point in enumerate(points):
        others = np.delete(points, i)
        bases.append(
            Polynomial.fromroots(others) / np.prod(point - others) if len(others) else Polynomial([1.0])
        )
    return bases


def _integrals(points: np.ndarray, ends: np.ndarray, times: int) -> np.ndarray:
    return np.column_stack([basis.integ(times)(ends) for basis in _lagrange(points)])


@cache
def _collocation(family: str, degree: int) -> Scheme:
    c = np.array(ca.collocation_points(degree, family))
    one = np.ones(1)
    return Scheme(
        name=f"{family}:{degree}",
        order=2 * degree if family == "legendre" else 2 * degree - 1,
        c=c,
        A1=_integrals(c, c, 1),
        A2=_integrals(c, c, 2),
        b1=_integrals(c, one, 1)[0],
        b2=_integrals(c, one, 2)[0],
    )


def _lobatto(name: str, order: int, c: np.ndarray) -> Scheme:
    a1 = _integrals(c, c, 1)
    b1 = _integrals(c, np.ones(1), 1)[0]
    return Scheme(name=name, order=order, c=c, A1=a1, A2=a1 @ a1, b1=b1, b2=b1 @ a1)


def _semi_implicit_euler() -> Scheme:
    zero, one = np.zeros((1, 1)), np.ones(1)
    return Scheme(
        name="semi-implicit-euler", order=1, c=np.zeros(1), A1=zero, A2=zero.copy(), b1=one, b2=one.copy()
    )


def scheme(name: str) -> Scheme:
    """Scheme by name, for example ``legendre:2``; see ``SCHEME_NAMES``. Raises InputError."""
    family, _, degree = name.partition(":")
    if family in ("legendre", "radau") and degree in map(str, range(1, MAX_DEGREE + 1)):
        return _collocation(family, int(degree))
    if name == "trapezoidal":
        return _lobatto(name, 2, np.array([0.0, 1.0]))
    if name == "hermite-simpson":
        return _lobatto(name, 4, np.array([0.0, 0.5, 1.0]))
    if name == "semi-implicit-euler":
        return _semi_implicit_euler()
    raise not_among(SCHEME_NAMES, name, f"unknown transcription '{name}'")
