"""The integrator of the check against closed forms and `scipy.integrate.DOP853`."""

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import DOP853

from trajopt.certify.runge_kutta import integrate


def pendulum(t: float, state: np.ndarray) -> np.ndarray:
    return np.array([state[1], -9.81 * np.sin(state[0]) + np.cos(3 * t)])


def peers(rate, state, relative: float, absolute: float) -> tuple[np.ndarray, int]:
    """SciPy's result, and its number of evaluations."""
    method = DOP853(rate, 0.0, state, 1.0, rtol=relative, atol=absolute)
    while method.status == "running":
        method.step()
    return method.y, method.nfev


@pytest.mark.parametrize("relative", [1e-4, 1e-8, 1e-12])
@pytest.mark.parametrize("rate_of", [1.0, 30.0])
def test_result_and_evaluations_are_scipys(relative, rate_of):
    counted = itertools.count()

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        next(counted)
        return rate_of * pendulum(rate_of * t, state)

    start = np.array([2.0, -1.0])
    ours = integrate(rate, start, relative=relative, absolute=1e-3 * relative)
    evaluations = next(counted)
    theirs, count = peers(rate, start, relative, 1e-3 * relative)
    assert ours is not None
    assert evaluations == count
    assert_allclose(ours, theirs, rtol=max(1e-12, 1e-4 * relative))  # a pendulum multiplies rounding


def test_error_falls_with_the_eighth_power_of_the_step():
    errors = []
    for steps in (4, 8):
        state = np.array([1.0, 0.0])
        for _ in range(steps):  # a loose bound: each call takes one step
            end = integrate(
                lambda _, s: np.array([s[1], -s[0]]), state, relative=1e3, absolute=1e3, length=2 / steps
            )
            assert end is not None
            state = end
        errors.append(np.abs(state - [np.cos(2), -np.sin(2)]).max())
    assert 7.5 < np.log2(errors[0] / errors[1]) < 9.5


def test_what_grows_without_bound_or_is_no_number_has_no_result():
    def explodes(_: float, state: np.ndarray) -> np.ndarray:
        return state**2

    with np.errstate(over="ignore", invalid="ignore"):
        assert integrate(explodes, np.array([10.0]), relative=1e-6, absolute=1e-9) is None
        assert integrate(lambda _, s: s * np.nan, np.ones(2), relative=1e-6, absolute=1e-9) is None


def test_a_state_at_rest_stays():
    rest = integrate(lambda _, s: 0 * s, np.array([3.0, -1.0]), relative=1e-9, absolute=1e-12)
    assert_allclose(rest, [3.0, -1.0], rtol=0, atol=0)
