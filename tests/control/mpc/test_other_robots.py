"""Drives of robots with any number of feet, on wheels, and on points that cannot stand still."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.driven_robots import WHEEL, around, walker, wheeled_quadruped
from trajopt.control.mpc.commands import Command, CommandScript
from trajopt.control.mpc.controller import Controller
from trajopt.control.mpc.gait_reference import RestingFeet
from trajopt.errors import InputError
from trajopt.robot import Robot, frame_pose
from trajopt.robot.legs import feet_in_base, wheel_rows
from trajopt.simulation.arm_drive import MOST_SLIDE, drive_arm, slide_ranges
from trajopt.simulation.lockstep import drive
from trajopt_library import robots

pytestmark = pytest.mark.long

# Means of speeds over a period are this near to commands, m/s and rad/s, of robots that walk at 0.1 m/s.
NEAR = 0.03


def feet_of(robot: Robot) -> RestingFeet:
    return RestingFeet(robot, list(feet_in_base(robot)))


def test_a_wheel_is_a_rolling_ball_on_the_axis_of_its_joint() -> None:
    for continuous in (True, False):
        robot = wheeled_quadruped(continuous=continuous)
        assert wheel_rows(robot) == {f"{leg}_wheel": 18 + i for i, leg in enumerate(("FL", "FR", "RL", "RR"))}
        np.testing.assert_allclose(feet_of(robot).posture[:12], robots.load("go2").reference[7:])
        np.testing.assert_array_equal(feet_of(robot).posture[12:], 0.0)
    held = replace(robot, contacts=tuple(replace(each, rolling=False) for each in robot.contacts))
    assert wheel_rows(held) == {}
    assert wheel_rows(robots.load("go2").with_rolling_contacts()) == {}


def test_wheels_permit_speeds_along_which_they_roll() -> None:
    assert feet_of(wheeled_quadruped()).rolling == ("speed",)
    assert feet_of(robots.load("go2").with_rolling_contacts()).rolling == ()


def test_robots_stand_on_three_points_or_a_sole() -> None:
    stable = {name: feet_of(robots.load(name)).stable for name in ("bolt", "hopper_space", "g1", "go2")}
    assert stable == {"bolt": False, "hopper_space": False, "g1": True, "go2": True}
    assert feet_of(walker(around(3))).stable


@pytest.mark.slow
def test_a_hexapod_walks_forward_sideways_and_in_a_curve() -> None:
    walking = Command(gait="tripod", speed=0.1, lateral=0.05, turn_rate=0.3)
    run = drive(walker(), CommandScript((0.0, 0.2), (Command(), walking)), duration=1.3)
    assert run.report.passed
    errors = run.report.mean_errors
    assert errors is not None
    assert max(errors.speed, errors.lateral, errors.turn_rate) < NEAR
    lifted = run.record.force[400:, :, 2] == 0
    assert (lifted.mean(axis=0) > 0.1).all()


@pytest.mark.slow
def test_a_quadruped_on_wheels_stands_still_and_rolls_over_whole_turns() -> None:
    speed = 0.8
    script = CommandScript((0.0, 0.3), (Command(), Command(speed=speed)))
    run = drive(wheeled_quadruped(), script, duration=1.3)
    assert run.report.passed
    assert np.abs(run.velocity[:300]).max() < 1e-3
    errors = run.report.mean_errors
    assert errors is not None
    assert max(errors.speed, errors.lateral, errors.turn_rate) < NEAR
    assert (run.record.force[20:, :, 2] > 0).all()
    qpos, qvel, count = run.record.qpos, run.record.qvel, len(run.record.feet)
    rates = run.scene.coordinates.rates_from_mujoco(qpos[:count], qvel[:count])
    turned = np.sum(rates[:, list(wheel_rows(run.controller.robot).values())], axis=0) * run.timeline.period
    assert run.record.qpos[-1, 0] / WHEEL > 2 * np.pi
    np.testing.assert_allclose(turned, run.record.qpos[-1, 0] / WHEEL, rtol=0.05)
    controller = run.controller
    for name in ("lateral", "turn_rate"):
        with pytest.raises(
            InputError, match=rf"{name} of a stand on wheels is 0.1; allowed: speed, or a gait"
        ):
            controller.possible(Command(**{name: 0.1}))
        assert controller.possible(Command(gait="walk", **{name: 0.1})).gait == "walk"
    with pytest.raises(InputError, match="lateral of a stand on wheels"):
        drive(
            wheeled_quadruped(), CommandScript((0.0,), (Command(lateral=0.2),)), controller=controller.fresh()
        )


@pytest.mark.slow
def test_a_biped_on_points_that_is_told_to_stand_steps_in_place() -> None:
    run = drive(robots.load("bolt"), CommandScript((0.0,), (Command(speed=0.2),)), duration=2.0)
    assert run.report.passed
    assert run.controller.clock.gait == "walk"
    assert np.abs(run.velocity[1000:, :2].mean(axis=0)).max() < NEAR
    assert run.report.mean_errors is None
    controller = Controller(robots.load("bolt"), ("walk",))
    assert controller.possible(Command(height=0.01)) == Command(gait="walk", height=0.01)


MOBILE = """
<mujoco model="mobile"><worldbody><body name="base" pos="0 0 0.1">
 <joint name="bx" type="slide" axis="1 0 0" range="-2 2" limited="true"/>
 <joint name="by" type="slide" axis="0 1 0"/>
 <geom type="box" size="0.3 0.2 0.1" mass="30"/>
 <body name="a2" pos="0.1 0 0.4"><joint name="shoulder" type="hinge" axis="0 1 0" range="-110 110"/>
  <geom type="capsule" fromto="0 0 0.05 0 0 0.3" size="0.03" mass="1.5"/>
  <body name="a3" pos="0 0 0.3"><joint name="elbow" type="hinge" axis="0 1 0" range="-140 140"/>
   <geom type="capsule" fromto="0 0 0.05 0 0 0.3" size="0.03" mass="1"/>
   <site name="tool" pos="0 0 0.3"/></body></body>
</body></worldbody>
<actuator><motor joint="bx" ctrlrange="-100 100"/><motor joint="by" ctrlrange="-100 100"/>
 <motor joint="shoulder" ctrlrange="-60 60"/><motor joint="elbow" ctrlrange="-40 40"/></actuator></mujoco>
"""


@pytest.mark.long
def test_an_arm_on_slides_reaches_as_far_as_they_do(tmp_path):
    path = tmp_path / "mobile.xml"
    path.write_text(MOBILE)
    read = Robot.from_mjcf(path, reference=np.array([0.0, 0.0, 0.6, 1.0]))
    robot = replace(read, velocity_limit=np.array([1.0, 1.0, 2.0, 2.0]))
    ranges, most = slide_ranges(robot, "tool"), MOST_SLIDE * robot.length
    assert ranges == pytest.approx(np.array([[-2.0, -most, 0.0], [2.0, most, 0.0]]))
    start = frame_pose(robot, robot.reference, "tool").translation
    goal = start + np.array([1.2, 0.4, 0.0])
    driven = drive_arm(robot, np.array([[0.0, *start], [0.2, *goal]]), duration=5.0)
    end = frame_pose(robot, driven.as_solution().q[-1], "tool").translation
    assert end == pytest.approx(goal, abs=5e-3)
    with pytest.raises(InputError, match=r"x is 10\.0; allowed: -"):
        drive_arm(robot, np.array([[0.0, 10.0, *start[1:]]]))
