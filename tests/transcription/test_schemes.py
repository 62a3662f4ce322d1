"""Points, weights and interpolants of every scheme."""

from math import factorial

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from numpy.testing import assert_allclose

from trajopt.errors import InputError
from trajopt.transcription.schemes import FAMILIES, scheme

# Integrals of Lagrange polynomials of degree up to 4 on [0, 1]: tens of roundings.
ROUNDING = 1e-13
# A quadrature that is not exact misses a monomial of low degree by far more than this.
INEXACT = 1e-6
# What a scheme misses is a difference of numbers near 1/8, down to 2e-5: so many roundings of it.
CONSTANT = 1e-9
COLLOCATION = [
    f"{name}:{degree}" for name, family in FAMILIES.items() for degree in range(1, family.degrees + 1)
]
UNKNOWN = (
    "legendre", "legendre:0", "legendre:5", "radau:-1", "radau:2x", "radau:²", "radau:02", "euler", "",
    "trapezoidal:", "trapezoidal:1",
)  # fmt: skip
CLASSIC = tuple(name for name, family in FAMILIES.items() if not family.degrees)


def exact_degree(name: str) -> int:
    method = scheme(name)
    return 2 * method.s - 1 if name.startswith("legendre") else 2 * method.s - 2


@pytest.mark.parametrize("name", COLLOCATION)
def test_quadrature_is_exact_to_its_degree_and_no_further(name):
    method = scheme(name)
    errors = [method.b1 @ method.c**n - 1 / (n + 1) for n in range(exact_degree(name) + 2)]
    assert_allclose(errors[:-1], 0.0, atol=ROUNDING)
    assert abs(errors[-1]) > INEXACT


@pytest.mark.parametrize("name", COLLOCATION)
def test_double_quadrature_is_exact_one_degree_less(name):
    method = scheme(name)
    for n in range(exact_degree(name)):
        assert_allclose(method.b2 @ method.c**n, 1 / ((n + 1) * (n + 2)), atol=ROUNDING)


@pytest.mark.parametrize("name", COLLOCATION)
def test_collocation_matrices_integrate_polynomials_through_the_points_exactly(name):
    method = scheme(name)
    polynomial = Polynomial(np.random.default_rng(0).uniform(-1, 1, method.s))
    y = polynomial(method.c)
    assert_allclose(method.A1 @ y, polynomial.integ(1)(method.c), atol=ROUNDING)
    assert_allclose(method.A2 @ y, polynomial.integ(2)(method.c), atol=ROUNDING)
    assert_allclose(
        [method.b1 @ y, method.b2 @ y], [polynomial.integ(1)(1), polynomial.integ(2)(1)], atol=ROUNDING
    )


@pytest.mark.parametrize("name", COLLOCATION)
def test_collocation_points_lie_in_the_interval_and_radau_ends_it(name):
    method = scheme(name)
    assert np.all(np.diff(method.c) > 0)
    assert method.c[0] > 0
    assert method.c[-1] == pytest.approx(1.0, abs=ROUNDING) if name.startswith("radau") else method.c[-1] < 1
    assert method.order == exact_degree(name) + 1


def test_trapezoidal_is_lobatto_3a_of_two_points():
    method = scheme("trapezoidal")
    half = np.array([[0, 0], [0.5, 0.5]])
    assert_allclose(method.A1, half, atol=ROUNDING)
    assert_allclose(method.A2, half @ half, atol=ROUNDING)
    assert_allclose([method.c, method.b1, method.b2], [[0, 1], [0.5, 0.5], [0.25, 0.25]], atol=ROUNDING)


def test_hermite_simpson_is_lobatto_3a_of_three_points():
    method = scheme("hermite-simpson")
    tableau = np.array([[0, 0, 0], [5, 8, -1], [4, 16, 4]]) / 24
    assert_allclose(method.A1, tableau, atol=ROUNDING)
    assert_allclose(method.A2, tableau @ tableau, atol=ROUNDING)
    assert_allclose([method.c, method.b1], [[0, 0.5, 1], np.array([1, 4, 1]) / 6], atol=ROUNDING)
    assert_allclose(method.b2, method.b1 @ tableau, atol=ROUNDING)


def test_semi_implicit_euler_moves_with_the_velocity_of_the_end():
    method = scheme("semi-implicit-euler")
    assert_allclose([method.A1[0, 0], method.A2[0, 0], method.c[0]], 0.0)
    assert_allclose([method.b1[0], method.b2[0]], 1.0)  # x + h v + h^2 y = x + h (v + h y)


@pytest.mark.parametrize("name", [*COLLOCATION, *CLASSIC])
def test_rates_of_samples_are_exact_for_polynomials_through_them(name):
    found = scheme(name)
    fractions, matrix = found.differentiation
    assert set(found.c) <= set(fractions)
    for power in range(len(fractions)):
        exact = power * found.c ** max(power - 1, 0)
        assert_allclose(matrix @ fractions**power, exact, atol=1e-12)


@pytest.mark.parametrize("name", [*COLLOCATION, *CLASSIC])
def test_interpolation_is_the_identity_at_the_points(name):
    method = scheme(name)
    assert_allclose(method.interpolation(method.c), np.eye(method.s), atol=ROUNDING)
    assert_allclose(method.interpolation(np.linspace(0, 1, 7)).sum(axis=1), 1.0, atol=ROUNDING)


@pytest.mark.parametrize("name", [*COLLOCATION, *CLASSIC])
def test_scheme_knows_its_name_and_cannot_be_changed(name):
    method = scheme(name)
    assert method.name == name
    with pytest.raises(ValueError, match="read-only"):
        method.b1[0] = 0.0


@pytest.mark.parametrize("s", range(1, FAMILIES["legendre"].degrees + 1))
def test_error_constants_are_those_of_the_literature(s):
    gauss = factorial(s) ** 4 / ((2 * s + 1) * factorial(2 * s) ** 3)
    radau = s * factorial(s - 1) ** 4 / (2 * factorial(2 * s - 1) ** 3)
    assert scheme(f"legendre:{s}").error_constant == pytest.approx(gauss, rel=CONSTANT)
    assert scheme(f"radau:{s}").error_constant == pytest.approx(radau, rel=CONSTANT)


def test_the_next_degree_is_asked_of_the_scheme():
    assert scheme("radau:3").finer is scheme("radau:4")
    assert scheme("radau:4").finer is None
    assert scheme("trapezoidal").finer is None


@pytest.mark.parametrize("name", UNKNOWN)
def test_unknown_scheme_is_refused_with_the_list(name):
    with pytest.raises(InputError, match=r"allowed: legendre:1\.\.4.*semi-implicit-euler"):
        scheme(name)
