"""URDF files that need a remedy: coupled joints, Xacro, limits and inertias that are not possible."""

from pathlib import Path

import pytest
from numpy.testing import assert_allclose

from trajopt.errors import InputError
from trajopt.inspection.report import robot_report
from trajopt.inspection.starter import guessed, starter
from trajopt.robot.actuators.mimic import MimicJoint
from trajopt.robot.robot import Robot

GRIPPER = """<robot name="gripper"><link name="palm">{body}</link>{fingers}</robot>"""
BODY = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
FINGER = """<link name="{name}">{body}</link><joint name="{name}_joint" type="prismatic"><parent link="palm"/>
<child link="{name}"/><axis xyz="0 1 0"/>
<limit lower="{lower}" upper="0.04" effort="9" velocity="1"/>{more}</joint>"""


def gripper(
    path: Path, more: str = '<mimic joint="left_joint"/>', lower: str = "0", body: str = BODY
) -> Path:
    fingers = FINGER.format(name="left", body=body, lower=lower, more="")
    fingers += FINGER.format(name="right", body=body, lower="0", more=more)
    path.write_text(GRIPPER.format(body=BODY, fingers=fingers), encoding="utf-8")
    return path


def test_a_joint_that_mimics_another_follows_it_unless_it_is_locked(tmp_path):
    path = gripper(tmp_path / "gripper.urdf", '<mimic joint="left_joint" multiplier="-2" offset="0.04"/>')
    robot = Robot.from_urdf(path, base="fixed")
    assert robot.mimics == (MimicJoint(joint="right_joint", mimics="left_joint", ratio=-2.0, offset=0.04),)
    assert (robot.nu, robot.passive) == (1, ("right_joint",))
    assert_allclose(robot.reference, [0.0, 0.04])
    assert_allclose([robot.position_lower[0], robot.position_upper[0]], [0.0, 0.02])
    assert robot.velocity_limit[0] == 0.5
    assert Robot.from_urdf(path, base="fixed", locked=["right_joint"]).nu == 1
    both = Robot.from_urdf(path, base="freeflyer", locked=["left_joint"], reference={"left_joint": 0.01})
    assert list(both.model.names)[1:] == ["root_joint"]
    assert Robot.from_urdf(gripper(path, more=""), base="fixed").nu == 2


def test_a_joint_that_mimics_a_fixed_or_missing_one_is_refused_unless_it_is_locked(tmp_path):
    path = gripper(tmp_path / "gripper.urdf", '<mimic joint="thumb"/>')
    with pytest.raises(
        InputError, match=r"'right_joint' mimics 'thumb'; lock them: locked=\['right_joint'\]"
    ):
        Robot.from_urdf(path, base="fixed")


def test_a_xacro_file_is_refused_with_the_command_that_expands_it(tmp_path):
    path = gripper(tmp_path / "gripper.urdf.xacro")
    with pytest.raises(InputError, match=r"expand it: xacro gripper.urdf.xacro > gripper\.urdf$"):
        Robot.from_urdf(path)
    macro = gripper(tmp_path / "gripper.urdf")
    text = macro.read_text().replace('name="gripper">', 'name="gripper" xmlns:xacro="http://ros.org/xacro">')
    macro.write_text(text)  # a file that was expanded may keep the namespace
    assert Robot.from_urdf(macro, base="fixed", locked=["right_joint"]).nu == 1
    macro.write_text(text.replace("</robot>", '<xacro:leg name="a"/></robot>'))
    with pytest.raises(InputError, match=r"xacro gripper.urdf > gripper_expanded\.urdf$"):
        Robot.from_urdf(macro)


def test_reversed_limits_name_their_joint_and_unit(tmp_path):
    path = gripper(tmp_path / "gripper.urdf", more="", lower="0.1")
    with pytest.raises(InputError, match=r"of joint 'left_joint' of 'gripper' are empty: 0\.1 > 0\.04 m"):
        Robot.from_urdf(path, base="fixed")


@pytest.mark.parametrize(("least", "accepted"), [("-5e-17", True), ("-1e-9", False)])
def test_an_inertia_may_be_negative_by_the_rounding_of_the_robot(least: str, accepted: bool, tmp_path):
    body = BODY.replace('izz="1"', f'izz="{least}"').replace('ixx="1" iyy="1"', 'ixx="1e-12" iyy="1e-12"')
    path = gripper(tmp_path / "gripper.urdf", more="", body=body)
    if accepted:
        assert Robot.from_urdf(path).nu == 2
    else:
        with pytest.raises(InputError, match="least principal inertia of the body moved by joint"):
            Robot.from_urdf(path)


def test_a_first_file_locks_joints_that_mimic_others(tmp_path):
    arm = gripper(tmp_path / "gripper.urdf").read_text().replace("</robot>", ARM)
    (tmp_path / "gripper.urdf").write_text(arm, encoding="utf-8")
    found, target = guessed(tmp_path / "gripper.urdf"), tmp_path / "mine.py"
    assert (found.base, list(found.model.names)[1:]) == ("fixed", ["hand_joint"])
    assert (
        "couplings of joints, which are locked: 'right_joint' mimics 'left_joint'"
        in robot_report(found).table()
    )
    scope = {"__file__": str(target)}
    exec(starter(found, target), scope)
    assert scope["build"]().model == found.model


ARM = f"""<transmission name="t"/><link name="hand">{BODY}</link><joint name="hand_joint" type="revolute">
<parent link="palm"/><child link="hand"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="9" velocity="1"/></joint></robot>"""


@pytest.mark.parametrize("value", ["nan", "inf", "two"])
def test_numbers_that_parsers_would_leave_out_name_their_link_or_joint(value: str, tmp_path):
    path = gripper(tmp_path / "gripper.urdf", body=BODY.replace('value="1"', f'value="{value}"'))
    with pytest.raises(InputError, match=f"value of <mass> of link 'left' is '{value}'; allowed: a finite"):
        Robot.from_urdf(path)
    path = gripper(path, f'<mimic joint="left_joint" multiplier="{value}"/>')
    with pytest.raises(InputError, match=f"multiplier of <mimic> of joint 'right_joint' is '{value}'"):
        Robot.from_urdf(path)
