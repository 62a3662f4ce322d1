"""Solves that get nowhere: certified with the rows in conflict, or started anew; limits and Ctrl-C hold."""

import pytest

from tests.support.problems import REACH, REACH_TIME, inertia, limited_reach
from trajopt.problem.problem import Problem
from trajopt.solving.solving import solve
from trajopt.solving.stalling import CERTIFIED
from trajopt_library import problems

# With half of the least torque, see `limited_reach`.
TOO_WEAK = 0.5 * 4 * inertia() * REACH / REACH_TIME**2
# Iterations of a certificate of such small problems; IPOPT alone takes hundreds or ends without one.
FEW = 80
# Flight in s near the longest that any start solves on the hopper's mesh: IPOPT alone takes 50 to 210
# iterations, with violations that stay for long.
SLOW = 1.3


def weak() -> Problem:
    return limited_reach(TOO_WEAK)


def hopping(**values: object) -> Problem:
    return problems.load("hopper-hop", **values)


def test_goal_that_torques_do_not_reach_is_certified_with_both_by_name_and_place():
    statistics = solve(weak()).statistics
    assert statistics.status == "infeasible"
    assert statistics.solver_status == CERTIFIED
    assert statistics.certified_infeasible is True
    assert not statistics.success
    assert statistics.iterations <= FEW
    assert statistics.max_violation > 0
    for words in ("terminal_", "torque_limits [joint torque]", "t = ", "phase 'reach'", ", against "):
        assert words in statistics.advice
    assert len(statistics.advice.splitlines()) == 3


@pytest.mark.long
def test_hop_without_the_friction_for_it_is_certified():
    statistics = solve(hopping(distance=0.6, friction=0.05)).statistics
    assert statistics.solver_status == CERTIFIED
    assert statistics.iterations <= FEW
    assert "friction_pyramid [foot force" in statistics.advice


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_slow_but_feasible_solves_are_not_given_up(seed):
    found = solve(hopping(flight=SLOW), seed=seed, perturb=0.1)
    assert found.converged, found.statistics.advice


@pytest.mark.long
def test_limit_of_iterations_counts_those_of_the_elastic_problem():
    full = solve(weak()).statistics.iterations
    for limit in range(8, full, 6):
        statistics = solve(weak(), max_iterations=limit).statistics
        assert statistics.iterations <= limit
        assert statistics.status == "iteration_limit"


def test_time_limit_holds():
    statistics = solve(weak(), max_time=1e-3).statistics
    assert statistics.status == "time_limit"


@pytest.mark.long
def test_stop_during_the_elastic_problem_is_an_interrupt():
    seen: list[float] = []
    full = solve(weak(), progress=lambda figures: seen.append(figures["restoration"]) or True)
    assert full.statistics.solver_status == CERTIFIED
    inside = len(seen) - 3  # of the elastic problem, which comes last
    calls = iter(range(len(seen)))
    stopped = solve(weak(), progress=lambda _: next(calls) < inside)
    assert stopped.statistics.status == "interrupted"
    assert not stopped.statistics.certified_infeasible


def test_iterations_are_told_in_order_with_the_iterates_of_the_problem():
    numbers: list[float] = []
    sizes: set[int] = set()

    def look(iterate):
        if iterate.stage == "iteration":
            numbers.append(iterate.figures["iteration"])
            sizes.add(iterate.unknowns.size)

    found = solve(weak(), watch=look)
    assert numbers == sorted(numbers)
    assert sizes == {found.statistics.variables}
