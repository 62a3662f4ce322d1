"""Models of a stance: joints, limits, units, pictures, and what has no stance mode."""

import numpy as np
import pinocchio as pin
import pytest

from tests.support.problems import FOOT, hopper
from tests.support.stances import CASES, mode_of, random_state
from trajopt.errors import InputError, UnsupportedJointError
from trajopt.robot.actuators.drive import Drive
from trajopt.robot.contact import Contact
from trajopt.robot.data import robot_file
from trajopt.robot.robot import Robot
from trajopt.robot.stance.minimal_coordinates import stance_mode
from trajopt.robot.units import Units
from trajopt_library import robots

# Rounding of algorithms over a dozen bodies with forces of tens of newtons.
ROUNDING = 1e-10
every_case = pytest.mark.parametrize("name", CASES)


@every_case
def test_joints_are_in_the_depth_first_order_that_pinocchio_wants(name):
    model = mode_of(name).robot.model
    assert model.check(model.createData())


def test_limits_armature_and_drives_stay_with_their_joints():
    robot = robots.load("hopper")
    strong = Drive(gear_ratio=5.0, rotor_inertia=1e-4, torque_limit=3.0)
    driven = robot.with_drives({"knee": strong})
    stance = stance_mode(driven, "foot").robot
    knee, hip = 0, 1
    np.testing.assert_array_equal(stance.torque_limit[[hip, knee]], driven.torque_limit)
    assert (stance.drives[knee], stance.drives[hip]) == (strong, None)
    np.testing.assert_array_equal(stance.model.armature, [0, *driven.model.armature[[4, 3]]])
    np.testing.assert_array_equal(stance.position_lower[1:], driven.position_lower[[5, 4]])
    assert np.isinf(stance.position_lower[0])
    np.testing.assert_array_equal(stance.velocity_limit[1:], driven.velocity_limit[[4, 3]])


def test_both_coordinates_have_the_same_units_and_reference():
    mode = mode_of("solo12")
    ours, theirs = Units(mode.robot), Units(mode.floating)
    assert (ours.length, ours.force, ours.time) == pytest.approx((theirs.length, theirs.force, theirs.time))
    lifted, _, _ = mode.lifted(mode.robot.reference)
    assert np.abs(pin.difference(mode.floating.model, mode.floating.reference, lifted)).max() < ROUNDING
    assert [contact.name for contact in mode.robot.contacts] == ["FL_FOOT", "FR_FOOT", "HR_FOOT"]


def test_the_anchor_is_where_the_model_stands():
    mode = stance_mode(robots.load("hopper"), "foot", anchor=[0.5, 7.0, 0.1])
    data = mode.robot.model.createData()
    pin.framesForwardKinematics(mode.robot.model, data, random_state(mode)[0])
    foot = data.oMf[mode.robot.model.getFrameId("foot")].translation
    np.testing.assert_allclose(foot, [0.5, 0.0, 0.1], atol=ROUNDING)  # a planar robot stays in its plane


@pytest.mark.long
def test_pictures_hang_on_the_turned_links():
    mode = mode_of("solo12")
    q, _, _ = random_state(mode)
    placed = []
    for robot, state in ((mode.robot, q), (mode.floating, mode.lifted(q)[0])):
        geometry = mode.floating.visual.geometry(robot.model)
        data = geometry.createData()
        pin.updateGeometryPlacements(robot.model, robot.model.createData(), geometry, data, state)
        placed.append(np.array([placement.homogeneous for placement in data.oMg]))
    np.testing.assert_allclose(placed[0], placed[1], atol=ROUNDING)


@pytest.mark.parametrize(
    ("make", "contact", "anchor", "message"),
    [
        (lambda: robots.load("ur5"), "tool0", None, "has base='fixed'"),
        (lambda: robots.load("solo12"), "hand", None, "has no contact 'hand'"),
        (lambda: hopper("surface"), FOOT, None, "is a surface; a point contact"),
        (lambda: robots.load("hopper"), "foot", [0.0, np.nan, 0.0], "3 finite numbers"),
        (lambda: robots.load("hopper"), "foot", [0.0, 0.0], "3 finite numbers"),
    ],
)
def test_what_has_no_stance_mode_is_refused(make, contact, anchor, message):
    with pytest.raises(InputError, match=message):
        stance_mode(make(), contact, anchor=anchor)


def test_a_planar_robot_whose_leg_leaves_the_plane_is_refused():
    robot = Robot.from_urdf(robot_file("go2_description/urdf/go2.urdf"), base="planar", contacts=["FL_foot"])
    with pytest.raises(InputError, match=r"'FL_hip_joint' leaves the plane.*lock it"):
        stance_mode(robot, "FL_foot")


def test_a_ball_joint_in_the_leg_is_refused():
    model = pin.Model(hopper().model)
    ball = model.addJoint(model.getJointId("shank"), pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(ball, pin.Inertia.FromSphere(0.1, 0.05), pin.SE3.Identity())
    model.addFrame(pin.Frame("toe", ball, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    robot = Robot.from_model(model, contacts=[Contact(frame="toe")])
    with pytest.raises(UnsupportedJointError, match=r"'ball' is of kind Spherical.*one degree of freedom"):
        stance_mode(robot, "toe")


@pytest.mark.parametrize(
    ("passive", "message"),
    [
        (("elbow",), "'elbow' is unknown"),
        (("root_joint",), "'root_joint' is unknown; one of hip, knee"),
        (("hip", "hip"), "'hip' is named twice"),
    ],
)
def test_passive_joints_must_exist_and_are_named_once(passive, message):
    with pytest.raises(InputError, match=message):
        Robot.from_model(robots.load("hopper").model, passive=passive)


def test_passive_joints_follow_the_base_and_leave_with_a_lock():
    robot = Robot.from_model(robots.load("hopper").model, passive=["hip"])
    assert (robot.n_unactuated, robot.nu, len(robot.torque_limit)) == (4, 1, 1)
    locked = robot.with_locked(["hip"])
    assert (locked.passive, locked.n_unactuated, locked.nu) == ((), 3, 1)
    np.testing.assert_array_equal(locked.torque_limit, robot.torque_limit)


def test_any_joint_may_be_passive():
    hopper = robots.load("hopper")
    robot = Robot.from_model(hopper.model, passive=["knee"])
    np.testing.assert_array_equal(robot.unactuated_rows, [0, 1, 2, 4])
    np.testing.assert_array_equal(robot.actuated_rows, [3])
    np.testing.assert_array_equal(robot.torque_limit, hopper.torque_limit[:1])
    assert robot.with_locked(["hip"]).nu == 0
