"""arm-avoid: the straight joint path collides, the guess does not, and the solution passes the check."""

import math
from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest

from tests.support.refusals import refused
from tests.support.solved_problems import motion
from trajopt.certify.check import check
from trajopt.collision.description import robot_shapes
from trajopt.problem.bodies import ProblemBodies, bodies_of
from trajopt.problem.problem import Problem
from trajopt.robot.kinematics import frame_pose
from trajopt.solving.exchange import GAP_SLACK, Exchange
from trajopt.solving.graded import solve as solve_graded
from trajopt.solving.solving import solve as solve_on_mesh
from trajopt.terms import Clearance
from trajopt.terrain import smooth_step
from trajopt_library.problems import arm_avoid

POSE = 1e-6  # m and 1; what the solver's tolerance leaves
BETWEEN = 2e-3  # m; between the looks, and what one more look would gain
OTHERS = ("xarm7", "z1")  # arms that the family does not name


@lru_cache
def problem(robot: str) -> Problem:
    return arm_avoid.FAMILY.load({"robot": robot})


@lru_cache
def bodies(robot: str) -> ProblemBodies:
    return bodies_of(problem(robot))


@pytest.mark.long
@pytest.mark.parametrize("robot", [*arm_avoid.FAMILY.robots, *OTHERS])
def test_straight_joint_path_collides_and_the_guess_does_not(robot):
    built = problem(robot)
    scene, model, duration = bodies(robot).scene, built.robot.model, built.schedule.phases[0].duration
    start, goal = built.guess(0.0), built.guess(duration)
    way = pin.difference(model, start, goal)
    times = np.linspace(0.0, 1.0, 60)
    straight = scene.least_distances(pin.integrate(model, start, float(smooth_step(s)) * way) for s in times)
    by_obstacle = {
        name: min(d for (_, other), d in zip(scene.pairs, straight, strict=True) if other == name)
        for name in ("box", "post")
    }
    assert max(by_obstacle.values()) < -0.01  # both are in the way
    along = scene.least_distances(built.guess(s * duration) for s in times)
    assert along[scene.n_ground :].min() > 0


@pytest.mark.parametrize("robot", arm_avoid.FAMILY.robots)
def test_guess_starts_and_ends_at_rest_at_the_ends(robot):
    built, step = problem(robot), 1e-4
    duration = built.schedule.phases[0].duration
    assert built.guess(0.0) == pytest.approx(built.initial_q)
    for end, inside in ((0.0, step), (duration, duration - step)):
        moved = pin.difference(built.robot.model, built.guess(end), built.guess(inside))
        assert np.abs(moved).max() < step**2 / duration


@pytest.mark.long
@pytest.mark.parametrize("robot", ["ur5", "irb1600"])
def test_solution_is_clear_and_brings_the_tool_to_its_goal(robot):
    built = problem(robot)
    solution = solve_graded(built, fixed_mesh=True)
    assert solution.success, solution.statistics.advice
    report, exchange = check(solution), Exchange(built)
    assert report.ok, report.failures()
    assert report.obstacle_distance > built_margin(robot) - GAP_SLACK
    assert exchange.missing(exchange.look(solution)) == ()
    (tool,) = {term.frame for term in built.terms if hasattr(term, "frame")}
    end = built.guess(built.schedule.phases[0].duration)
    goal, reached = (frame_pose(built.robot, q, tool) for q in (end, solution.q[-1]))
    assert np.abs(goal.homogeneous - reached.homogeneous).max() < POSE


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["panda", "kinova", *OTHERS])
def test_other_arms_get_past_too(robot):
    solution = motion("arm-avoid", robot=robot)
    assert solution.success, solution.statistics.advice
    assert check(solution).ok
    assert check(solution).obstacle_distance > built_margin(robot) - BETWEEN


@pytest.mark.long
def test_motion_keeps_no_more_than_the_margin():
    built = problem("ur5")
    exchange = Exchange(built)
    distances = exchange.look(solve_graded(built, fixed_mesh=True)).distances
    scene = exchange.bodies.scene
    least = distances[:, scene.n_ground : scene.n_outer].min()
    assert built_margin("ur5") - GAP_SLACK < least < built_margin("ur5") + BETWEEN


def test_motion_that_knows_no_obstacle_collides():
    solution = solve_on_mesh(problem("ur5"))
    assert check(solution).obstacle_distance < -0.01


def test_arm_has_the_shapes_of_its_description_or_boxes():
    assert bodies("ur5").scene.shapes == robot_shapes(problem("ur5").robot).shapes
    assert {shape.kind for shape in bodies("irb1600").scene.shapes} == {"box"}


def test_obstacles_scale_with_the_arm():
    sizes = [
        next(o for o in bodies(r).scene.obstacles if o.name == "post").radius / problem(r).robot.length
        for r in ("ur5", "irb1600")
    ]
    assert sizes[0] == pytest.approx(sizes[1])


def built_margin(robot: str) -> float:
    (term,) = (term for term in problem(robot).terms if isinstance(term, Clearance))
    return term.margin


def test_margin_is_a_share_of_the_reach():
    assert built_margin("ur5") == pytest.approx(0.01 * problem("ur5").robot.length)
    assert bodies("ur5").widest == pytest.approx(built_margin("ur5"))


BAD = {
    "legs": ({"robot": "solo12"}, "no tool"),
    "reach": ({"radius": 1.0}, "ur5.* cannot bring"),
    "margin": ({"margin": 0.5}, "margin"),
    "turn": ({"turn": "200deg"}, "turn"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_parameters_are_refused_in_one_line(case):
    values, message = BAD[case]
    with refused(message):
        arm_avoid.FAMILY.load(values)


def test_duration_may_be_given():
    built = arm_avoid.FAMILY.load({"duration": 3.0, "turn": math.radians(40)})
    assert built.schedule.phases[0].duration == 3.0
    assert built.parameters["duration"] == 3.0
