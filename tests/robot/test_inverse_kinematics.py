"""Where frames are, and branches of inverse kinematics: all, within limits, against a closed form."""

import itertools
import math

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.models import placement
from trajopt import InputError, Robot
from trajopt.robot import (
    contact_positions,
    frame_pose,
    inverse_kinematics,
    inverse_kinematics_branches,
    robot_file,
)
from trajopt_library import robots
from trajopt_library.robots import irb1600

pytestmark = pytest.mark.long

# Postures are refined until the pose error is below this, m and rad.
REFINED = 1e-10
# What that error makes of joint angles away from singularities, rad.
ANGLE = 1e-7
SEED = 3
# Of a chain of rotations and lengths of order one, m.
ROUNDING = 1e-13


def pose(robot: Robot, q: np.ndarray, frame: str) -> pin.SE3:
    return placement(robot.model, q, frame)


def wrapped(angle):
    return (np.asarray(angle) + math.pi) % (2 * math.pi) - math.pi


def closed_form(target: pin.SE3) -> list[np.ndarray]:
    """All postures of the IRB 1600 in one turn: two shoulders, two elbows, two wrists (spherical wrist)."""
    forward = target.rotation[:, 2]
    x, y, z = target.translation - 0.065 * forward
    found = []
    for shoulder, elbow, wrist in itertools.product((1, -1), repeat=3):
        q1 = math.atan2(shoulder * y, shoulder * x)
        r, h = shoulder * math.hypot(x, y) - 0.15, z - 0.4865
        # upper arm 0.7 m up at zero, forearm 0.6 m forward at zero: the angle between them at the elbow
        cosine = (r * r + h * h - 0.7**2 - 0.6**2) / (2 * 0.7 * 0.6)
        if abs(cosine) > 1:
            continue
        bend = elbow * math.acos(cosine)
        q2 = math.atan2(r, h) - math.atan2(0.6 * math.sin(bend), 0.7 + 0.6 * math.cos(bend))
        q3 = bend - math.pi / 2
        arm = pin.rpy.rpyToMatrix(0, 0, q1) @ pin.rpy.rpyToMatrix(0, q2 + q3, 0)
        # wrist: Rx(q4) Ry(q5) Rx(q6), the flange turned by Ry(pi / 2)
        w = arm.T @ target.rotation @ pin.rpy.rpyToMatrix(0, math.pi / 2, 0).T
        q5 = wrist * math.acos(np.clip(w[0, 0], -1, 1))
        s = math.sin(q5)
        q4, q6 = math.atan2(w[1, 0] / s, -w[2, 0] / s), math.atan2(w[0, 1] / s, w[0, 2] / s)
        found.append(wrapped([q1, q2, q3, q4, q5, q6]))
    return found


def within(robot: Robot, q: np.ndarray) -> bool:
    """Whether some whole turns of each joint bring q within limits."""
    turns = 2 * math.pi * np.arange(-2, 3)[:, None]
    inside = (q + turns >= robot.position_lower) & (q + turns <= robot.position_upper)
    return bool(inside.any(axis=0).all())


def same_set(found: list[np.ndarray], expected: list[np.ndarray]) -> bool:
    return len(found) == len(expected) and all(
        min(np.abs(wrapped(q - other)).max() for q in found) < ANGLE for other in expected
    )


def test_all_eight_branches_of_the_irb1600_are_those_of_the_closed_form():
    """The wrist close to the base, so that the arm reaches it over its back too."""
    robot = robots.load("irb1600")
    target = pose(robot, np.array([0.4, 0.3, 0.6, 0.7, 0.8, -0.5]), irb1600.TOOL)
    expected = closed_form(target)
    assert len(expected) == 8
    wide = Robot.from_model(_unlimited(robot), base="fixed", reference=robot.reference)
    found = inverse_kinematics_branches(wide, {irb1600.TOOL: target})
    assert same_set([posture.q for posture in found], expected)


def _unlimited(robot: Robot) -> pin.Model:
    model = pin.Model(robot.model)
    model.lowerPositionLimit, model.upperPositionLimit = np.full(6, -math.pi), np.full(6, math.pi)
    return model


def test_branches_within_limits_are_those_of_the_closed_form_at_random_poses():
    robot, generator = robots.load("irb1600"), np.random.default_rng(SEED)
    counts = set()
    for _ in range(10):
        q = generator.uniform(robot.position_lower, robot.position_upper)
        target = pose(robot, q, irb1600.TOOL)
        expected = [posture for posture in closed_form(target) if within(robot, posture)]
        found = inverse_kinematics_branches(robot, {irb1600.TOOL: target})
        assert same_set([posture.q for posture in found], expected)
        counts.add(len(found))
    assert len(counts) > 1  # limits did take branches away


@pytest.mark.parametrize("name", ["irb1600", "ur5"])
def test_every_branch_reaches_the_pose_within_limits_and_the_nearest_comes_first(name):
    robot, generator = robots.load(name), np.random.default_rng(SEED)
    q = robot.reference + generator.uniform(-0.3, 0.3, robot.nq)
    target = pose(robot, q, "tool0")
    found = inverse_kinematics_branches(robot, {"tool0": target}, near=q)
    for posture in found:
        error = pin.log6(target.actInv(pose(robot, posture.q, "tool0"))).vector
        assert np.linalg.norm(error) < REFINED
        assert (posture.q >= robot.position_lower - REFINED).all()
        assert (posture.q <= robot.position_upper + REFINED).all()
    assert_allclose(found[0].q, q, atol=ANGLE)
    distances = [np.linalg.norm(posture.q - q) for posture in found]
    assert distances == sorted(distances)


def test_ur5_has_eight_branches_and_more_starts_find_no_more():
    robot = robots.load("ur5")
    target = pose(robot, np.array([0.3, -1.1, 1.2, -0.9, 1.0, 0.4]), "tool0")
    few, many = (inverse_kinematics_branches(robot, {"tool0": target}, starts=n) for n in (256, 600))
    assert len(few) == 8
    assert same_set([posture.q for posture in few], [posture.q for posture in many])


def test_turns_add_whole_turns_within_limits():
    robot = robots.load("irb1600")
    target = pose(robot, np.array([0.4, 0.3, -0.4, 0.7, 0.8, -0.5]), irb1600.TOOL)
    once = inverse_kinematics_branches(robot, {irb1600.TOOL: target})
    turned = inverse_kinematics_branches(robot, {irb1600.TOOL: target}, turns=True)
    expected = 0
    for posture in once:
        choices = [
            sum(low <= q + 2 * math.pi * k <= high for k in range(-3, 4))
            for q, low, high in zip(posture.q, robot.position_lower, robot.position_upper, strict=True)
        ]
        expected += math.prod(choices)
    assert len(turned) == expected > len(once)


def test_redundant_arm_gets_representatives_apart_from_each_other():
    panda = Robot.from_urdf(
        robot_file("panda_description/urdf/panda.urdf"),
        base="fixed",
        locked=["panda_finger_joint1", "panda_finger_joint2"],
    )
    target = pose(panda, panda.reference, "panda_hand")
    found = inverse_kinematics_branches(panda, {"panda_hand": target}, starts=64, separation=0.8)
    assert len(found) > 1
    assert all(posture.error < REFINED for posture in found)
    for one, other in itertools.combinations(found, 2):
        assert np.linalg.norm(wrapped(one.q - other.q)) > 0.8


def test_position_alone_on_a_six_joint_arm_is_redundant_too():
    robot = robots.load("irb1600")
    found = inverse_kinematics_branches(robot, {irb1600.TOOL: np.array([0.9, 0.2, 0.8])}, starts=32)
    assert len(found) > 1
    for posture in found:
        assert_allclose(pose(robot, posture.q, irb1600.TOOL).translation, [0.9, 0.2, 0.8], atol=REFINED)


def test_search_is_deterministic_and_nothing_out_of_reach_is_found():
    robot = robots.load("irb1600")
    target = {irb1600.TOOL: pose(robot, robot.reference, irb1600.TOOL)}
    first, second = (inverse_kinematics_branches(robot, target, starts=40) for _ in range(2))
    assert [posture.q.tolist() for posture in first] == [posture.q.tolist() for posture in second]
    far = pin.SE3(np.eye(3), np.array([3.0, 0.0, 0.5]))
    assert inverse_kinematics_branches(robot, {irb1600.TOOL: far}, starts=40) == ()
    with pytest.raises(InputError, match="starts of inverse_kinematics_branches is 0"):
        inverse_kinematics_branches(robot, target, starts=0)


def test_frames_and_contacts_are_where_the_joints_carry_them():
    robot = robots.load("talos")
    q = pin.integrate(robot.model, robot.reference, np.random.default_rng(SEED).normal(size=robot.nv))
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    places = contact_positions(robot, q)
    assert list(places) == [contact.name for contact in robot.contacts]
    for contact in robot.contacts:
        frame = robot.model.frames[robot.model.getFrameId(contact.frame)]
        carried = data.oMi[frame.parentJoint] * frame.placement
        assert_allclose(places[contact.name], carried.translation, atol=ROUNDING)
        found = frame_pose(robot, q, contact.frame)
        assert_allclose(found.homogeneous, carried.homogeneous, atol=ROUNDING)


def test_pose_of_an_unknown_frame_names_those_close_to_it():
    robot = robots.load("irb1600")
    with pytest.raises(InputError, match=r"no frame 'tool1'.*tool0"):
        frame_pose(robot, robot.reference, "tool1")


@pytest.mark.parametrize(
    ("q", "targets", "message"),
    [
        (None, {"tool1": np.zeros(3)}, r"no frame 'tool1'.*tool0"),
        (None, {"tool0": np.zeros(2)}, r"target of 'tool0' has shape \(2,\); allowed: \(3,\), or an SE3"),
        (None, {}, "targets are empty"),
        (np.zeros(3), {"tool0": np.zeros(3)}, r"q has shape \(3,\); allowed: \(6,\)"),
    ],
)
def test_targets_that_are_none_are_refused(q, targets, message):
    robot = robots.load("irb1600")
    with pytest.raises(InputError, match=message):
        inverse_kinematics(robot, robot.reference if q is None else q, targets)
    with pytest.raises(InputError, match=message):
        inverse_kinematics_branches(robot, targets, near=q)
