"""The elastic problem: feasible points where there are some, certificates where there are none."""

import numpy as np
import pytest

from tests.support.problems import REACH, REACH_TIME, hop, inertia, limited_reach
from trajopt.solvers.elastic import CLEAR_VIOLATION, REMOVABLE_VIOLATION, least_violation
from trajopt.solving.solving import prepare
from trajopt.transcription.guess import perturbed
from trajopt.transcription.violations import row_violations

LIMITS = {"max_iterations": 200, "max_time": 60.0}
# Least torque for the reach: full torque one way, then the other.
LEAST_TORQUE = 4 * inertia() * REACH / REACH_TIME**2
# What the barrier of the elastic problem leaves of each row.
BARRIER = 1e-3


def go_on(_: dict, __: object) -> bool:
    return True


def test_feasible_point_is_found_from_a_start_far_away():
    prepared = prepare(hop())
    start = perturbed(prepared.transcription, prepared.guess, 1, 0.3)
    assert row_violations(prepared.nlp, start).max() > CLEAR_VIOLATION
    found = least_violation(prepared.nlp, start, go_on, **LIMITS)
    assert found.feasible
    assert not found.infeasible
    assert row_violations(prepared.nlp, found.x).max() <= REMOVABLE_VIOLATION


@pytest.mark.parametrize("share", [0.5, 0.8])
def test_torque_below_the_least_is_certified_and_a_larger_one_is_not(share):
    prepared = prepare(limited_reach(share * LEAST_TORQUE))
    found = least_violation(prepared.nlp, prepared.guess, go_on, **LIMITS)
    assert found.infeasible
    assert not found.feasible
    enough = prepare(limited_reach(1.5 * LEAST_TORQUE))
    assert least_violation(enough.nlp, enough.guess, go_on, **LIMITS).feasible


def test_rows_give_way_by_what_they_lack_and_prices_bound_the_multipliers():
    prepared = prepare(limited_reach(0.5 * LEAST_TORQUE))
    found = least_violation(prepared.nlp, prepared.guess, go_on, **LIMITS)
    missed = row_violations(prepared.nlp, found.x)[: prepared.transcription.n_rows]
    assert np.all(missed <= found.gives + BARRIER)
    rows = found.weights[: len(missed)]
    assert np.abs(rows).max() <= 1 + BARRIER
    assert np.abs(rows).max() == pytest.approx(1, abs=BARRIER)


def test_limits_and_the_callback_stop_it_without_a_verdict():
    prepared = prepare(limited_reach(0.5 * LEAST_TORQUE))
    short = least_violation(prepared.nlp, prepared.guess, go_on, max_iterations=3, max_time=60.0)
    assert short.iterations <= 3
    assert not short.stopped
    stopped = least_violation(
        prepared.nlp, prepared.guess, lambda figures, _: figures["iteration"] < 2, **LIMITS
    )
    assert stopped.stopped
    for found in (short, stopped):
        assert not found.infeasible
        assert not found.feasible


def test_variables_that_a_callback_reads_are_those_of_the_problem():
    prepared = prepare(limited_reach(0.5 * LEAST_TORQUE))
    sizes = set()

    def look(_, read):
        sizes.add(len(read()))
        return True

    least_violation(prepared.nlp, prepared.guess, look, **LIMITS)
    assert sizes == {len(prepared.guess)}
