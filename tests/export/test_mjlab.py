"""mjlab's motions, read as its MotionLoader does: the order of the simulator, without its free joint."""

from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.support.exported_plans import (
    SINGLE,
    place_of,
    plan_to_export,
    rotation_of,
    swinging_arm,
    swinging_quadruped,
    write_own_mjcf,
)
from tests.support.refusals import assert_refused_in_one_line
from trajopt.export.writing import export_motion
from trajopt.motion.solution import Solution

pytestmark = pytest.mark.long

RATE = 40
KEYS = ("joint_pos", "joint_vel", "body_pos_w", "body_quat_w", "body_lin_vel_w", "body_ang_vel_w")


def loaded(path: Path) -> dict[str, np.ndarray]:
    """What the loader reads."""
    with np.load(path) as data:
        return {key: data[key] for key in (*KEYS, "fps", "joint_torques")}


def edited(path: Path, change: object) -> Path:
    """The MJCF after a change of its elements, in a file beside it."""
    tree = ElementTree.parse(path)
    change(tree.getroot())  # type: ignore[operator]
    other = path.with_name("edited.xml")
    tree.write(other)
    return other


def turn_legs_around(root: ElementTree.Element) -> None:
    """The bodies on the base in the opposite order, the keyframes of the former order left out."""
    base = root.find("worldbody/body")
    assert base is not None
    legs = base.findall("body")
    for leg in legs:
        base.remove(leg)
    base.extend(reversed(legs))
    for keyframe in root.findall("keyframe"):
        root.remove(keyframe)


def assert_follows(plan: Solution, read: dict[str, np.ndarray], mjcf: Path) -> None:
    """Columns are joints and bodies of the compiled model, with the plan's values by name."""
    model = mujoco.MjModel.from_xml_path(str(mjcf))
    kinds = model.jnt_type
    joints = [model.joint(i).name for i in range(model.njnt) if kinds[i] != mujoco.mjtJoint.mjJNT_FREE]
    bodies = [model.body(i).name for i in range(1, model.nbody)]
    assert read["joint_pos"].shape[1] == read["joint_vel"].shape[1] == len(joints)
    assert read["body_pos_w"].shape[1:] == (len(bodies), 3)
    for row in range(0, int(plan.t[-1] * RATE), 4):
        own = plan.sample(times=[row / RATE])
        for column, name in enumerate(joints):
            assert_allclose(
                read["joint_pos"][row, column], own.q[0, own.position_names.index(name)], atol=SINGLE
            )
            rate = own.v[0, own.velocity_names.index(name)]
            assert_allclose(read["joint_vel"][row, column], rate, rtol=SINGLE, atol=SINGLE)
            torque = own.drive_torque[0, own.torque_names.index(name)]
            assert_allclose(read["joint_torques"][row, column], torque, rtol=SINGLE, atol=SINGLE)
        for column, name in enumerate(bodies):
            place = place_of(plan.model, name, own.q[0], own.v[0])
            assert_allclose(read["body_pos_w"][row, column], place.pose.translation, atol=SINGLE)
            turn = rotation_of(read["body_quat_w"][row, column])
            assert_allclose(turn, place.pose.rotation, atol=SINGLE)
            assert_allclose(read["body_lin_vel_w"][row, column], place.linear, atol=5 * SINGLE)
            angular = read["body_ang_vel_w"][row, column]
            assert_allclose(angular, place.angular, rtol=SINGLE, atol=5 * SINGLE)


@pytest.mark.parametrize("kind", ["turning trot", "mirrored walk", "an arm", "an impact"])
def test_joints_and_bodies_are_those_of_the_plans_own_model(kind: str, tmp_path: Path) -> None:
    plan = plan_to_export(kind)
    mjcf = write_own_mjcf(plan, tmp_path / "robot.xml")
    read = loaded(export_motion(plan, "mjlab", tmp_path / "a.npz", RATE))
    assert (read["fps"].shape, read["fps"][0]) == ((1,), RATE)
    assert {str(read[key].dtype) for key in KEYS} == {"float32"}
    assert_follows(plan, read, mjcf)


def test_joints_and_bodies_are_in_the_order_of_the_mjcf(tmp_path: Path) -> None:
    plan = plan_to_export("turning trot")
    mjcf = edited(write_own_mjcf(plan, tmp_path / "robot.xml"), turn_legs_around)
    read = loaded(export_motion(plan, "mjlab", tmp_path / "a.npz", RATE, mjcf=mjcf))
    with np.load(tmp_path / "a.npz") as data:
        assert data["joint_names"][0].startswith("HR")
    assert_follows(plan, read, mjcf)


def test_an_mjcf_whose_free_joint_and_base_have_other_names_is_matched(tmp_path: Path) -> None:
    plan = plan_to_export("turning trot")
    own = write_own_mjcf(plan, tmp_path / "robot.xml")

    def rename(root: ElementTree.Element) -> None:
        base = root.find("worldbody/body")
        assert base is not None
        base.set("name", "trunk")
        next(one for one in root.iter("joint") if one.get("type") == "free").attrib.pop("name")

    export_motion(plan, "mjlab", tmp_path / "a.npz", RATE)
    export_motion(plan, "mjlab", tmp_path / "b.npz", RATE, mjcf=edited(own, rename))
    first, second = (loaded(tmp_path / name) for name in ("a.npz", "b.npz"))
    for key in KEYS:
        assert_allclose(first[key], second[key], atol=SINGLE)


def test_a_joint_that_the_plan_holds_keeps_its_angle(tmp_path: Path) -> None:
    """The plan's robot has it locked, the simulator's robot has it as a hinge."""
    whole, locked = swinging_arm(), swinging_arm(locked=("elbow_joint",))
    angle = float(whole.q[0, whole.joint_names.index("elbow_joint")])
    mjcf = write_own_mjcf(whole, tmp_path / "robot.xml")
    read = loaded(export_motion(locked, "mjlab", tmp_path / "a.npz", RATE, mjcf=mjcf))
    column = whole.joint_names.index("elbow_joint")
    assert_allclose(read["joint_pos"][:, column], angle, atol=SINGLE)
    assert_allclose(read["joint_vel"][:, column], 0.0)
    own = locked.sample(times=[1 / RATE])
    hand = place_of(locked.model, "wrist_3_link", own.q[0], own.v[0])
    assert_allclose(read["body_pos_w"][1, -1], hand.pose.translation, atol=SINGLE)


def test_a_base_of_several_joints_moves_the_free_joint_of_the_mjcf(tmp_path: Path) -> None:
    plan = swinging_quadruped()
    mjcf = write_own_mjcf(plan_to_export("turning trot"), tmp_path / "robot.xml")
    assert_follows(plan, loaded(export_motion(plan, "mjlab", tmp_path / "a.npz", RATE, mjcf=mjcf)), mjcf)


def rename_joint(root: ElementTree.Element) -> None:
    for element in root.iter():
        for key in ("name", "joint"):
            if element.get(key) == "FL_HFE":
                element.set(key, "thigh")


def lengthen_leg(root: ElementTree.Element) -> None:
    shank = next(one for one in root.iter("body") if one.get("name") == "FL_LOWER_LEG")
    shank.set("pos", "0 0.0374 -0.2")


def weld_base(root: ElementTree.Element) -> None:
    base = root.find("worldbody/body")
    assert base is not None
    base.remove(next(one for one in base if one.get("type") == "free"))
    for keyframe in root.findall("keyframe"):
        root.remove(keyframe)


def hinge_as_ball(root: ElementTree.Element) -> None:
    body = ElementTree.SubElement(root.find("worldbody"), "body", name="ball")  # type: ignore[arg-type]
    ElementTree.SubElement(body, "joint", name="round", type="ball")
    ElementTree.SubElement(body, "inertial", pos="0 0 0", mass="1", diaginertia="1 1 1")
    for keyframe in root.findall("keyframe"):
        root.remove(keyframe)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (rename_joint, "joint 'FL_HFE' of the motion is not in"),
        (lengthen_leg, "has 'FL_LOWER_LEG' 40 mm from where the motion has it; allowed: a model of solo12"),
        (weld_base, "has 0 free joints; allowed: 1"),
        (hinge_as_ball, "joint 'round' of"),
    ],
)
def test_a_model_of_another_robot_is_refused_in_one_line(change: object, words: str, tmp_path: Path) -> None:
    plan = plan_to_export("turning trot")
    mjcf = edited(write_own_mjcf(plan, tmp_path / "robot.xml"), change)
    target = tmp_path / "a.npz"
    assert_refused_in_one_line(lambda: export_motion(plan, "mjlab", target, RATE, mjcf=mjcf), words)
    assert not target.exists()


def test_a_joint_that_the_motion_lacks_is_refused(tmp_path: Path) -> None:
    mjcf = write_own_mjcf(plan_to_export("an arm"), tmp_path / "robot.xml")
    with_finger, plan = edited(mjcf, add_finger), plan_to_export("an arm")
    assert_refused_in_one_line(
        lambda: export_motion(plan, "mjlab", tmp_path / "a.npz", mjcf=with_finger), "joint 'finger' of"
    )


def add_finger(root: ElementTree.Element) -> None:
    last = list(root.iter("body"))[-1]
    finger = ElementTree.SubElement(last, "body", name="finger_link")
    ElementTree.SubElement(finger, "joint", name="finger", axis="0 0 1")
    ElementTree.SubElement(finger, "inertial", pos="0 0 0", mass="1", diaginertia="1 1 1")
    for keyframe in root.findall("keyframe"):
        root.remove(keyframe)


@pytest.mark.parametrize("text", [None, "no xml", "<mujoco><worldbody><body/></worldbody></mujoco"])
def test_a_file_that_is_no_mjcf_is_refused_in_one_line(text: str | None, tmp_path: Path) -> None:
    mjcf, target = tmp_path / "robot.xml", tmp_path / "a.npz"
    if text is not None:
        mjcf.write_text(text)
    words = "robot.xml"
    assert_refused_in_one_line(
        lambda: export_motion(plan_to_export("an arm"), "mjlab", target, mjcf=mjcf), words
    )
    assert not target.exists()
