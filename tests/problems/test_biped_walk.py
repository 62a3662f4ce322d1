"""Talos' legs walk from the pendulum's guess: solved soon, checked, at rest on the planned footholds."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import trajopt
from trajopt.certify.report import AT_POINTS
from trajopt.errors import InputError
from trajopt.reduced.footsteps import feet_of
from trajopt_library import problems

# Iterations within which every example is to solve from its own guess.
MOST_ITERATIONS = 60
# Rest and footholds, as a solver at 1e-6 leaves them after the contacts' drift of the scheme, m and m/s.
AT_REST = 1e-2
ON_FOOTHOLD = 1e-3


def test_phases_alternate_single_and_double_support_and_land_where_planned() -> None:
    problem = problems.load("biped-walk", steps=3, length=0.2)
    phases = problem.schedule.phases
    assert [phase.name for phase in phases] == [
        "shift", "step_1", "double_1", "step_2", "double_2", "step_3", "settle",
    ]  # fmt: skip
    assert [len(phase.contacts) for phase in phases] == [2, 1, 2, 1, 2, 1, 2]
    start = feet_of(problem.robot, problem.initial_q)
    end = feet_of(problem.robot, problem.guess(problem.schedule.duration))
    for name, foot in end.items():
        assert_allclose(foot.position - start[name].position, [0.4, 0.0, 0.0], atol=ON_FOOTHOLD)


def test_unphysical_parameters_are_refused() -> None:
    for values in (
        {"steps": 1},
        {"steps": 2.5},
        {"length": 2.0},
        {"double_support": 0.0},
        {"torque_share": 0.0},
    ):
        with pytest.raises(InputError, match="allowed"):
            problems.load("biped-walk", **values)


@pytest.mark.slow
@pytest.mark.parametrize("values", [{}, {"steps": 3, "length": -0.15, "turn": 0.15}])
def test_walk_solves_from_its_own_guess_passes_the_check_and_ends_at_rest(values: dict[str, float]) -> None:
    problem = problems.load("biped-walk", **values)
    solution = trajopt.solve(problem, fixed_mesh=True)
    assert solution.converged, solution.statistics.advice
    assert solution.statistics.iterations <= MOST_ITERATIONS
    assert not trajopt.check(solution).failures(AT_POINTS)
    assert np.abs(solution.v[-1]).max() < AT_REST
    planned = feet_of(problem.robot, problem.guess(problem.schedule.duration))
    for name, foot in feet_of(problem.robot, solution.q[-1]).items():
        assert_allclose(foot.position, planned[name].position, atol=ON_FOOTHOLD)
