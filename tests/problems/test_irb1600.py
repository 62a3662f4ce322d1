"""The IRB 1600: kinematics against its drawing, masses, motors that hold it, transfers."""

import math

import numpy as np
import pinocchio as pin
import pytest

import trajopt
from trajopt.certify.report import AT_POINTS
from trajopt.errors import InputError
from trajopt_library import problems, robots
from trajopt_library.problems.irb1600_transfer import nearest_posture
from trajopt_library.robots import irb1600

ROUNDING = 1e-12
# Payload that the data sheet allows, kg.
RATED = 8.0
# A row at its limit, by what an interior point leaves at a tolerance of 1e-6, and then some.
AT_LIMIT = 1e-2
# Part of a time-optimal motion in which nothing is at a limit: a few intervals around each switch.
SWITCHES = 0.15
INTERVALS = 30


def placement(robot, q, frame):
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[robot.model.getFrameId(frame)]


def test_tool_is_where_the_drawing_has_it():
    """At zero: 0.15 + 0.6 + 0.065 m forward, 0.4865 + 0.7 m up; stretched forward 1.45 m to the wrist."""
    robot = irb1600.build()
    tool = placement(robot, np.zeros(6), irb1600.TOOL)
    np.testing.assert_allclose(tool.translation, [0.815, 0.0, 1.1865], atol=ROUNDING)
    np.testing.assert_allclose(tool.rotation[:, 2], [1.0, 0.0, 0.0], atol=ROUNDING)
    stretched = np.array([0.0, math.pi / 2, -math.pi / 2, 0.0, 0.0, 0.0])
    wrist = placement(robot, stretched, "joint_5")
    np.testing.assert_allclose(wrist.translation, [1.45, 0.0, 0.4865], atol=ROUNDING)


def test_positive_joint_angles_turn_left_forward_and_down():
    robot = irb1600.build()
    moved = [placement(robot, 0.1 * np.eye(6)[i], irb1600.TOOL).translation for i in range(3)]
    assert moved[0][1] > 0
    assert moved[1][0] > 0.815
    assert moved[2][2] < 1.1865


def test_motors_hold_the_arm_with_its_load_in_every_posture():
    """Gravity torques stay within half of the limits that were read out of the garbled table."""
    robot = irb1600.build(payload=RATED)
    data, generator = robot.model.createData(), np.random.default_rng(0)
    stretched = np.array([0.0, math.pi / 2, -math.pi / 2, 0.0, 0.0, 0.0])
    postures = [stretched, *generator.uniform(robot.position_lower, robot.position_upper, (200, 6))]
    for q in postures:
        gravity = pin.computeGeneralizedGravity(robot.model, data, q)
        assert (np.abs(gravity) < 0.5 * robot.torque_limit).all()


def test_joint_side_limits_are_motor_torques_times_gear_ratios():
    robot = irb1600.build()
    np.testing.assert_allclose(robot.torque_limit, [600, 1000, 500, 36, 36, 20], rtol=ROUNDING)
    np.testing.assert_allclose(np.degrees(robot.velocity_limit), [180, 180, 200, 400, 400, 460])


@pytest.mark.parametrize("share", [0.5, 0.75, 1.0])
def test_reflected_motor_inertia_is_that_share_of_what_each_axis_moves(share):
    bare, geared = irb1600.build(motor_inertia=0.0), irb1600.build(motor_inertia=share)
    q = np.array(irb1600.REFERENCE)
    moved = np.diag(pin.crba(bare.model, bare.model.createData(), q))
    total = np.diag(pin.crba(geared.model, geared.model.createData(), q))
    np.testing.assert_allclose(total, (1 + share) * moved, rtol=1e-12)


def test_payload_adds_its_mass_beyond_the_flange_and_leaves_the_motors():
    bare, loaded = irb1600.build(), irb1600.build(payload=RATED)
    assert loaded.mass - bare.mass == pytest.approx(RATED, rel=1e-12)
    np.testing.assert_allclose(loaded.model.armature, bare.model.armature)
    side = (RATED / 7850.0) ** (1 / 3)
    moment = loaded.model.inertias[6].mass * loaded.model.inertias[6].lever[0]
    own = bare.model.inertias[6].mass * bare.model.inertias[6].lever[0]
    assert moment - own == pytest.approx(RATED * side / 2, rel=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"payload": -1.0}, "payload of the IRB 1600"),
        ({"motor_inertia": float("nan")}, "motor_inertia of the IRB 1600"),
        ({"material": "wood"}, "steel, aluminium, iron"),
    ],
)
def test_arms_that_cannot_be_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        irb1600.build(**change)


@pytest.mark.long
def test_start_and_goal_hold_the_tool_where_it_was_asked():
    robot = robots.load("irb1600")
    q = nearest_posture(robot, np.array([0.7, 0.8, 1.1]), math.pi / 3, robot.reference)
    tool = placement(robot, q, irb1600.TOOL)
    np.testing.assert_allclose(tool.translation, [0.7, 0.8, 1.1], atol=1e-9)
    assert tool.rotation[2, 2] == pytest.approx(-math.sin(math.pi / 3))
    with pytest.raises(InputError, match="cannot bring its tool"):
        nearest_posture(robot, np.array([2.0, 0.0, 1.0]), 0.0, robot.reference)


@pytest.mark.slow
def test_transfer_of_least_effort_is_solved_and_slower_is_cheaper():
    costs = []
    for duration in (1.2, 1.8):
        problem = problems.load("irb1600-transfer", duration=duration)
        solution = trajopt.solve(problem, intervals=INTERVALS)
        assert solution.converged
        assert solution.statistics.iterations <= 60
        assert trajopt.check(solution).within(AT_POINTS)
        costs.append(mean_motor_torque(problem, solution))
    assert costs[1] < costs[0]


def mean_motor_torque(problem, solution) -> float:
    """Mean square of motor torque over its limit, from the file's torques, weighted by time."""
    share = solution.tau / problem.robot.torque_limit
    points = solution.collocation
    return float(np.mean(share[points] ** 2))


@pytest.mark.slow
def test_transfer_of_least_time_is_at_a_limit_almost_always():
    """Pontryagin: while the duration can be shortened, some drive or some rate has no reserve."""
    problem = problems.load("irb1600-transfer", goal="time")
    solution = trajopt.solve(problem, intervals=2 * INTERVALS)
    assert solution.converged
    assert solution.statistics.iterations <= 60
    assert trajopt.check(solution).within(AT_POINTS)
    points = solution.collocation
    torque = np.abs(solution.tau[points]) / problem.robot.torque_limit
    rate = np.abs(solution.v[points]) / problem.robot.velocity_limit
    busiest = np.maximum(torque, rate).max(axis=1)
    assert np.mean(busiest < 1 - AT_LIMIT) < SWITCHES
    travel = np.abs(solution.q[-1] - solution.q[0])
    assert solution.t[-1] > (travel / problem.robot.velocity_limit).max()


def test_more_payload_and_larger_motors_take_longer_to_accelerate():
    """Acceleration of the second joint at full torque from rest, by forward dynamics."""
    found = []
    for change in ({}, {"payload": RATED}, {"payload": RATED, "motor_inertia": 1.0}):
        robot = irb1600.build(**change)
        tau = np.zeros(6)
        tau[1] = robot.torque_limit[1]
        q = np.array(irb1600.REFERENCE)
        found.append(pin.aba(robot.model, robot.model.createData(), q, np.zeros(6), tau)[1])
    assert found == sorted(found, reverse=True)
