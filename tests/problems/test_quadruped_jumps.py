"""Leaps of quadrupeds: as large as joints allow, solved and checked, and what a turn in the air claims."""

import math
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.solved_problems import motion
from trajopt.certify.check import check
from trajopt.certify.report import AT_POINTS
from trajopt.collision import robot_shapes
from trajopt.errors import InputError
from trajopt.robot.kinematics import contact_positions, frame_pose
from trajopt.robot.legs import leg_joints, quadruped_legs
from trajopt.solving.solving import solve
from trajopt.terms import FrameDirection, FramesAbove
from trajopt_library import problems, robots
from trajopt_library.problems import (
    common,
    leaping,
    pushing,
    quadruped_box,
    quadruped_flip,
    quadruped_jump,
    quadruped_stand_up,
)

FAMILIES = (
    *(family.name for family in quadruped_jump.FAMILIES),
    *(family.name for family in quadruped_box.FAMILIES),
    *(family.name for family in quadruped_flip.FAMILIES),
    quadruped_stand_up.FAMILY.name,
)
# What a solver leaves that stops at 1e-6 in natural units.
SOLVED = 1e-5
# Feet drift between collocation points by less than the check allows, and the body with them: m, rad.
DRIFT = 1e-3
# The same in a fifth of a second, m/s and rad/s.
DRIFT_RATE = 5e-3
# Finite differences of inverse kinematics at 1e-10 over steps of 1e-4: their error.
DIFFERENCE = 1e-4


@lru_cache
def takeoff(name: str) -> pushing.Takeoff:
    return pushing.takeoff(robots.load(name))


@pytest.mark.long
@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.parametrize("robot", ["solo12", "laikago"])
def test_every_leap_is_made_for_any_quadruped(name, robot):
    problem = problems.load(name, robot=robot)
    assert problem.robot.name == robot
    start, end = problem.guess(0.0), problem.guess(problem.schedule.duration)
    assert_allclose(pin.difference(problem.robot.model, start, problem.initial_q), 0.0, atol=SOLVED)
    lower, upper = problem.robot.position_lower, problem.robot.position_upper
    assert np.all(end >= lower - SOLVED)
    assert np.all(end <= upper + SOLVED)


@pytest.mark.parametrize("name", FAMILIES)
def test_robots_that_are_no_quadrupeds_are_refused(name):
    with pytest.raises(InputError):
        problems.load(name, robot="talos" if name != FAMILIES[0] else "ur5")


@pytest.mark.parametrize("name", ["go2", "anymal_c"])
def test_speed_at_takeoff_is_within_joint_rates_by_finite_differences(name):
    found = takeoff(name)
    robot, step = found.robot, 1e-4
    q, above = (pushing.raised(robot, found.rise + d).q for d in (0.0, step))
    rates = np.abs(above - q)[7:] / step * found.speed
    use = (rates / robot.velocity_limit[6:]).max()
    assert use < 1 + 100 * DIFFERENCE
    # Both robots are limited by the rates of their knees, not by torques.
    assert_allclose(use, 1.0, rtol=100 * DIFFERENCE)


def test_speed_at_takeoff_is_what_weak_torques_can_work():
    """Torques that hold 1.3 times the weight at the lowest point of the push: slower than with twice."""
    robot = robots.load("solo12")
    lowest = pushing.raised(robot, -pushing.SINK_PART * robot.length).q
    strength = pushing.strongest(robot, lowest, np.ones(12))
    weak, strong = (pushing.takeoff(robot, torque_limit=share / strength) for share in (1.3, 2.0))
    assert 0.0 < weak.speed < strong.speed < math.inf
    # No push does more work than the largest force along the whole way.
    force = pushing.strongest(robot, weak.posture, np.full(12, 1.3 / strength)) - 1
    way = pushing.SINK_PART * robot.length + weak.rise
    assert weak.speed**2 / (2 * 9.81) < force * way
    assert math.isinf(pushing.strongest(robot, robot.reference, None))


def test_extension_is_where_the_first_leg_is_straight():
    robot = robots.load("a1")
    left = pushing.extension_left(robot)
    assert pushing.raised(robot, left).error < pushing.REACHED
    assert pushing.raised(robot, left + 2 * pushing.EXTENSION_ERROR * robot.length).error > pushing.REACHED


def test_defaults_are_smaller_where_joints_are_slow():
    slow, fast = (problems.load("quadruped-jump-up", robot=name) for name in ("anymal_c", "anymal_b"))
    assert slow.parameters["height"] / slow.robot.length < 0.5 * fast.parameters["height"] / fast.robot.length
    rise = fast.parameters["height"] - takeoff("anymal_b").rise
    assert_allclose(fast.parameters["flight"], 2 * math.sqrt(2 * rise / 9.81), rtol=1e-3)


@pytest.mark.long
def test_guess_of_a_flip_turns_all_around_and_lands_where_it_lifted():
    problem = problems.load("quadruped-backflip", robot="solo12")
    times = np.linspace(0.0, problem.schedule.duration, 400)
    rotations = [pin.XYZQUATToSE3(problem.guess(t)[:7]).rotation for t in times]
    turned = sum(pin.log3(b @ a.T) for a, b in pairwise(rotations))
    assert_allclose(turned, [0.0, -2 * math.pi, 0.0], atol=SOLVED)
    legs, feet = quadruped_legs(problem.robot), contact_positions(problem.robot, problem.initial_q)
    landed = contact_positions(problem.robot, problem.guess(problem.schedule.duration))
    assert_allclose(landed[legs.front_left], feet[legs.hind_left], atol=SOLVED)


def test_a_box_higher_than_the_rise_is_refused():
    with pytest.raises(InputError, match="rise"):
        problems.load("quadruped-box-up", robot="solo12", height=0.2, rise=0.1)


@pytest.mark.parametrize(("robot", "height"), [("go2", 0.1), ("go2", 0.25), ("a1", 0.2), ("solo12", 0.15)])
def test_flight_onto_a_box_ends_in_a_fall_from_its_apex(robot, height):
    """So the feet have time to pass the edge: a flight that ends at its apex has none."""
    problem = problems.load("quadruped-box-up", robot=robot, height=height)
    flight = problem.parameters["flight"]
    begin = problem.schedule.phases[0].duration
    heights = [problem.guess(begin + s * flight)[2] for s in np.linspace(0.01, 0.99, 99)]
    assert max(heights) - heights[-1] > 0.8 * quadruped_box.FALL * problem.robot.length


@pytest.mark.parametrize(("kind", "posture"), [("box-up", "initial_q"), ("box-down", None)])
def test_robot_beside_a_box_stays_clear_of_it_with_its_base_sunk(kind, posture):
    problem = problems.load(f"quadruped-{kind}", robot="go2", height=0.25)
    robot = problem.robot
    place = problem.initial_q if posture else problem.guess(problem.schedule.duration)
    sunk = pushing.raised(robot, -pushing.sink_of(robot)).q
    sunk[:3] += place[:3] - robot.reference[:3]
    distances = robot_shapes(robot).scene(robot.model, problem.terrain).distances(sunk)[0]
    assert distances.min() > -SOLVED


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "height"), [("go2", 0.2), ("go2", 0.25), ("solo12", 0.15)])
def test_leap_onto_a_high_box_holds_at_any_time(robot, height):
    solution = motion("quadruped-box-up", robot=robot, height=height)
    assert solution.success, solution.statistics.advice


def test_legs_that_cannot_fold_so_far_are_refused():
    with pytest.raises(InputError, match="fold"):
        problems.load("quadruped-stand-up", robot="go2", depth=0.3)


def test_bad_terms_of_frames_are_refused():
    with pytest.raises(InputError):
        FramesAbove(frames=(), height=0.0)
    good = {"frame": "base_link", "axis": (0, 0, 1), "direction": (0, 0, 1), "angle": 1.0, "phase": "flight"}
    for bad in (
        {"axis": (0, 0, 0)},
        {"direction": (0, 0)},
        {"angle": 0.0},
        {"angle": 4.0},
        {"fraction": 2.0},
    ):
        with pytest.raises(InputError):
            FrameDirection(**(good | bad))


def test_leg_joints_are_hips_and_knees():
    assert leg_joints(robots.load("solo12"))[:2] == ("FL_HAA", "FL_KFE")
    assert len(leg_joints(robots.load("anymal_c"))) == 8


def solved(name, **parameters):
    problem = problems.load(name, **parameters)
    solution = solve(problem)
    assert solution.converged, solution.statistics.advice
    report = check(solution)
    assert report.within(AT_POINTS), report.table()
    return problem, solution


@pytest.mark.long
def test_jump_turns_and_lands_at_rest():
    problem, solution = solved("quadruped-jump-turn", robot="solo12")
    end = common.displaced(problem.robot, (0, 0, 0), problem.parameters["yaw"])
    assert_allclose(pin.difference(problem.robot.model, solution.q[-1], end), 0.0, atol=DRIFT)
    assert_allclose(solution.v[-1], 0.0, atol=DRIFT_RATE)
    flight = solution.phase == 1
    assert solution.q[flight, 2].max() >= problem.initial_q[2] + problem.parameters["height"] - SOLVED


@pytest.mark.slow
@pytest.mark.parametrize("name", ["quadruped-backflip", "quadruped-barrel-roll"])
def test_flip_turns_all_around_about_its_axis(name):
    problem, solution = solved(name, robot="solo12")
    turn = np.zeros(3)
    for v, dt in zip(solution.v[:-1], np.diff(solution.t), strict=True):
        turn += v[3:6] * dt  # about the body's own axes, along which it turns
    axis = 1 if name == "quadruped-backflip" else 0
    assert abs(turn[axis]) > 0.9 * 2 * math.pi
    down = [pin.XYZQUATToSE3(q[:7]).rotation[2, 2] for q in solution.q]
    assert min(down) < -0.9
    for frame in leaping.hips_and_knees(problem.robot):
        heights = [frame_pose(problem.robot, q, frame).translation[2] for q in solution.q]
        assert min(heights) > 0.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["quadruped-box-up", "quadruped-gap"])
def test_feet_clear_the_edge(name):
    problem, solution = solved(name, robot="solo12")
    for q in solution.q:
        for place in contact_positions(problem.robot, q).values():
            assert place[2] > problem.terrain.height(place[0], place[1]) - 1e-3


@pytest.mark.long
def test_robot_stands_up_in_least_time_faster_than_with_least_effort():
    _, slow = solved("quadruped-stand-up", robot="solo12")
    _, fast = solved("quadruped-stand-up", robot="solo12", goal="time")
    assert fast.t[-1] < 0.5 * slow.t[-1]
