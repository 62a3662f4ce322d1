"""Motions are solved again until their bodies are clear, on the side that the guess takes."""

from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest

import trajopt
from tests.support.swings import BALL, END, FAR, MARGIN, POLE, START, avoided, past, rods, swing
from trajopt.certify.check import check
from trajopt.errors import InputError
from trajopt.motion.configurations import SolutionMotion
from trajopt.motion.solution import Solution
from trajopt.problem import PosturePath
from trajopt.problem.problem import Problem
from trajopt.robot.robot import Robot
from trajopt.solving.exchange import GAP_SLACK, Exchange
from trajopt.solving.graded import solve as solve_graded
from trajopt.solving.solving import solve

pytestmark = pytest.mark.long

BETWEEN = 2e-3  # m; what one more round would gain
EQUAL = 1e-6  # of the objective; the solver's tolerance
# A link may be this deep in the ground, m; looked at this many times a second.
DEPTH, RATE = 1e-3, 1000


def least(problem: Problem, solution: Solution) -> float:
    """Least distance less the margin along a motion, m."""
    exchange = Exchange(problem)
    return float((exchange.look(solution).distances - exchange.bodies.margins).min())


def test_clear_motion_is_solved_once():
    problem = past(swing(), FAR)
    solution = solve_graded(problem, fixed_mesh=True)
    assert solution.statistics.constraints == solve(swing()).statistics.constraints
    assert check(solution).obstacle_distance > 1


def test_motion_through_the_ball_is_led_past_it_at_the_margin():
    problem, solution = avoided()
    assert least(problem, solve(problem)) < -0.05
    assert solution.success
    report = check(solution)
    assert report.ok, report.failures()
    assert -GAP_SLACK < least(problem, solution) < BETWEEN
    assert report.obstacle_distance == pytest.approx(MARGIN, abs=BETWEEN)
    assert report.self_distance is None


def test_pole_is_not_passed_between_points():
    problem = past(swing(), POLE)
    slipped = solve(problem)
    assert least(problem, slipped) < -0.1
    solution = solve_graded(problem, fixed_mesh=True)
    assert solution.success
    assert least(problem, solution) > -GAP_SLACK
    assert check(solution).ok


@pytest.mark.parametrize("side", [1, -1])
def test_obstacle_in_the_way_is_passed_on_the_side_of_the_guess(side):
    bent = np.array([0.45, 1.2 * side, 0.0])
    guess = PosturePath(model=rods().model, postures=(START, bent, END), durations=(0.75, 0.75))
    problem = past(swing(guess=guess), POLE)
    solution = solve_graded(problem, fixed_mesh=True)
    assert solution.success
    assert least(problem, solution) > -GAP_SLACK
    elbow = solution.q[:, 1]
    assert side * elbow[np.abs(elbow).argmax()] > 0.3


def test_links_keep_clear_of_each_other():
    """Folding from one side to the other: the straight way dips below the margin, both ends do not."""
    robot = replace(rods(), reference=np.array([0.0, 1.0, 1.0]))
    problem = past(
        swing(np.array([0.0, 1.2, 2.7]), np.array([0.0, 2.6, 1.4]), robot=robot),
        self_collision=True,
        margin=0.028,
    )
    assert least(problem, solve(problem)) < -5 * GAP_SLACK
    solution = solve_graded(problem, fixed_mesh=True)
    assert solution.success
    assert -GAP_SLACK < least(problem, solution) < BETWEEN
    report = check(solution)
    assert report.self_distance == pytest.approx(0.028, abs=BETWEEN)
    assert report.obstacle_distance is None


def test_without_self_collision_links_may_come_near():
    robot = replace(rods(), reference=np.array([0.0, 1.0, 1.0]))
    ends = np.array([0.0, 1.2, 2.7]), np.array([0.0, 2.6, 1.4])
    problem = past(swing(*ends, robot=robot), self_collision=False, margin=0.028)
    solution = solve_graded(problem, fixed_mesh=True)
    assert solution.statistics.objective == pytest.approx(
        solve(swing(*ends, robot=robot)).statistics.objective, rel=EQUAL
    )


def test_motion_that_is_not_solved_is_returned_as_it_is():
    problem = past(swing(), BALL)
    solution = solve_graded(problem, fixed_mesh=True, max_iterations=0)
    assert not solution.success


def test_goal_in_an_obstacle_is_refused_before_anything_is_solved():
    over = replace(BALL, centre=np.array([1.3, 0.0, 0.5]))
    iterations = []
    with pytest.raises(InputError, match=r"'joint2' in q of terminal_state is .* m from 'ball'"):
        solve_graded(past(swing(), over), progress=iterations.append)
    assert not iterations


def test_way_that_is_barred_is_returned_with_what_is_missing():
    """A ball in the way of the first link, which turns about a fixed axis."""
    barred = replace(BALL, centre=np.array([0.15, 0.0, 0.3]))
    problem = past(swing(), barred)
    solution = solve_graded(problem, fixed_mesh=True, max_iterations=60)
    exchange = Exchange(problem)
    assert ("joint0", "ball") in exchange.missing(exchange.look(solution))
    assert "obstacle_distance" in check(solution).failures()
    assert not solution.success


def depth_in_ground(robot: Robot, solution: Solution) -> float:
    """Largest depth, m, of the description's own collision geometry in level ground, by Coal at 1 kHz."""
    geometry = robot.visual.geometry(robot.model, pin.GeometryType.COLLISION)
    for entry in geometry.geometryObjects:
        if isinstance(entry.geometry, coal.BVHModelBase):
            entry.geometry.buildConvexHull(True, "Qt")
            entry.geometry = entry.geometry.convex
    ground, still = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0), coal.Transform3s()
    motion, data, deepest = SolutionMotion(solution), robot.model.createData(), -np.inf
    places = pin.GeometryData(geometry)
    for t in np.arange(solution.t[0], solution.t[-1], 1 / RATE):
        pin.updateGeometryPlacements(robot.model, data, geometry, places, motion(float(t)))
        for entry, place in zip(geometry.geometryObjects, places.oMg, strict=True):
            at = coal.Transform3s(place.rotation, place.translation)
            request, result = coal.DistanceRequest(), coal.DistanceResult()
            deepest = max(deepest, -coal.distance(entry.geometry, at, ground, still, request, result))
    return deepest


@pytest.mark.slow
def test_knees_of_a_far_jump_stay_out_of_the_ground():
    problem = trajopt.load("solo12-jump", distance=0.8)
    grid = {"transcription": "legendre:3", "intervals": 20}
    assert depth_in_ground(problem.robot, solve(problem, **grid)) > 0.1
    solution = solve_graded(problem, **grid)
    assert solution.converged
    assert least(problem, solution) > -GAP_SLACK
    assert {"link_depth", "self_distance"}.isdisjoint(check(solution).failures())
    assert depth_in_ground(problem.robot, solution) < DEPTH
