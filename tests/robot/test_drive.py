"""Drives: closed forms of gear, friction, current and voltage; what a robot makes of them; the file."""

import json
import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from tests.support.problems import hopper, one_joint_arm
from trajopt.errors import InputError, UnsupportedJointError
from trajopt.robot.actuators.drive import Drive
from trajopt.robot.actuators.on_robot import drive_torque_values
from trajopt.robot.robot import Robot
from trajopt_library import robots
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


@pytest.mark.parametrize(
    ("change", "message"),
    [
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
    ],
)
def test_drives_that_cannot_be_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        Drive(**{"gear_ratio": 2.0, **change})


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
