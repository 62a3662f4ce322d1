"""Swing-ups, hops, passive joints and thrusters: solved from their own guesses, and what they claim is so."""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.refusals import refused_calls
from tests.support.solved_problems import motion
from trajopt import InputError, Problem, Robot, Solution, check
from trajopt.certify.report import AT_POINTS
from trajopt.collision import BoxObstacle
from trajopt.errors import SolutionFileError
from trajopt.motion import cost_of_transport
from trajopt.robot import contact_positions
from trajopt.solving.solving import solve
from trajopt.terms import Clearance, Cost, TorqueCost
from trajopt_library import problems, robots

pytestmark = pytest.mark.long

# Ten times the solver's default tolerance, on rows of about a radian, a metre and their rates.
SOLVED = 1e-5
# The check's own limit on the drift of a foot that stands, m.
DRIFT = 1e-3
# The suite's noise on guesses, natural units, and a few of its seeds.
NOISE, SEEDS = 0.1, (0, 1)
SWING_UPS = ("double-pendulum", "acrobot")
HOPPERS = ("hopper", pytest.param("hopper_space", marks=pytest.mark.slow))

POINT_PENDULUM = """
import math
from dataclasses import replace
import numpy as np
import pinocchio as pin
from trajopt.robot import Robot

KIND = "pendulum"

def build():
    model = pin.Model()
    model.name = "point"
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "pivot")
    mass = pin.Inertia.FromSphere(2.0, 0.05)
    model.appendBodyToJoint(joint, mass, pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.7])))
    robot = Robot.from_model(model, name="point", reference=np.array([math.pi]))
    return replace(robot, torque_limit=np.array([2.0 * 9.81 * 0.7]))
"""


@lru_cache
def solved(name: str, **parameters: object) -> tuple[Problem, Solution]:
    """A problem and its solution from its own guess."""
    problem = problems.load(name, **parameters)
    return problem, solve(problem)


# Swing-ups


@pytest.mark.parametrize("goal", ["effort", "time"])
@pytest.mark.parametrize("name", SWING_UPS)
def test_swing_up_goes_from_hanging_to_upright_at_rest(name, goal):
    _, solution = solved(name, goal=goal)
    assert solution.converged
    assert check(solution).within(AT_POINTS)
    model, data = solution.model, solution.model.createData()
    heights = [pin.centerOfMass(model, data, q)[2] for q in solution.q]
    turned = [_stretched(model, angle) for angle in np.linspace(0, 2 * math.pi, 721)]
    assert_allclose(heights[0], min(turned), atol=1e-4)
    assert_allclose(heights[-1], max(turned), atol=1e-4)
    assert_allclose(solution.v[[0, -1]], 0.0, atol=SOLVED)


def _stretched(model: pin.Model, angle: float) -> float:
    """Height of the centre of mass with the links in line, m."""
    q = np.array([math.cos(angle), math.sin(angle), 1.0, 0.0])
    return float(pin.centerOfMass(model, model.createData(), q)[2])


@pytest.mark.parametrize("name", SWING_UPS)
def test_motors_cannot_lift_the_links_at_once(name):
    problem, solution = solved(name)
    rates = solution.v[:, 0]
    assert np.all(np.abs(solution.tau[solution.collocation]) < 0.5 * problem.robot.torque_limit + SOLVED)
    assert np.sum(np.diff(np.sign(rates[np.abs(rates) > 0.1])) != 0) >= 2  # it swings to and fro


def test_nothing_drives_the_first_joint_of_the_acrobot():
    problem, solution = solved("acrobot")
    model, data = solution.model, solution.model.createData()
    points = solution.collocation
    motion = zip(solution.q[points], solution.v[points], solution.a[points], strict=True)
    moments = np.array([pin.rnea(model, data, *state) for state in motion])
    assert problem.robot.passive == ("joint1",)
    assert_allclose(moments[:, 0], 0.0, atol=SOLVED)
    assert_allclose(moments[:, 1:], solution.tau[points], atol=SOLVED)


def test_the_least_time_of_the_double_pendulum_takes_all_the_torque():
    problem, solution = solved("double-pendulum", goal="time")
    assert sum(solution.meta["durations"]) < 0.7 * problem.schedule.duration
    limit = 0.5 * problem.robot.torque_limit
    used = np.abs(solution.tau[solution.collocation]) / limit
    assert np.mean(used.max(axis=1) > 0.99) > 0.8
    assert used.max() < 1 + SOLVED


@pytest.mark.parametrize("name", SWING_UPS)
def test_swing_ups_are_solved_from_perturbed_guesses(name):
    problem = problems.load(name)
    for seed in SEEDS:
        assert solve(problem, perturb=NOISE, seed=seed).converged


def test_another_pendulum_swings_up_by_name_of_its_file(tmp_path):
    file = tmp_path / "point.py"
    file.write_text(POINT_PENDULUM)
    problem, solution = solved("double-pendulum", robot=str(file))
    assert solution.converged
    assert check(solution).within(AT_POINTS)
    period = 2 * math.pi * math.sqrt(0.7 / 9.81)
    assert_allclose(problem.parameters["duration"] / period, 2.5, rtol=2e-3)  # its radius of 0.05 m counts
    assert_allclose(math.remainder(solution.q[-1, 0], 2 * math.pi), 0.0, atol=SOLVED)


@pytest.mark.parametrize("name", ["ur5", "hopper", "solo12"])
def test_other_robots_do_not_swing_up(name):
    with pytest.raises(InputError, match="pendulum"):
        problems.load("acrobot", robot=name)


# Hops


@pytest.mark.parametrize("robot", HOPPERS)
def test_hop_lands_on_its_foothold(robot):
    problem, solution = solved("hopper-hop", robot=robot)
    assert solution.converged
    assert check(solution).within(AT_POINTS)
    feet = [contact_positions(problem.robot, q)["foot"] for q in solution.q[[0, -1]]]
    assert_allclose(feet[1] - feet[0], [0.2, 0.0, 0.0], atol=DRIFT)


def test_goals_of_a_hop_are_met_better_than_by_least_effort():
    reached = {}
    for goal in ("effort", "height", "distance", "time"):
        problem = problems.load("hopper-hop", goal=goal)
        solution = solve(problem, intervals=24)
        assert solution.converged
        reached[goal] = (solution.q[:, 1].max(), solution.q[-1, 0] - solution.q[0, 0], solution.t[-1])
    assert reached["height"][0] > reached["effort"][0] + 0.2
    assert reached["distance"][1] > reached["effort"][1] + 0.5
    assert reached["time"][2] < reached["effort"][2] - 0.1


def test_the_farthest_hop_ends_in_the_reference_posture_wherever_it_lands():
    problem = problems.load("hopper-hop", goal="distance")
    solution = solve(problem, intervals=60)
    assert check(solution).within(AT_POINTS)
    foot = contact_positions(problem.robot, solution.q[-1])["foot"]
    standing = contact_positions(problem.robot, problem.robot.reference)["foot"]
    base, reference = solution.q[-1], problem.robot.reference
    assert_allclose(base[0] - foot[0], reference[0] - standing[0], atol=DRIFT)
    assert_allclose(base[1:], reference[1:], atol=DRIFT)
    assert_allclose(solution.v[-1], 0.0, atol=DRIFT)


# Periodic hopping


@pytest.mark.parametrize("robot", HOPPERS)
def test_hopping_is_periodic_at_the_commanded_speed(robot):
    problem, solution = solved("hopper-gait", robot=robot)
    assert solution.converged
    assert check(solution).within(AT_POINTS)
    speed, period = (float(problem.parameters[name]) for name in ("speed", "period"))
    way = np.zeros(problem.robot.nq)
    way[0] = speed * period
    assert_allclose(solution.q[-1] - solution.q[0], way, atol=SOLVED)
    assert_allclose(solution.v[-1], solution.v[0], atol=SOLVED)
    assert_allclose(solution.t[-1], period)


def test_two_hops_follow_each_other_without_a_jump_of_the_foot():
    problem, solution = solved("hopper-gait")
    stance = [row for row in range(solution.n_samples) if solution.active[row, 0]]
    feet = np.array([contact_positions(problem.robot, solution.q[row])["foot"] for row in stance])
    assert_allclose(feet[:, 0], feet[0, 0], atol=1e-3)
    landed = contact_positions(problem.robot, solution.q[-1])["foot"]
    step = float(problem.parameters["speed"]) * float(problem.parameters["period"])
    assert_allclose(landed - feet[0], [step, 0.0, 0.0], atol=SOLVED)


def test_hopping_for_transport_draws_less_than_for_effort():
    costs = {goal: cost_of_transport(solved("hopper-gait", goal=goal)[1]) for goal in ("effort", "transport")}
    assert costs["transport"] < 0.9 * costs["effort"]


@pytest.mark.parametrize("given", [{"speed": -0.8}, {"duty": 0.4}, {"durations": "free"}])
def test_hopping_is_solved_for_other_commands(given):
    problem, solution = solved("hopper-gait", **given)
    assert solution.converged
    assert check(solution).within(AT_POINTS)
    lengths = np.array(solution.meta["durations"])
    nominal = np.array([phase.duration for phase in problem.schedule.phases])
    free = given.get("durations") == "free"
    assert np.all(lengths <= 2.0 * nominal + SOLVED) if free else np.allclose(lengths, nominal)


test_hoppers_that_cannot_be_are_refused = refused_calls(
    (lambda: problems.load("hopper-hop", robot="solo12"), "hopper"),
    (lambda: problems.load("hopper-hop", robot="hopper_space", coordinates="minimal"), "minimal"),
    (lambda: problems.load("hopper-hop", goal="distance", coordinates="minimal"), "minimal"),
    (lambda: problems.load("hopper-gait", speed=0.0, goal="transport"), "travel"),
)


# Kelly's figures are of trapezoidal and Hermite-Simpson meshes, 0.1 % above the limit of fine meshes.
PUBLISHED, ROUNDED = 58.83, 1e-3
PASSIVE = ("cart-pole", "furuta", "pendubot")
FLIGHTS = ("quadrotor-window", "quadrotor-flip")


def heights_of(solution: Solution) -> np.ndarray:
    """Heights of the centre of mass (K,), m."""
    data = solution.model.createData()
    return np.array([pin.centerOfMass(solution.model, data, q)[2] for q in solution.q])


@pytest.mark.parametrize("name", PASSIVE)
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


@pytest.mark.parametrize("name", [*PASSIVE, *FLIGHTS])
def test_files_say_which_rows_are_driven_and_by_what(name, tmp_path):
    solution = motion(name)
    read = Solution.load(solution.save(tmp_path / "plan.npz"))
    assert read.torque_names == solution.torque_names
    np.testing.assert_array_equal(read.actuation.matrix, solution.actuation.matrix)
    assert trajopt.check(read).ok
    assert ("actuated_rows" in read.meta) == (name in PASSIVE)
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
