"""A time of the solver: the grade first, then finer meshes while another round is expected to fit."""

import pytest

from tests.support.problems import hop, reach
from trajopt.errors import InputError
from trajopt.solving.budget import solve_within
from trajopt.solving.graded import solve_graded


@pytest.mark.long
def test_a_long_time_is_used_for_a_finer_mesh_than_the_grade_needs():
    graded, within = solve_graded(reach()), solve_within(reach(), 60.0)
    assert within.reached
    assert within.solution.statistics.graded.error_m == within.error
    assert len(within.rounds) > len(graded.rounds)
    errors = [max(one.errors) for one in within.rounds if one.errors is not None]
    assert within.error == min(errors)


def test_a_time_that_is_too_short_for_a_first_solve_ends_as_a_time_limit():
    within = solve_within(hop(), 1e-6)
    assert not within.reached
    assert within.solution.statistics.status == "time_limit"


@pytest.mark.parametrize("budget", [0.0, -1.0, float("nan"), True])
def test_a_time_that_is_none_is_refused(budget: float):
    with pytest.raises(InputError, match="budget"):
        solve_within(reach(), budget)


def test_what_is_not_solved_is_not_refined():
    within = solve_within(hop(), 60.0, max_iterations=1)
    assert not within.solution.converged
    assert within.accuracy is None
