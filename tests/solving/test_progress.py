"""The test of progress, a function of the figures of a solve's iterations."""

import pytest

from trajopt.solving.stalling import (
    DECREASE,
    DUAL_LIMIT,
    START,
    TAIL,
    VIOLATION,
    WINDOW,
    is_stalled,
)

SMALL = 1.0


def test_rows_that_stay_violated_under_growing_multipliers_are_no_progress():
    n = START + 1
    assert is_stalled([1.0] * n, [SMALL] * (n - TAIL) + [2 * DUAL_LIMIT] * TAIL)


def test_multipliers_must_be_large_in_all_of_the_last_iterations():
    n = START + 1
    assert not is_stalled([1.0] * n, [SMALL] * (n - TAIL) + [2 * DUAL_LIMIT] * (TAIL - 1) + [SMALL])


def test_few_iterations_give_no_verdict():
    assert not is_stalled([1.0] * START, [2 * DUAL_LIMIT] * START)
    assert not is_stalled([], [])


def test_rows_that_hold_are_feasible_whatever_the_multipliers():
    assert not is_stalled([1.0] * 30 + [VIOLATION], [2 * DUAL_LIMIT] * 31)


@pytest.mark.parametrize(("after", "stalled"), [(0.9 * DECREASE, False), (1.1 * DECREASE, True)])
def test_the_best_violation_must_fall_by_a_factor(after, stalled):
    slowly = [1.0] + [after] * WINDOW
    assert is_stalled(slowly, [SMALL] * len(slowly)) is stalled


def test_an_increase_after_a_better_iterate_does_not_count_as_a_fall():
    rising = [0.1] + [1.0] * WINDOW
    assert is_stalled(rising, [SMALL] * len(rising))
