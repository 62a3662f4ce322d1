"""Starts on and beyond limits of positions, rates and torques."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.extremes.changed_robots import limited, solo, ur5
from tests.extremes.moves import reach, stance, with_joints
from tests.extremes.outcomes import Failed, Refused, Solved, assert_outcome
from trajopt.solvers.status import Status
from trajopt.terms import (
    TorqueLimits,
)

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
