"""Drives: gear, friction, current and voltage in closed form, their terms, and an envelope that binds."""

import json
import math
from dataclasses import replace

import casadi as ca
import numpy as np
import osqp
import pinocchio as pin
import pytest
from scipy import sparse

import trajopt
from tests.support.problems import REACH, REACH_TIME, hopper, one_joint_arm, point_of, random_point, reach
from tests.support.refusals import refusals
from tests.support.synthetic_motions import with_meta
from trajopt import InputError, Robot, Schedule
from trajopt.certify.report import AT_POINTS
from trajopt.dynamics import Coordinates
from trajopt.errors import SolutionFileError, UnsupportedJointError
from trajopt.robot import Drive, Units
from trajopt.robot.actuators.on_robot import drive_torque_values
from trajopt.terms import Context, DriveLimits, MotorTorqueCost, TimeCost, TorqueCost, TorqueLimits
from trajopt_library import problems, robots
from trajopt_library.robots import solo12

# A handful of products of doubles.
ROUNDING = 1e-12
# A direct-current motor, 24 V, behind a reversing gear.
VOLTAGE, RESISTANCE, CONSTANT, CURRENT, RATIO = 24.0, 0.8, 0.05, 10.0, -20.0
MOTOR = Drive.from_motor(
    gear_ratio=RATIO,
    voltage=VOLTAGE,
    resistance=RESISTANCE,
    torque_constant=CONSTANT,
    current_limit=CURRENT,
    rotor_inertia=2e-5,
    viscous_friction=0.3,
    coulomb_friction=0.5,
)


def test_motor_gives_stall_torque_no_load_speed_and_current_limit():
    assert pytest.approx(CONSTANT * VOLTAGE / RESISTANCE, rel=ROUNDING) == MOTOR.stall_torque
    assert pytest.approx(VOLTAGE / CONSTANT, rel=ROUNDING) == MOTOR.no_load_speed
    assert pytest.approx(CONSTANT * CURRENT, rel=ROUNDING) == MOTOR.torque_limit
    assert pytest.approx(RATIO**2 * 2e-5, rel=ROUNDING) == MOTOR.armature


def test_voltage_use_is_the_voltage_of_the_motor_over_its_largest():
    """V = R i + k omega with i = tau / (n k) and omega = n rate, signs of a reversing gear included."""
    generator = np.random.default_rng(0)
    torque, rate = generator.uniform(-20, 20, (2, 50))
    current, speed = torque / RATIO / CONSTANT, RATIO * rate
    voltage = RESISTANCE * current + CONSTANT * speed
    np.testing.assert_allclose(MOTOR.voltage_use(torque, rate), voltage / VOLTAGE, rtol=0, atol=ROUNDING)


def test_power_is_the_same_on_both_sides_of_the_gear():
    torque, rate = 7.0, -3.0
    assert MOTOR.motor_torque(torque) * MOTOR.motor_speed(rate) == pytest.approx(torque * rate, rel=ROUNDING)


def test_friction_opposes_motion_with_its_limits_at_high_and_low_speed():
    rates = np.linspace(-20, 20, 401)
    friction = MOTOR.friction_torque(rates)
    assert (friction * rates >= 0).all()
    assert MOTOR.friction_torque(20.0) == pytest.approx(0.3 * 20 + 0.5, rel=ROUNDING)
    slope = MOTOR.friction_torque(1e-6) / 1e-6
    assert slope == pytest.approx(0.3 + 0.5 / MOTOR.coulomb_speed, rel=1e-6)


@pytest.mark.parametrize("rate", [-30.0, -10.0, 0.0, 5.0, 23.0])
def test_torque_range_is_where_the_margin_vanishes(rate):
    lower, upper = MOTOR.torque_range(rate)
    for bound in (lower, upper):
        assert MOTOR.envelope_margin(float(bound), rate) == pytest.approx(0.0, abs=1e-9)
    inside = np.linspace(lower, upper, 11)[1:-1]
    assert (MOTOR.envelope_margin(inside, np.full(9, rate)) > 0).all()
    assert MOTOR.envelope_margin(float(upper) + 0.1, rate) < 0
    assert MOTOR.envelope_margin(float(lower) - 0.1, rate) < 0


def test_motor_at_no_load_speed_has_no_torque_left_to_accelerate_with():
    assert MOTOR.torque_range(MOTOR.joint_no_load_speed)[1] == pytest.approx(0.0, abs=1e-12)


def test_drive_without_limits_has_all_margin():
    free = Drive(gear_ratio=2.0)
    assert free.voltage_use(1e6, 1e6) == 0.0
    assert free.envelope_margin(1e6, 1e6) == 1.0
    assert free.torque_range(3.0) == (-np.inf, np.inf)


test_drives_that_cannot_be_are_refused = refusals(
    lambda change: Drive(**{"gear_ratio": 2.0, **change}),
    ({"gear_ratio": 0.0}, "gear_ratio of Drive is 0"),
    ({"gear_ratio": math.inf}, "gear_ratio"),
    ({"gear_ratio": "nine"}, "gear_ratio of Drive is 'nine'"),
    ({"rotor_inertia": -1.0}, "rotor_inertia"),
    ({"viscous_friction": math.nan}, "viscous_friction of Drive is nan"),
    ({"coulomb_friction": math.inf}, "coulomb_friction"),
    ({"coulomb_speed": 0.0}, "coulomb_speed"),
    ({"coulomb_speed": math.inf}, "coulomb_speed"),
    ({"torque_limit": 0.0}, "torque_limit"),
    ({"stall_torque": 1.0}, "both finite"),
    ({"stall_torque": -1.0, "no_load_speed": 1.0}, "stall_torque"),
)


@pytest.mark.parametrize("name", ["voltage", "resistance", "torque_constant", "back_emf_constant"])
def test_motors_that_cannot_be_are_refused(name):
    numbers = {"gear_ratio": 1.0, "voltage": 24.0, "resistance": 1.0, "torque_constant": 0.1}
    with pytest.raises(InputError, match=f"{name} of Drive.from_motor is -1"):
        Drive.from_motor(**{**numbers, name: -1.0})


def test_description_survives_json():
    for drive in (MOTOR, Drive(gear_ratio=3.0)):
        assert Drive.from_meta(json.loads(json.dumps(drive.to_meta()))) == drive
    for wrong in (3, {}, {"gear_ratio": 1.0, "colour": 2.0}, {"gear_ratio": None}):
        with pytest.raises(InputError):
            Drive.from_meta(wrong)


def test_robot_takes_armature_and_limits_from_its_drive():
    robot = one_joint_arm().with_drives({"joint": MOTOR})
    assert robot.model.armature[0] == pytest.approx(MOTOR.armature)
    assert one_joint_arm().model.armature[0] == 0.0  # the robot it was made from is as it was
    assert robot.torque_limit[0] == pytest.approx(abs(RATIO) * CONSTANT * CURRENT)
    assert robot.velocity_limit[0] == pytest.approx(VOLTAGE / CONSTANT / abs(RATIO))
    data = robot.model.createData()
    bare = pin.crba(one_joint_arm().model, one_joint_arm().model.createData(), np.zeros(1))
    np.testing.assert_allclose(pin.crba(robot.model, data, np.zeros(1)), bare + MOTOR.armature)


def test_drive_replaces_what_the_description_says_and_leaves_what_it_does_not_state():
    """The hopper's joints have armature 0.02, 60 N m and 20 rad/s of their own."""
    robot = hopper().with_drives({"hip": Drive(gear_ratio=10.0, rotor_inertia=1e-3, torque_limit=2.0)})
    np.testing.assert_allclose(robot.model.armature[6:], [0.1, 0.02])
    np.testing.assert_allclose(robot.torque_limit, [20.0, 60.0])
    again = robot.with_drives({"hip": Drive(gear_ratio=5.0), "shank": MOTOR})
    np.testing.assert_allclose(again.model.armature[6:], [0.1, MOTOR.armature])
    assert again.torque_limit[0] == 20.0
    assert again.velocity_limit[6] == 20.0
    assert robot.velocity_limit[7] == 20.0


def test_locking_keeps_the_drives_of_the_joints_that_remain():
    arm = robots.load("ur5")
    drives = [Drive(gear_ratio=float(i + 1), rotor_inertia=1e-4) for i in range(6)]
    locked = arm.with_drives(drives).with_locked(["elbow_joint", "wrist_3_joint"])
    assert [drive.gear_ratio for drive in locked.drives] == [1.0, 2.0, 4.0, 5.0]
    np.testing.assert_allclose(locked.model.armature, [drive.armature for drive in locked.drives])


def test_drives_that_do_not_fit_the_robot_are_refused():
    robot = hopper()
    with pytest.raises(InputError, match="no actuated joint 'knee'; one of hip, shank"):
        robot.with_drives({"knee": MOTOR})
    with pytest.raises(InputError, match="no actuated joint 'base'"):
        robot.with_drives({"base": MOTOR})
    with pytest.raises(InputError, match="each of its 2 actuated rows"):
        robot.with_drives([MOTOR])
    with pytest.raises(InputError, match=r"drives\[1\] of Robot.with_drives is 3; allowed: a Drive or None"):
        robot.with_drives([MOTOR, 3])
    with pytest.raises(InputError, match="each of its 2 actuated rows"):
        replace(robot, drives=(MOTOR,) * 3)


def test_joint_of_several_degrees_of_freedom_takes_no_drive():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    robot = Robot.from_model(model, base="fixed")
    with pytest.raises(UnsupportedJointError, match="ball"):
        robot.with_drives({"ball": MOTOR})
    with pytest.raises(InputError, match="several degrees of freedom"):
        robot.with_drives([MOTOR, None, None])


def test_actuated_rows_may_exceed_the_drive_by_what_friction_brakes():
    robot = one_joint_arm().with_drives({"joint": MOTOR})
    rate = robot.velocity_limit[0]
    bound = robot.actuated_row_limit(robot.torque_limit)
    braking = -robot.torque_limit[0] - MOTOR.friction_torque(rate)
    assert bound[0] == pytest.approx(-braking)
    delivered = drive_torque_values(robot.drives, np.array([[braking]]), np.array([[rate]]))
    assert delivered[0, 0] == pytest.approx(-robot.torque_limit[0])


def test_solo12_motor_agrees_with_its_makers_figures():
    """300 rpm/V unloaded, and 2.5 N m at the joint with 12 A (of which belts take some)."""
    drive = solo12.drive(24.0)
    assert drive.no_load_speed == pytest.approx(300 * 24 * 2 * math.pi / 60, rel=0.02)
    assert 2.5 <= drive.joint_torque_limit <= 2.8


# Symbolic and numeric evaluation of one formula.
SAME = 1e-9
# What the solver leaves at a tolerance of 1e-6.
SOLVED = 1e-5
# Objective of a programme of 400 steps of constant acceleration against collocation with 40
# intervals: both converge, and their difference halves with every refinement that was tried.
STEPS, INTERVALS, PROGRAMME = 400, 40, 5e-3
# Coulomb friction smoothed over 0.02 rad/s of rates up to 3, and one interval of 40 that holds the switch.
SMOOTHED = 1e-2
# One joint of 0.58 kg m^2 with its rotor turns by 1.2 rad in 0.8 s: least effort peaks at 6.6 N m and
# 2.25 rad/s. This motor has 9 N m at the joint at rest and none at 2.6 rad/s.
SLOW = Drive(
    gear_ratio=-50.0, rotor_inertia=2e-5, viscous_friction=0.4, stall_torque=0.18, no_load_speed=130.0
)
JUMP_VOLTAGE = 6.0  # V, a quarter of Solo12's supply


def driven_reach(drive: Drive, limits, cost=TorqueCost):
    problem = reach(terms=(cost(weight=1.0), *limits))
    return replace(problem, robot=problem.robot.with_drives({"joint": drive}))


def least_effort(drive: Drive, limited: bool) -> float:
    """Integral of the squared torque by OSQP: constant accelerations, exact integration, no collocation."""
    model = one_joint_arm().model
    inertia = pin.crba(model, model.createData(), np.zeros(1))[0, 0] + drive.armature
    h = REACH_TIME / STEPS
    rate = h * (np.tril(np.ones((STEPS, STEPS)), -1) + 0.5 * np.eye(STEPS))  # at the middle of each step
    torque = inertia * np.eye(STEPS) + drive.viscous_friction * rate
    voltage = torque / (drive.gear_ratio * drive.stall_torque) + drive.gear_ratio / drive.no_load_speed * rate
    ends = np.vstack([h * np.ones(STEPS), h * h * (STEPS - np.arange(STEPS) - 0.5)])
    rows = np.vstack([ends, voltage]) if limited else ends
    bound = np.ones(STEPS if limited else 0)
    target = np.array([0.0, REACH])
    programme = osqp.OSQP()
    programme.setup(
        sparse.csc_matrix(2 * h * torque.T @ torque),
        np.zeros(STEPS),
        sparse.csc_matrix(rows),
        np.concatenate([target, -bound]),
        np.concatenate([target, bound]),
        verbose=False,
        eps_abs=1e-8,
        eps_rel=1e-8,
        max_iter=400000,
        polishing=True,
    )
    accelerations = programme.solve(raise_error=True).x
    return float(h * np.sum((torque @ accelerations) ** 2))


def test_torque_of_a_term_is_inverse_dynamics_plus_joint_friction():
    """Against numeric Pinocchio at random states of a floating robot; signs and armature included."""
    drives = {
        "hip": Drive(gear_ratio=-9.0, rotor_inertia=1e-4, viscous_friction=0.2, coulomb_friction=0.7),
        "shank": Drive(gear_ratio=40.0, rotor_inertia=1e-5),
    }
    robot = hopper().with_drives(drives)
    point, parameters = point_of(robot, (), (TorqueCost(weight=1.0),))
    context = Context(robot, Coordinates(robot.model), (), node=False)
    z = random_point(robot, point, np.random.default_rng(0))
    value = float(point_value(point, z, parameters)[0])
    q, v, a = pinocchio_of(context, z)
    tau = pin.rnea(robot.model, robot.model.createData(), q, v, a)[6:]
    tau = tau + [drive.friction_torque(float(rate)) for drive, rate in zip(robot.drives, v[6:], strict=True)]
    assert value == pytest.approx(np.mean((tau / Units(robot).torque) ** 2), rel=SAME)


def point_value(point, z, parameters):
    symbols = ca.SX.sym("z", point.n_z)
    value = symbols
    for layer in point.layers:
        value = layer(value)
    return ca.Function("value", [symbols], list(point.terms(symbols, value, parameters)))(z)


def pinocchio_of(context, z):
    function = ca.Function("motion", [context.z], [context.q, context.v, context.a])
    return [np.array(part).ravel() for part in function(z)]


def test_rows_of_drive_limits_are_voltage_and_current_on_the_motor_side():
    fast = Drive(
        gear_ratio=8.0, torque_limit=0.5, stall_torque=1.0, no_load_speed=100.0, viscous_friction=0.1
    )
    robot = hopper().with_drives({"hip": fast})
    context = Context(robot, Coordinates(robot.model), (), node=False)
    rows = DriveLimits().rows(context, Units(robot))
    assert rows.expression.numel() == 3  # voltage and current of the hip, the shank's own torque limit
    np.testing.assert_array_equal(rows.upper, 1.0)
    np.testing.assert_array_equal(rows.lower, -1.0)
    tau, rate = np.array([2.0, -30.0]), np.array([3.0, 1.0])
    function = ca.Function(
        "rows", [context.generalized_forces, context.z, context.parameters], [rows.expression]
    )
    z = np.zeros(context.z.numel())
    z[[i for i in range(len(z)) if ca.depends_on(context.dxi[6], context.z[i])]] = rate[0]
    found = np.array(function(np.concatenate([np.zeros(6), tau]), z, context.parameter_values)).ravel()
    delivered = tau[0] + 0.1 * rate[0]
    expected = [fast.voltage_use(delivered, rate[0]), delivered / 4.0, tau[1] / 60.0]
    np.testing.assert_allclose(found, expected, rtol=SAME)


def test_rows_that_cannot_bind_are_left_out():
    weak = Drive(gear_ratio=8.0, torque_limit=3.0, stall_torque=1.0, no_load_speed=100.0)
    huge = Drive(gear_ratio=8.0, torque_limit=1e6, stall_torque=1e7, no_load_speed=1e7)
    for drive, count in ((weak, 1), (huge, 0), (replace(weak, torque_limit=1.5), 2)):
        robot = one_joint_arm().with_drives({"joint": drive})
        rows = DriveLimits().rows(Context(robot, Coordinates(robot.model), (), node=False), Units(robot))
        assert (0 if rows is None else rows.expression.numel()) == count


@pytest.mark.parametrize("term", [DriveLimits(), MotorTorqueCost(weight=1.0)])
def test_terms_of_drives_need_drives(term):
    robot = hopper()
    context = Context(robot, Coordinates(robot.model), (), node=False)
    with pytest.raises(InputError, match=r"allowed: Robot\.with_drives"):
        (term.rows if isinstance(term, DriveLimits) else term.residual)(context, Units(robot))


def test_envelope_binds_and_costs_what_a_quadratic_programme_says():
    free, bound = (
        trajopt.solve(driven_reach(SLOW, limits), intervals=INTERVALS) for limits in ((), (DriveLimits(),))
    )
    assert free.converged
    assert bound.converged
    use = SLOW.voltage_use(free.tau[:, 0] + SLOW.friction_torque(free.v[:, 0]), free.v[:, 0])
    assert np.abs(use).max() > 1.1  # without the envelope the motion is not possible
    ratio = least_effort(SLOW, limited=True) / least_effort(SLOW, limited=False)
    assert ratio > 1.01
    assert bound.statistics.objective / free.statistics.objective == pytest.approx(ratio, rel=PROGRAMME)
    report = trajopt.check(bound)
    assert report.within(AT_POINTS)
    assert report.drive_voltage_excess == pytest.approx(0.0, abs=SOLVED)
    assert "drive_voltage_excess" in trajopt.check(free).failures(AT_POINTS)
    assert np.abs(bound.v).max() < np.abs(free.v).max() - 0.05  # it turns slower in the middle


def test_least_time_with_friction_is_that_of_full_torque_helped_by_friction_when_braking():
    """Accelerations (L - F) / I and (L + F) / I: T = sqrt(2 angle (1 / a_1 + 1 / a_2))."""
    friction, limit = 4.0, 10.0
    drive = Drive(gear_ratio=50.0, coulomb_friction=friction, coulomb_speed=0.02, torque_limit=limit / 50)
    problem = driven_reach(drive, (DriveLimits(),), TimeCost)
    phase = replace(problem.schedule.phases[0], duration_bounds=(0.1, 3.0))
    problem = replace(problem, schedule=Schedule((phase,)))
    solution = trajopt.solve(problem, intervals=INTERVALS, transcription="legendre:1")
    assert solution.converged
    model = one_joint_arm().model
    inertia = pin.crba(model, model.createData(), np.zeros(1))[0, 0]
    rates = inertia / np.array([limit - friction, limit + friction])
    assert solution.t[-1] == pytest.approx(math.sqrt(2 * REACH * rates.sum()), rel=SMOOTHED)
    report = trajopt.check(solution)
    assert report.within(AT_POINTS)
    assert report.drive_torque_excess == pytest.approx(0.0, abs=SOLVED)
    # actuated rows exceed the drive's limit by the friction, and the file's limit on them allows it
    assert solution.tau.min() == pytest.approx(-limit - friction, rel=SMOOTHED)
    assert solution.description.effort_limit == pytest.approx([limit + friction])


def test_joint_side_and_motor_side_limits_give_one_motion():
    """`TorqueLimits` of n tau_m on the joint side and `DriveLimits` of tau_m on the motor side."""
    drive = Drive(gear_ratio=-50.0, rotor_inertia=2e-5, torque_limit=0.12)
    solutions = [
        trajopt.solve(driven_reach(drive, (term,)), intervals=20) for term in (TorqueLimits(), DriveLimits())
    ]
    first, second = solutions
    assert first.statistics.objective == pytest.approx(second.statistics.objective, rel=SOLVED)
    assert np.abs(first.tau).max() > 0.99 * drive.joint_torque_limit


def test_motor_torque_cost_is_the_torque_cost_in_other_units():
    drive = Drive(gear_ratio=50.0, rotor_inertia=2e-5, torque_limit=0.3)
    joint, motor = (
        trajopt.solve(driven_reach(drive, (), cost), intervals=10) for cost in (TorqueCost, MotorTorqueCost)
    )
    units = Units(one_joint_arm().with_drives({"joint": drive}))
    factor = (units.torque / drive.joint_torque_limit) ** 2
    assert motor.statistics.objective == pytest.approx(factor * joint.statistics.objective, rel=SOLVED)
    np.testing.assert_allclose(motor.q, joint.q, atol=SOLVED)


def test_file_keeps_the_drives_and_refuses_wrong_ones(tmp_path):
    solution = trajopt.solve(driven_reach(SLOW, (DriveLimits(),)), intervals=5)
    solution.save(tmp_path / "reach.npz")
    loaded = trajopt.Solution.load(tmp_path / "reach.npz")
    assert loaded.description.drives[0] == SLOW
    assert loaded.model.armature[0] == pytest.approx(SLOW.armature)
    assert trajopt.check(loaded).drive_voltage_excess == trajopt.check(solution).drive_voltage_excess
    for wrong, message in (
        ([None, None], "2 entries, expected 1"),
        ({}, "null or a list"),
        ([{"gear_ratio": 0.0}], "gear_ratio of Drive is 0"),
        ([{"ratio": 1.0}], "not an object of its fields"),
    ):
        with pytest.raises((InputError, SolutionFileError), match=message):
            trajopt.check(with_meta(solution, drives=wrong))


def test_check_of_a_robot_without_drives_has_no_figures_of_them():
    report = trajopt.check(trajopt.solve(reach(), intervals=5))
    assert report.drive_torque_excess is None
    assert report.drive_voltage_excess is None


def test_jump_takes_either_a_torque_limit_or_a_voltage():
    with pytest.raises(InputError, match="both torque_limit=2 and voltage=24"):
        problems.load("solo12-jump", torque_limit=2.0, voltage=24.0)


@pytest.mark.slow
def test_envelope_of_its_motors_binds_in_the_jump_of_solo12_and_changes_it():
    """At a quarter of the supply the voltage line binds at take-off; at full supply it never does."""
    full, low = (problems.load("solo12-jump", voltage=voltage) for voltage in (24.0, JUMP_VOLTAGE))
    free, bound = (trajopt.solve(problem, intervals=26) for problem in (full, low))
    for solution in (free, bound):
        assert solution.converged
        assert solution.statistics.iterations <= 60
        assert trajopt.check(solution).within(AT_POINTS)
    assert trajopt.check(free).drive_voltage_excess < -0.5
    drive = low.robot.drives[0]
    points, takeoff = bound.collocation, full.schedule.phases[0].duration
    use = np.abs(drive.voltage_use(bound.tau[points], bound.v[points, 6:]))
    assert use.max() == pytest.approx(1.0, abs=SOLVED)
    binding = bound.t[points][(use > 1 - 1e-4).any(axis=1)]
    assert ((binding > takeoff - 0.1) & (binding < takeoff)).any()
    there = np.abs(drive.voltage_use(free.tau, free.v[:, 6:])).max()
    assert there > 1.05  # the motion at full supply is not possible at the low one
    assert bound.statistics.objective > 1.005 * free.statistics.objective
    assert math.isclose(free.meta["durations"][0], bound.meta["durations"][0])
