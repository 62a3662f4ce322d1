"""Tracking of references: the cost, its parameters, and references themselves."""

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.goals import integral, objective, sampled, wandering, with_terms
from tests.support.problems import REACH, REACH_TIME, hop, hopper, one_joint_arm, reach
from trajopt.errors import InputError
from trajopt.motion.configurations import geodesic_motion
from trajopt.problem.problem import Problem
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.solving.solving import prepare, solve
from trajopt.terms import TorqueCost, TrackingCost
from trajopt.terms.tracking import key_frames
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.swing_paths import smooth_step
from trajopt_library import robots

# Sums of the same numbers in another order.
ROUNDING = 1e-11
# The solver's tolerance of 1e-6 on scaled rows and multipliers, with two orders for conditioning.
SOLVED = 1e-4
# The base quaternion of a free-flyer with the other sign.
AHEAD = np.array([1.0] + [0.0] * 8)
SIGNS = np.array([1.0] * 3 + [-1.0] * 4 + [1.0] * 2)


@pytest.mark.long
@pytest.mark.parametrize("part", ["all", "joints", "base"])
def test_tracking_cost_is_the_mean_square_distance_at_every_point(part):
    robot = hopper()
    problem, reference = (
        replace(hop(), guess=wandering(robot)),
        key_frames(robot, [0.0, 0.3, 1.0], np.array([wandering(robot)(t + 2.0) for t in (0.0, 0.5, 0.7)])),
    )
    solution, x = sampled(problem)
    distance = np.array(
        [_distance(robot, q, reference(t)) for q, t in zip(solution.q, solution.t, strict=True)]
    )
    rows = {"all": slice(0, 8), "joints": slice(6, 8), "base": slice(0, 6)}[part]
    expected = integral(solution, (distance[:, rows] ** 2).mean(axis=1)) / Units(robot).time
    cost = TrackingCost(weight=1.0, reference=reference, part=part)
    assert_allclose(objective(with_terms(problem, cost), x), expected, rtol=1e-9)
    other_sign = TrackingCost(weight=1.0, reference=lambda t: reference(t) * SIGNS, part=part)
    assert_allclose(objective(with_terms(problem, other_sign), x), expected, rtol=1e-9)


def _distance(robot: Robot, q: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Base position over the length, 2 sin(angle / 2) along the turn's axis, joints over their unit (nv,)."""
    turn = pin.log3((pin.XYZQUATToSE3(goal[:7]).inverse() * pin.XYZQUATToSE3(q[:7])).rotation)
    angle = np.linalg.norm(turn)
    chord = turn * 2 * math.sin(angle / 2) / angle
    return np.concatenate(
        [(q[:3] - goal[:3]) / robot.length, chord, (q[7:] - goal[7:]) / [1.0, robot.length]]
    )


def test_whole_turns_do_not_count_in_tracking():
    pendulum = robots.load("double_pendulum")
    schedule = Schedule((Phase(name="swing", duration=1.0),))
    problem = Problem(
        name="turns", robot=pendulum, schedule=schedule, terrain=FlatGround(),
        initial_q=pendulum.reference, initial_v=np.array([9.0, 1.0]), terms=(TorqueCost(weight=1.0),),
        guess=lambda t: pin.integrate(pendulum.model, pendulum.reference, np.array([9.0 * t, t])),
    )  # fmt: skip
    cost = TrackingCost(weight=1.0, reference=problem.guess)
    assert_allclose(objective(with_terms(problem, cost)), 0.0, atol=1e-20)


def test_a_feasible_reference_is_followed_exactly():
    robot = one_joint_arm(gravity=True)
    motion = key_frames(robot, [0.0, REACH_TIME], np.array([[0.0], [REACH]]))

    def smooth(t):
        return motion(REACH_TIME * smooth_step(t / REACH_TIME))

    solution = solve(
        with_terms(reach(gravity=True), TrackingCost(weight=1.0, reference=smooth)), intervals=20
    )
    points = solution.collocation
    followed = np.array([smooth(t) for t in solution.t[points]])
    assert_allclose(solution.q[points], followed, atol=SOLVED)


def test_another_reference_is_the_same_function_with_other_parameters():
    groups = []
    for shift in (0.0, 0.1):
        reference = key_frames(hopper(), [0.0, 1.0], np.tile(hopper().reference + shift * AHEAD, (2, 1)))
        problem = with_terms(hop(), TrackingCost(weight=1.0, reference=reference))
        groups.append(prepare(problem, intervals=6).transcription.groups)
    first, second = groups
    assert [group.point.text for group in first] == [group.point.text for group in second]
    assert any(not np.array_equal(a.parameters, b.parameters) for a, b in zip(first, second, strict=True))


def test_a_solution_is_a_reference_for_its_own_robot_only():
    solution = solve(reach(), intervals=6)
    motion = geodesic_motion(solution, one_joint_arm())
    assert_allclose(motion(0.0), solution.q[0])
    assert_allclose(motion(9.0), solution.q[-1])
    with pytest.raises(InputError, match="joints"):
        geodesic_motion(solution, hopper())
