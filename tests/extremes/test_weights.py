"""Weights of 1e-9 and 1e9: of all costs, which changes nothing, and of one among the others."""

from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.extremes.outcomes import Refused, Solved, assert_outcome
from trajopt.problem.problem import Problem
from trajopt.solution.solution import Solution
from trajopt.terms import Cost, NodeCost
from trajopt_library import problems

# Rounding, which iterations of a solver multiply.
SAME = 1e-9
# What a weight of 1e-9 leaves of a cost beside others of about one: as good as none, and the same the other
# way round. Both optima are flat: objectives agree to the solver's tolerance, motions to its square root.
NEXT_TO_NONE, FLAT = 1e-4, 5e-2
# Family, intervals, open loop, rad and parts of the length.
MOTIONS = {
    "ur5-reach": (10, 0.5),
    "hopper-hop": (40, 0.3),
    "solo12-jump": (15, 3.0),
}
WILD = 20.0  # times that, where nothing holds accelerations or torques back on such grids
COARSE = 0.05  # m, between the points of these grids
SHORT = ["ur5-reach", "hopper-hop", pytest.param("solo12-jump", marks=pytest.mark.slow)]


def weighed(name: str, factor: float, cost: str | None = None) -> Problem:
    """The problem with the weight of one cost, or of all, multiplied."""
    problem = problems.load(name)
    terms = tuple(
        replace(term, weight=factor * term.weight)
        if isinstance(term, Cost | NodeCost) and cost in (None, term.name)
        else term
        for term in problem.terms
    )
    return replace(problem, terms=terms)


@lru_cache
def solved(name: str, factor: float = 1.0, cost: str | None = None) -> Solution:
    intervals, open_loop = MOTIONS[name]
    expected = Solved(open_loop=open_loop if cost is None else WILD * open_loop, coarse=COARSE)
    return assert_outcome(expected, partial(weighed, name, factor, cost), intervals=intervals)


@pytest.mark.long
@pytest.mark.parametrize("factor", [1e-9, 1e9])
@pytest.mark.parametrize("name", SHORT)
def test_weights_all_multiplied_change_the_objective_alone(name, factor):
    own, found = solved(name), solved(name, factor)
    assert_allclose(found.statistics.objective / factor, own.statistics.objective, rtol=SAME)
    assert_allclose(found.q, own.q, atol=SAME)
    assert_allclose(found.tau, own.tau, atol=SAME * np.abs(own.tau).max())
    assert found.statistics.iterations == own.statistics.iterations


@pytest.mark.parametrize("cost", ["torque_cost", "acceleration_cost"])
@pytest.mark.parametrize("name", ["ur5-reach", pytest.param("hopper-hop", marks=pytest.mark.slow)])
def test_a_tiny_weight_acts_like_zero(name, cost):
    none, found = solved(name, 0.0, cost), solved(name, 1e-9, cost)
    assert_allclose(found.statistics.objective, none.statistics.objective, rtol=NEXT_TO_NONE)
    assert_allclose(found.q, none.q, atol=FLAT)


@pytest.mark.parametrize("cost", ["torque_cost", "acceleration_cost"])
@pytest.mark.parametrize("name", ["ur5-reach", pytest.param("hopper-hop", marks=pytest.mark.slow)])
def test_one_enormous_weight_decides(name, cost):
    """The others are a billionth of it: this cost is no more than it is beside them."""
    found, own = solved(name, 1e9, cost), solved(name)
    assert found.statistics.objective > 0
    assert cost_of(found, cost) <= cost_of(own, cost) * (1 + NEXT_TO_NONE)


def cost_of(solution: Solution, cost: str) -> float:
    """Sum of squares that the cost is about, by Gauss' weights of two points, up to its unit."""
    points = solution.collocation
    values = {"torque_cost": solution.tau, "acceleration_cost": solution.a}[cost][points]
    return float((values**2).sum())


@pytest.mark.parametrize("weight", [-1.0, float("nan"), float("inf")])
def test_an_invalid_weight_is_refused(weight):
    assert_outcome(
        Refused("weight of TorqueCost is .*finite number"),
        partial(weighed, "ur5-reach", weight, "torque_cost"),
    )
