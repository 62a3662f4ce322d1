"""First robot files: feet, postures and limits from a description alone, and the motion they are offered."""

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from scripts.measure.descriptions import CERTIFIED, first_file
from tests.support.command_lines import invoke
from tests.support.refusals import refused
from trajopt import Contact, Robot
from trajopt.inspection.standing import standing_posture
from trajopt.inspection.starter import guessed, starter
from trajopt.robot import contact_positions, robot_file, without_zero_limits
from trajopt.robot.building import with_frames
from trajopt.robot.legs import wheel_rows
from trajopt_library import robots

# Description in example-robot-data, base, what it stands on and the command that it is offered.
ARM, FREE = "arm-reach", "arm-reach --set orientation=free"
QUADRUPED, BIPED = "quadruped-stand-up", "biped-squat"
SOLVED = [
    ("anymal_c_simple_description/urdf/anymal.urdf", "freeflyer", "4 points", QUADRUPED),
    ("solo_description/robots/solo.urdf", "freeflyer", "4 points", QUADRUPED),
    ("go2_description/urdf/go2.urdf", "freeflyer", "4 points", QUADRUPED),
    ("quadruped_description/urdf/quadruped.urdf", "freeflyer", "4 points", QUADRUPED),
    ("bolt_description/robots/bolt.urdf", "freeflyer", "2 points", BIPED),
    ("g1_description/urdf/g1_29dof_rev_1_0.urdf", "freeflyer", "2 soles", BIPED),
    ("alexander_description/urdf/alexander_v1.lowerBodyOnly.urdf", "freeflyer", "2 soles", BIPED),
    ("icub_description/robots/icub_reduced.urdf", "freeflyer", "2 soles", BIPED),
    ("ur_description/urdf/ur5_gripper.urdf", "fixed", "", ARM),
    ("kinova_description/robots/kinova.urdf", "fixed", "", ARM),
    ("baxter_description/urdf/baxter.urdf", "fixed", "", ARM),
    ("tiago_description/robots/tiago_no_hand.urdf", "fixed", "", ARM),
    ("double_pendulum_description/urdf/double_pendulum.urdf", "fixed", "", FREE),
]
# Angles of a file have four decimals.
WRITTEN = 1e-3
# A leg is as long as asked up to the moves of its foot under the centre of mass.
BENT = 0.02


@pytest.mark.long
@pytest.mark.parametrize(("file", "base", "feet", "command"), SOLVED, ids=[each[0] for each in SOLVED])
def test_a_first_file_solves_the_family_that_it_is_offered_unedited(
    file: str, base: str, feet: str, command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert first_file(robot_file(file)) == (base, feet, command, CERTIFIED, "")


def test_soles_and_balls_are_those_of_the_library() -> None:
    found, known = guessed(robot_file("g1_description/urdf/g1_29dof_rev_1_0.urdf")), robots.load("g1")
    for sole, own in zip(found.contacts, known.contacts, strict=True):
        assert (sole.half_length, sole.half_width) == (own.half_length, own.half_width)
        places = [r.model.frames[r.model.getFrameId(c.frame)] for r, c in ((found, sole), (known, own))]
        np.testing.assert_allclose(places[0].placement.translation[:2], places[1].placement.translation[:2])
    file = "anymal_c_simple_description/urdf/anymal.urdf"
    found, known = guessed(robot_file(file)), robots.load("anymal_c")
    assert {contact.radius for contact in found.contacts} == {contact.radius for contact in known.contacts}
    assert list(found.model.names) == list(known.model.names)
    balls = contact_positions(found, known.reference)
    for leg, place in contact_positions(known, known.reference).items():
        np.testing.assert_allclose(balls[f"{leg}_FOOT_ball"], place, atol=1e-4)


@pytest.mark.parametrize(
    ("file", "hip", "knee"),
    [
        ("solo_description/robots/solo12.urdf", "FL_HFE", "FL_KFE"),
        ("anymal_b_simple_description/robots/anymal.urdf", "LH_HFE", "LH_KFE"),
        ("hyq_description/robots/hyq_no_sensors.urdf", "rf_hfe_joint", "rf_kfe_joint"),
    ],
)
def test_legs_are_bent_and_feet_under_the_centre_of_mass(file: str, hip: str, knee: str) -> None:
    robot = guessed(robot_file(file))
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.reference)
    numbers = [robot.model.getJointId(name) for name in (hip, knee)]
    (foot,) = (
        place
        for contact, place in contact_positions(robot, robot.reference).items()
        if robot.model.frames[robot.model.getFrameId(contact)].parentJoint == numbers[1]
    )
    top, middle = (data.oMi[number].translation for number in numbers)
    across = [(place - top)[[0, 2]] for place in (middle, foot)]
    straight = np.linalg.norm(across[0]) + np.linalg.norm(across[1] - across[0])
    assert np.linalg.norm(across[1]) / straight == pytest.approx(0.87, abs=BENT)
    rest = standing_posture(robot)
    assert rest.balanced
    middle = np.mean(list(contact_positions(robot, robot.reference).values()), axis=0)
    np.testing.assert_allclose(rest.centre, middle[:2], atol=WRITTEN)


CASES = Path(__file__).parent / "descriptions"


def test_a_cart_rolls_on_its_wheels_and_is_offered_a_drive(tmp_path: Path) -> None:
    target = tmp_path / "cart.py"
    shown = invoke("robot", str(CASES / "cart.urdf"), "--write", str(target)).output
    assert f"next       trajopt drive {target}" in shown
    robot = robots.load(str(target))
    assert wheel_rows(robot) == {f"{wheel}_wheel": 6 + n for n, wheel in enumerate(("fl", "fr", "rl", "rr"))}
    assert {contact.radius for contact in robot.contacts} == {0.1}


def test_a_driven_crank_and_the_knee_that_follows_it_are_not_locked(tmp_path: Path) -> None:
    found, target = guessed(CASES / "coupled.xml"), tmp_path / "leg.py"
    assert {each.joint: each.mimics for each in found.mimics} == {"knee": "crank", "rod": "crank"}
    target.write_text(starter(found, target), encoding="utf-8")
    np.testing.assert_allclose(robots.load(str(target)).reference, found.reference, atol=WRITTEN)


def test_what_could_not_be_guessed_is_said_in_one_line(tmp_path: Path) -> None:
    for file, line in (
        ("hector_description/robots/quadrotor_base.urdf", "no family fits: hector stands on 0 feet"),
        ("iris_description/robots/iris.urdf", "no family fits: iris stands on 0 feet"),
    ):
        shown = invoke(
            "robot", str(robot_file(file)), "--write", str(tmp_path / f"{Path(file).stem}.py")
        ).output
        assert re.search(rf"^  next +{line}.*$", shown, re.MULTILINE)


def test_zeros_of_a_file_are_no_limits() -> None:
    robot = Robot.from_urdf(robot_file("double_pendulum_description/urdf/double_pendulum.urdf"), base="fixed")
    free = without_zero_limits(robot, {"joint1": 0.5})
    assert free.torque_limit is None
    assert np.isinf(free.velocity_limit).all()
    assert np.isinf(free.position_upper).all()
    assert free.reference[0] == 0.5
    known = robots.load("ur5")
    same = without_zero_limits(known)
    np.testing.assert_array_equal(same.position_lower, known.position_lower)
    np.testing.assert_array_equal(same.torque_limit, known.torque_limit)


def test_frames_are_added_to_others() -> None:
    turned = ("ee_link", (0.1, 0.0, 0.2), (0.0, 0.0, np.pi / 2))
    file = robot_file("ur_description/urdf/ur5_robot.urdf")
    robot = Robot.from_urdf(file, base="fixed", frames={"tip": turned}, contacts=[Contact(frame="tip")])
    frames = [robot.model.frames[robot.model.getFrameId(name)].placement for name in ("ee_link", "tip")]
    apart = frames[0].actInv(frames[1])
    np.testing.assert_allclose(apart.translation, turned[1], atol=1e-12)
    np.testing.assert_allclose(apart.rotation, pin.utils.rotate("z", np.pi / 2), atol=1e-12)
    for frames, words in (
        (
            {"tip": ("no", (0, 0, 0), (0, 0, 0))},
            "frame 'tip' names frame 'no', which the model does not have",
        ),
        ({"tool0": ("ee_link", (0, 0, 0), (0, 0, 0))}, "frame 'tool0' to add is in the model already"),
    ):
        with refused(words):
            with_frames(robot.model, frames)
