"""Starts on and beyond limits, friction of 0 to 100, weights of 1e-9 and 1e9."""

from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.extremes.changed_robots import limited, solo, ur5
from tests.extremes.moves import reach, stance, stand, with_joints
from tests.extremes.outcomes import Failed, Refused, Solved, assert_outcome
from trajopt import Problem, Solution
from trajopt.solvers.status import Status
from trajopt.terms import Cost, NodeCost, TorqueLimits
from trajopt_library import problems, robots

# Open-loop error (rad) of an arm's second of motion on ten intervals of degree two; measured up to 2e-2.
ARM = 5e-2
# Of a stance of 0.4 s, over the robot's length or rad; measured up to 2e-4.
STANCE = 2e-3
# A start may exceed a limit by this part of it.
SLACK = 1e-6


def test_a_joint_starts_exactly_on_its_limit():
    start = with_joints(ur5(), {"elbow_joint": float(ur5().position_upper[2])})
    goal = with_joints(ur5(), {"elbow_joint": 2.0})
    solution = assert_outcome(Solved(ARM), lambda: reach(ur5(), start, goal))
    assert solution.q[:, 2].max() <= ur5().position_upper[2] * (1 + SLACK)


@pytest.mark.parametrize("beyond", [1e-4, 0.2, 5.0])
def test_a_joint_that_starts_beyond_its_limit_is_refused(beyond):
    start = with_joints(ur5(), {"elbow_joint": float(ur5().position_upper[2]) + beyond})
    assert_outcome(
        Refused(r"joint 'elbow_joint' is at 3\.1\d+|joint 'elbow_joint' is at [38]\.\d+, beyond"),
        lambda: reach(ur5(), start, ur5().reference),
    )


def test_a_joint_beyond_a_limit_too_wide_for_rows_is_refused():
    """A limit a turn from the reference makes no rows, and is a limit all the same."""
    start = with_joints(ur5(), {"shoulder_pan_joint": 7.0})
    assert_outcome(
        Refused("joint 'shoulder_pan_joint' is at 7, beyond"), lambda: reach(ur5(), start, ur5().reference)
    )


def test_a_start_beyond_a_limit_that_nothing_states_is_free():
    start = with_joints(ur5(), {"elbow_joint": float(ur5().position_upper[2]) + 0.2})
    make = lambda: reach(ur5(), start, ur5().reference, limits=(TorqueLimits(),))  # noqa: E731
    solution = assert_outcome(None, make)
    assert solution.converged


@pytest.mark.parametrize("part", [1.0, -1.0])
def test_a_joint_starts_at_its_largest_rate(part):
    velocity = np.zeros(6)
    velocity[0] = part * ur5().velocity_limit[0]
    goal = ur5().reference + np.array([part * 0.5, 0.1, 0.1, 0.1, 0.1, 0.1])
    assert_outcome(Solved(ARM), lambda: reach(ur5(), ur5().reference, goal, velocity=velocity))


@pytest.mark.parametrize("part", [1.001, -1.5])
def test_a_joint_that_starts_faster_than_its_limit_is_refused(part):
    velocity = np.zeros(6)
    velocity[0] = part * ur5().velocity_limit[0]
    make = lambda: reach(ur5(), ur5().reference, ur5().reference, velocity=velocity)  # noqa: E731
    assert_outcome(
        Refused("joint 'shoulder_pan_joint' moves at .* velocity_limits; allowed: -3.15 to 3.15"), make
    )


def test_all_joints_of_a_quadruped_stand_exactly_on_both_limits():
    """No joint may move at all: a feasible set without an inside, on which to stand still."""
    q = solo().reference
    lower, upper = solo().position_lower.copy(), solo().position_upper.copy()
    lower[7:], upper[7:] = q[7:], q[7:]
    robot = replace(solo(), position_lower=lower, position_upper=upper)
    solution = assert_outcome(Solved(STANCE), lambda: stance(robot, q, intervals=6))
    assert_allclose(solution.q[:, 7:], np.tile(q[7:], (len(solution.t), 1)), atol=1e-6)


def test_joints_whose_largest_rate_is_zero_stand_still():
    robot = replace(solo(), velocity_limit=np.where(np.isfinite(solo().velocity_limit), 0.0, np.inf))
    solution = assert_outcome(Solved(STANCE), lambda: stance(robot, robot.reference, intervals=6))
    assert np.abs(solution.v).max() < 1e-6


def largest_torque() -> float:
    """Of standing with least effort, N m."""
    solution = assert_outcome(Solved(STANCE), lambda: stance(solo(), solo().reference, intervals=4))
    return float(np.abs(solution.tau).max())


@pytest.mark.long
def test_standing_at_the_torque_limit_is_solved_and_at_half_of_it_not():
    need = largest_torque()
    at = assert_outcome(Solved(STANCE), lambda: stance(limited(need), solo().reference, intervals=4))
    assert np.abs(at.tau[at.collocation]).max() <= need * (1 + 10 * SLACK)
    weak = Failed(Status.INFEASIBLE, block="torque_limits")
    assert_outcome(weak, lambda: stance(limited(need / 2), solo().reference, intervals=4))
    assert_outcome(weak, lambda: stance(limited(0.0), solo().reference, intervals=4))


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


# Rounding, which iterations of a solver multiply.
SAME = 1e-9
# What a weight of 1e-9 leaves of a cost beside others of about one: as good as none, and the same the other
# way round. Both optima are flat: objectives agree to the solver's tolerance, motions to its square root.
NEXT_TO_NONE, FLAT = 1e-4, 5e-2
# Family, intervals, open loop, rad and parts of the length.
MOTIONS = {"ur5-reach": (10, 0.5), "hopper-hop": (40, 0.3), "solo12-jump": (15, 3.0)}
WILD = 20.0  # times that, where nothing holds accelerations or torques back on such grids
COARSE_GRID = 0.05  # m, between the points of these grids
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
    expected = Solved(open_loop=open_loop if cost is None else WILD * open_loop, coarse=COARSE_GRID)
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
