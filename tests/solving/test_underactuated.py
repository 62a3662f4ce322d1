"""Passive joints at any place and thrusters: their problems are solved, and what they claim is so."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.solved_problems import motion
from trajopt.collision import BoxObstacle
from trajopt.errors import InputError, SolutionFileError
from trajopt.robot import Robot
from trajopt.solution.solution import Solution
from trajopt.terms import Clearance, Cost, TorqueCost
from trajopt_library import problems, robots

pytestmark = pytest.mark.long

# Rows hold to the solver's tolerance of 1e-6, over weight or weight times length.
SOLVED = 1e-5
# Kelly's figures are of trapezoidal and Hermite-Simpson meshes, 0.1 % above the limit of fine meshes.
PUBLISHED, ROUNDED = 58.83, 1e-3
SWING_UPS = ("cart-pole", "furuta", "pendubot")
FLIGHTS = ("quadrotor-window", "quadrotor-flip")


def heights_of(solution: Solution) -> np.ndarray:
    """Heights of the centre of mass (K,), m."""
    data = solution.model.createData()
    return np.array([pin.centerOfMass(solution.model, data, q)[2] for q in solution.q])


@pytest.mark.parametrize("name", SWING_UPS)
def test_a_passive_joint_swings_up_and_nothing_drives_it(name):
    problem, solution = problems.load(name), motion(name)
    robot = problem.robot
    assert solution.success, solution.statistics.failures
    assert trajopt.check(solution).ok
    data, free = solution.model.createData(), robot.model.joints[robot.model.getJointId(robot.passive[0])]
    for k in np.flatnonzero(solution.collocation):
        force = pin.rnea(solution.model, data, solution.q[k], solution.v[k], solution.a[k])
        assert_allclose(force[free.idx_v], 0.0, atol=SOLVED * robot.weight * robot.length)
        assert_allclose(np.delete(force, free.idx_v), solution.tau[k], atol=SOLVED * robot.weight)
    heights = heights_of(solution)
    assert heights[-1] == pytest.approx(heights.max(), abs=1e-6)
    assert heights[0] == pytest.approx(heights.min(), abs=1e-3 * robot.length)
    assert_allclose(solution.v[[0, -1]], 0.0, atol=SOLVED)


def test_the_cart_pole_costs_what_kelly_published():
    problem = problems.load("cart-pole")
    others = tuple(term for term in problem.terms if not isinstance(term, Cost))
    problem = replace(problem, terms=(*others, TorqueCost(weight=1.0)))
    solution = trajopt.solve(problem, transcription="legendre:3", intervals=50)
    dense = solution.sample(times=np.linspace(0.0, 2.0, 4001))
    assert np.trapezoid(dense.tau[:, 0] ** 2, dense.t) == pytest.approx(PUBLISHED, rel=ROUNDED)
    assert (np.abs(solution.q[:, 0]) <= 2.0).all()
    assert np.abs(solution.tau).max() <= 20.0


@pytest.mark.parametrize("name", [*SWING_UPS, *FLIGHTS])
def test_files_say_which_rows_are_driven_and_by_what(name, tmp_path):
    solution = motion(name)
    read = Solution.load(solution.save(tmp_path / "plan.npz"))
    assert read.torque_names == solution.torque_names
    np.testing.assert_array_equal(read.actuation.matrix, solution.actuation.matrix)
    assert trajopt.check(read).ok
    assert ("actuated_rows" in read.meta) == (name in SWING_UPS)
    assert ("thrusters" in read.meta) == (name in FLIGHTS)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("actuated_rows", [1, 0], "are no rows of v; ascending"),
        ("actuated_rows", [0, 1], "actuated_rows of meta has 2 entries, expected 1"),
        ("actuated_rows", [2], r"actuated_rows of meta are \[2\], of 2 rows of v"),
        ("actuated_rows", "first", "are no rows of v"),
        ("thrusters", [{}], "not an object of its fields"),
    ],
)
def test_wrong_rows_and_thrusters_in_a_file_are_refused(key, value, message, tmp_path):
    import json

    path = motion("cart-pole").save(tmp_path / "plan.npz")
    arrays = dict(np.load(path))
    arrays["meta"] = np.array(json.dumps({**json.loads(str(arrays["meta"])), key: value}))
    np.savez(path, **arrays)
    with pytest.raises(SolutionFileError, match=message):
        Solution.load(path)


@pytest.mark.parametrize("name", FLIGHTS)
def test_a_quadrotor_flies_by_its_propellers_alone(name):
    robot, solution = robots.load("iris"), motion(name)
    assert solution.success, solution.statistics.failures
    assert trajopt.check(solution).ok
    data, points = solution.model.createData(), np.flatnonzero(solution.collocation)
    for k in points:
        force = pin.rnea(solution.model, data, solution.q[k], solution.v[k], solution.a[k])
        needed = np.zeros(6)
        for u, thruster in zip(solution.tau[k], robot.thrusters, strict=True):
            arm = robot.model.frames[robot.model.getFrameId(thruster.frame)].placement.translation
            needed += u * np.array([0.0, 0.0, 1.0, arm[1], -arm[0], thruster.drag])
        assert_allclose(force, needed, atol=SOLVED * robot.weight)
    assert solution.tau[points].min() >= -SOLVED * robot.weight
    assert solution.tau[points].max() <= robot.torque_limit.max() + SOLVED * robot.weight


def test_the_flip_is_upside_down_in_its_middle_and_ends_where_it_began():
    solution = motion("quadrotor-flip")
    middle = solution.sample(times=[0.45]).q[0]
    assert pin.Quaternion(*middle[[6, 3, 4, 5]]).toRotationMatrix()[2, 2] < -0.5
    assert_allclose(solution.q[-1, :3], solution.q[0, :3], atol=SOLVED)
    assert abs(solution.q[-1, 3:7] @ solution.q[0, 3:7]) == pytest.approx(1.0, abs=SOLVED)


def test_the_window_is_reached_between_its_bars():
    problem, solution = problems.load("quadrotor-window"), motion("quadrotor-window")
    clearance = next(term for term in problem.terms if isinstance(term, Clearance))
    centre = np.mean([bar.position for bar in clearance.obstacles if isinstance(bar, BoxObstacle)], axis=0)
    assert_allclose(solution.sample(times=[solution.t[-1] / 2]).q[0, :3], centre, atol=SOLVED)
    assert trajopt.check(solution).obstacle_distance >= 0.0


@pytest.mark.parametrize("name", ["cart-pole", "furuta", *FLIGHTS])
def test_plans_with_passive_joints_and_thrusters_hold_in_mujoco(name):
    pytest.importorskip("mujoco")
    assert trajopt.simulate(motion(name)).report.passed


def test_a_leg_with_a_passive_knee_keeps_its_row_of_the_dynamics():
    """A hopper whose knee no motor drives: rows of the base and of the knee, one torque."""
    hopper = robots.load("hopper")
    robot = Robot.from_model(hopper.model, passive=["knee"], contacts=hopper.contacts)
    assert robot.unactuated_rows.tolist() == [0, 1, 2, 4]
    with pytest.raises(InputError, match="robot 'hopper' cannot fly"):
        problems.load("quadrotor-flip", robot="hopper")


def test_thrusters_that_push_down_do_not_hover():
    iris = robots.load("iris")
    down = iris.with_thrusters([replace(thruster, axis=(0.0, 0.0, -1.0)) for thruster in iris.thrusters])
    with pytest.raises(InputError, match="robot 'iris' cannot hover level"):
        problems.load("quadrotor-window", robot=down)
