"""Friction of 0, 0.01, 5 and 100: what holds without it, what does not, and what more of it changes."""

from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.extremes.motions import stand
from tests.extremes.outcomes import Failed, Refused, Solved, assert_outcome
from trajopt.solvers.status import Status
from trajopt_library import problems, robots

FRICTIONS = [0.0, 0.01, 5.0, 100.0]
# A push of the base this part of its natural speed, sqrt(g l): a tenth of a fast walk.
PUSH = (0.05, 0.05, 0.0, 0.0, 0.0, 0.0)
# Forces over the weight, what tolerances leave; and feet between the points of coarse grids, m.
FORCE, COARSE = 1e-6, 0.02
# Iterations after which a task that has no solution is given up: several times what those with one take.
GIVEN_UP = 100


def tangential(solution) -> float:
    """Largest force along level ground over the weight, at collocation points."""
    weight = pin.computeTotalMass(solution.model) * 9.81
    return float(np.abs(solution.f[solution.collocation][..., :2]).max() / weight)


@pytest.mark.long
@pytest.mark.parametrize("friction", FRICTIONS)
@pytest.mark.parametrize("exact", [False, True], ids=["pyramid", "cone"])
def test_quadruped_stands_on_any_friction(friction, exact):
    make = partial(stand, robots.load("solo12"), friction=friction, exact=exact)
    solution = assert_outcome(Solved(open_loop=1e-3), make, intervals=8)
    assert tangential(solution) <= friction / 4 + FORCE if friction < 1 else 1


@pytest.mark.parametrize("friction", [5.0, 100.0])
def test_pushed_quadruped_comes_to_rest_on_high_friction(friction):
    make = partial(stand, robots.load("solo12"), friction=friction, push=PUSH)
    assert_outcome(Solved(open_loop=1e-2), make, intervals=8)


@pytest.mark.parametrize("friction", [0.0, 0.01])
def test_hopper_hops_on_the_spot_on_ice(friction):
    make = partial(problems.load, "hopper-hop", distance=0.0, friction=friction)
    solution = assert_outcome(Solved(open_loop=1e-2), make, intervals=40)
    if friction == 0.0:
        centre = [pin.centerOfMass(solution.model, solution.model.createData(), q)[0] for q in solution.q]
        assert_allclose(centre, centre[0], atol=1e-4)  # nothing pushes sideways; what 40 intervals leave


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.01])
def test_quadruped_jumps_straight_up_on_ice(friction):
    make = partial(problems.load, "solo12-jump", distance=0.0, friction=friction)
    assert_outcome(Solved(open_loop=0.5, coarse=COARSE), make, intervals=15)


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.01])
def test_quadruped_gets_nowhere_on_ice(friction):
    """Rows at the points of a coarse grid hold for feet that slide between them: no success either."""
    make = partial(problems.load, "solo12-jump", friction=friction)
    wrong = Failed(Status.COARSE_GRID, Status.INFEASIBLE, Status.ITERATION_LIMIT, Status.STEP_FAILED)
    assert_outcome(wrong, make, intervals=15, max_iterations=GIVEN_UP)


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.01])
def test_hopper_gets_nowhere_on_ice(friction):
    """Friction too small for the way: no feasible point, in the push where it would have to be made."""
    solution = assert_outcome(
        Failed(Status.INFEASIBLE, Status.ITERATION_LIMIT),
        partial(problems.load, "hopper-hop", friction=friction),
        intervals=40,
        max_iterations=GIVEN_UP,
    )
    assert solution.statistics.max_violation > 1e-3
    assert solution.statistics.worst_blocks[0]["phase"] in ("stance", "landing")


@pytest.mark.parametrize("friction", [-0.1, float("nan"), float("inf"), 100.0])
def test_friction_that_no_family_takes_is_refused(friction):
    assert_outcome(Refused("friction is .*allowed"), partial(problems.load, "hopper-hop", friction=friction))


@pytest.mark.parametrize("friction", [-0.1, float("nan"), float("inf")])
def test_invalid_friction_of_the_ground_is_refused(friction):
    assert_outcome(Refused("friction"), partial(stand, robots.load("solo12"), friction=friction))
