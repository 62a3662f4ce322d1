"""Transcription schemes: points, weights and interpolant of one interval.

With ``y`` the second derivative of the local coordinates at the points ``c`` of an interval of
length h, the scheme gives at point i and at the interval's end

    xi'(c_i) = xi'_k + h sum_j A1_ij y_j                    xi'_(k+1) = xi'_k + h sum_j b1_j y_j
    xi(c_i)  = xi_k + h c_i xi'_k + h^2 sum_j A2_ij y_j     xi_(k+1)  = xi_k + h xi'_k + h^2 sum_j b2_j y_j

and if ``y`` is the third derivative, A1, A2, A3 give xi'', xi', xi in the same way.

Gauss-Legendre and Radau IIA are collocation of the acceleration: A1 and A2 are the integrals and
double integrals of the Lagrange polynomials through the points (de Boor and Swartz, "Collocation
at Gaussian points", 1973: order 2 s and 2 s - 1 at the nodes). The classic schemes integrate the
velocity by the same rule as the acceleration, A2 = A1 A1, as when q' = v is collocated separately (Betts,
"Practical Methods for Optimal Control", 2010, ch. 4).

A new scheme needs only a `SchemeFamily` in `FAMILIES`; no other code branches on a scheme's name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property

import casadi as ca
import numpy as np
from numpy.polynomial import Polynomial

from trajopt.errors import InputError, not_among

# Largest error of the quadrature of a monomial: rounding.
ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True)
class Scheme:
    """One interval's points and weights; arrays are dimensionless fractions of the interval.

    Args:
        name: name by which it is found.
        order: order of accuracy at the nodes.
        c: points (s,).
        A1: weights (s, s) of y in xi' at the points.
        A2: weights (s, s) of y in xi at the points.
        b1: weights (s,) of y in xi' at the end; also the quadrature weights of the running cost.
        b2: weights (s,) of y in xi at the end.
        A3, b3: the next weights (s, s) and (s,), for y the third derivative; None if the scheme has none.

    Raises:
        InputError: for points that do not ascend or are not within 0 to 1, or for an order that the
            quadrature with ``b1`` does not have.
    """

    name: str
    order: int
    c: np.ndarray
    A1: np.ndarray
    A2: np.ndarray
    b1: np.ndarray
    b2: np.ndarray
    A3: np.ndarray | None = None
    b3: np.ndarray | None = None
    s: int = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "s", len(self.c))
        for array in (self.c, self.A1, self.A2, self.b1, self.b2, self.A3, self.b3):
            if array is not None:
                array.setflags(write=False)
        _require_points(self.name, self.c)
        degrees = np.arange(self.order)
        wrong = np.abs(self.b1 @ self.c[:, None] ** degrees - 1 / (degrees + 1)) > ROUNDING
        if wrong.any():
            exact = f"allowed: up to {wrong.argmax()}, with these points and b1"
            raise InputError(f"order of scheme '{self.name}' is {self.order}", exact)

    @cached_property
    def error_constant(self) -> float:
        """Local error of the quadrature divided by h^(p + 1) f^(p), where p is the order.

        Davis and Rabinowitz, "Methods of Numerical Integration", 1984, ch. 2.7.
        """
        missed = 1 / (self.order + 1) - float(self.b1 @ self.c**self.order)
        return abs(missed) / math.factorial(self.order)

    @property
    def finer(self) -> Scheme | None:
        """The scheme of the next higher degree in its family; None if there is none."""
        family, _, degree = self.name.partition(":")
        if not degree or int(degree) >= FAMILIES[family].degrees:
            return None
        return scheme(f"{family}:{int(degree) + 1}")

    def interpolation(self, fractions: np.ndarray) -> np.ndarray:
        """Matrix (len(fractions), s) that evaluates the Lagrange polynomials through the points."""
        return _values(self._lagrange[0], np.asarray(fractions, dtype=float))

    def lower_at(self, fraction: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Weights (s,) of the integrals of y, over h, h^2 and h^3, at a fraction of the interval.

        The first two are those of the interpolant of solution files: the integrals of the Lagrange
        polynomials, plus a cubic that closes the gap to the next node for schemes that have one (classic,
        semi-implicit Euler).
        """
        first, second, third = (_values(bases, np.array([fraction]))[0] for bases in self._lagrange[1:])
        ramp = fraction**2 * (3 - 2 * fraction)
        rate_gap, gap = self._gaps
        return first + fraction * rate_gap, second + ramp * gap, third

    def points_of(self, order: int) -> list[np.ndarray]:
        """The weights A1, A2, ... (s, s) of the integrals at the points, one for each lower derivative."""
        return [weights for weights in (self.A1, self.A2, self.A3)[:order] if weights is not None]

    def ends_of(self, order: int) -> list[np.ndarray]:
        """The weights b1, b2, ... (s,) of the integrals at the end."""
        return [weights for weights in (self.b1, self.b2, self.b3)[:order] if weights is not None]

    @cached_property
    def _gaps(self) -> tuple[np.ndarray, np.ndarray]:
        """Differences (s,) between b1, b2 and the integrals of the Lagrange polynomials over the interval."""
        rate, position = (_values(bases, np.ones(1))[0] for bases in self._lagrange[1:3])
        return self.b1 - rate, self.b2 - position

    @cached_property
    def _lagrange(self) -> list[list[Polynomial]]:
        """The Lagrange polynomials through the points, and their first three integrals."""
        bases = _lagrange(self.c)
        return [[basis.integ(times) if times else basis for basis in bases] for times in range(4)]

    @cached_property
    def polynomials(self) -> np.ndarray:
        """Coefficients (3, s + 2, s), by powers of the fraction, of y in xi'', xi' / h and xi / h^2."""
        result = np.zeros((3, self.s + 2, self.s))
        for times, bases in enumerate(self._lagrange[:3]):
            for j, basis in enumerate(bases):
                result[times, : len(basis.coef), j] = basis.coef
        return result

    @cached_property
    def differentiation(self) -> tuple[np.ndarray, np.ndarray]:
        """Sample fractions (m,) and the matrix (s, m) from samples there to h times the rates at the points.

        The samples are at the start and the points, and at the end if the start is the only point.
        """
        fractions = np.unique([0.0, *self.c])
        fractions = fractions if len(fractions) > 1 else np.array([0.0, 1.0])
        return fractions, np.column_stack(
            [basis.deriv()(self.c) + 0 * self.c for basis in _lagrange(fractions)]
        )

    def interpolation_rate(self, fractions: np.ndarray) -> np.ndarray:
        """Matrix (len(fractions), s) of the Lagrange polynomials' derivatives by the fraction."""
        where = np.asarray(fractions, dtype=float)
        return np.column_stack([basis.deriv()(where) + 0 * where for basis in self._lagrange[0]])


def _require_points(name: str, c: np.ndarray) -> None:
    if not (len(c) and c[0] >= 0 and c[-1] <= 1 and (np.diff(c) > 0).all()):
        points = ", ".join(f"{point:g}" for point in c) or "none"
        raise InputError(f"points of scheme '{name}' are {points}", "allowed: ascending, from 0 to 1")


def _values(bases: Sequence[Polynomial], where: np.ndarray) -> np.ndarray:
    """Values (len(where), len(bases)) of polynomials."""
    return np.column_stack([basis(where) for basis in bases])


def _lagrange(points: np.ndarray) -> list[Polynomial]:
    bases = []
    for i, point in enumerate(points):
        others = np.delete(points, i)
        bases.append(
            Polynomial.fromroots(others) / np.prod(point - others) if len(others) else Polynomial([1.0])
        )
    return bases


def _integrals(points: np.ndarray, ends: np.ndarray, times: int) -> np.ndarray:
    return _values([basis.integ(times) for basis in _lagrange(points)], ends)


def collocation(name: str, order: int, c: np.ndarray) -> Scheme:
    """Collocation of the acceleration at points ``c`` (s,) of an interval, between 0 and 1.

    ``order`` is that of the quadrature at these points and of the accuracy at the nodes (de Boor and Swartz,
    1973). Raises `InputError`, see `Scheme`.
    """
    _require_points(name, c)
    one = np.ones(1)
    return Scheme(
        name=name,
        order=order,
        c=c,
        A1=_integrals(c, c, 1),
        A2=_integrals(c, c, 2),
        b1=_integrals(c, one, 1)[0],
        b2=_integrals(c, one, 2)[0],
        A3=_integrals(c, c, 3),
        b3=_integrals(c, one, 3)[0],
    )


def _classic(name: str, order: int, c: np.ndarray) -> Scheme:
    """The Lobatto rule at points ``c``, applied to the acceleration and again to the velocity."""
    a1, b1 = _integrals(c, c, 1), _integrals(c, np.ones(1), 1)[0]
    return Scheme(name=name, order=order, c=c, A1=a1, A2=a1 @ a1, b1=b1, b2=b1 @ a1)


def _casadi_points(family: str, degree: int) -> np.ndarray:
    return np.array(ca.collocation_points(degree, family))


def _semi_implicit_euler(name: str) -> Scheme:
    """Position x + h v + h^2 y: it moves with the velocity at the interval's end."""
    zero, one = np.zeros((1, 1)), np.ones(1)
    return Scheme(name=name, order=1, c=np.zeros(1), A1=zero, A2=zero.copy(), b1=one, b2=one.copy())


@dataclass(frozen=True, kw_only=True)
class SchemeFamily:
    """Schemes of one kind: ``NAME:1`` to ``NAME:degrees``, or one without a degree.

    Args:
        build: builds a scheme from its name and degree.
        degrees: highest degree; 0 for a single scheme, named like its family.
    """

    build: Callable[[str, int], Scheme]
    degrees: int = 0


FAMILIES = {
    "legendre": SchemeFamily(
        build=lambda name, s: collocation(name, 2 * s, _casadi_points("legendre", s)), degrees=4
    ),
    "radau": SchemeFamily(
        build=lambda name, s: collocation(name, 2 * s - 1, _casadi_points("radau", s)), degrees=4
    ),
    "trapezoidal": SchemeFamily(build=lambda name, _: _classic(name, 2, np.array([0.0, 1.0]))),
    "hermite-simpson": SchemeFamily(build=lambda name, _: _classic(name, 4, np.array([0.0, 0.5, 1.0]))),
    "semi-implicit-euler": SchemeFamily(build=lambda name, _: _semi_implicit_euler(name)),
}


@cache
def scheme(name: str) -> Scheme:
    """Scheme by name, for example ``legendre:2``. Raises InputError that lists the known names."""
    family, _, degree = name.partition(":")
    if family in FAMILIES:
        kind = FAMILIES[family]
        if kind.degrees and degree in map(str, range(1, kind.degrees + 1)):
            return kind.build(name, int(degree))
        if not kind.degrees and name == family:
            return kind.build(name, 0)
    known = [f"{each}:1..{kind.degrees}" if kind.degrees else each for each, kind in FAMILIES.items()]
    raise not_among(known, name, f"unknown transcription '{name}'")
