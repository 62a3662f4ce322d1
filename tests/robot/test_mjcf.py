"""MJCF as MuJoCo compiles it: every feature gives the model MuJoCo's own poses, masses and dynamics."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from tests.support.mjcf_files import FEET, HINGES, QUADRUPED, SCENE, arm
from tests.support.mujoco_comparison import differences
from trajopt.errors import InputError
from trajopt.robot.mjcf import compile_mjcf, joint_names, mjcf_model
from trajopt.robot.robot import Robot

# Rounding of sums of a few dozen products, as a part of the largest.
ROUNDING = 1e-12
MESH = '<asset><mesh name="m" vertex="0 0 0 0.1 0 0 0 0.1 0 0 0 0.2"/></asset>'
LOCAL = {"pos": "0.02 -0.1 0.07", "axis": "1 2 -0.5"}
FREE = arm(first='<freejoint name="root"/>', second='<joint name="jb" axis="1 2 3" pos="0.1 0.2 0"/>')

FEATURES = {
    "quadruped": QUADRUPED,
    "hinges": arm(),
    "free joint": FREE,
    "free joint with velocity-dependent forces": FREE.replace(
        "<worldbody>", '<option gravity="1 2 -3"/><worldbody>'
    ),
    "free tree behind another": FREE.replace(
        "<worldbody>", '<worldbody><body name="door"><joint name="jd"/><geom size="0.1" pos="1 0 0"/></body>'
    ),
    "ball": arm(second='<joint name="jb" type="ball" pos="0.1 0 0"/>'),
    "slides": arm(
        first='<joint name="ja" type="slide" axis="1 1 0"/>', second='<joint type="slide" axis="0 0 1"/>'
    ),
    "opposite axes": arm(first='<joint axis="0 -1 0"/>', second='<joint type="slide" axis="-1 0 0"/>'),
    "anchors": arm(first=f'<joint pos="{LOCAL["pos"]}" axis="{LOCAL["axis"]}"/>'),
    "reference positions": arm(
        first=f'<joint ref="0.7" pos="{LOCAL["pos"]}" axis="{LOCAL["axis"]}"/>',
        second='<joint type="slide" ref="0.3" axis="0 1 1"/>',
    ),
    "several joints on a body": arm(
        first='<joint type="slide" axis="1 0 0"/><joint axis="0 1 0" pos="0 0 0.1" ref="0.2"/>'
        '<joint type="ball" pos="0.1 0 0"/>',
        second="",
    ),
    "welded bodies": arm(
        second="",
        more='<body pos="0.1 0.2 0" euler="0.3 0 1"><geom size="0.04"/><joint axis="0 0 1"/></body>',
    ),
    "frame": arm(more='<frame pos="0 0 0.1" euler="0.3 0 0"><geom type="box" size="0.03 0.05 0.1"/></frame>'),
    "replicate": arm(more='<replicate count="3" offset="0.1 0 0"><geom size="0.03"/></replicate>'),
    "mesh": arm(options=MESH, more='<geom type="mesh" mesh="m"/>'),
    "bounds of inertias": arm(compiler='boundmass="1" boundinertia="0.05"'),
    "total mass": arm(compiler='settotalmass="20"'),
    "balanced inertia": arm(
        compiler='balanceinertia="true"',
        more='<body><inertial pos="0 0 0.1" mass="1" diaginertia="0.1 0.1 0.5"/></body>',
    ),
    "full inertia": arm(
        more='<body><inertial pos="0 0 0.1" mass="1" fullinertia="0.3 0.2 0.4 0.01 0.02 0.03"/></body>'
    ),
    "gravity": arm(options='<option gravity="0 0 -1.62"/>'),
    "no gravity": arm(options='<option gravity="0 0 0"/>'),
    "gravity off": arm(options='<option><flag gravity="disable"/></option>'),
    "armature": arm(
        first='<joint name="ja" axis="0 1 0" armature="0.3"/>',
        after='<actuator><motor joint="ja" gear="3" armature="0.02"/></actuator>',
    ),
    "defaults": arm(options='<default><joint axis="0 0 1" armature="0.1"/></default>', first="<joint/>"),
    "scenery": arm(scene='<geom type="plane" size="1 1 1"/><body pos="1 0 0"><geom size="0.3"/></body>'),
}


def written(folder: Path, text: str, name: str = "robot.xml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("feature", FEATURES)
def test_model_has_the_poses_and_dynamics_of_mujoco(feature: str, tmp_path: Path):
    path = written(tmp_path, FEATURES[feature])
    compiled = compile_mjcf(path)
    found = differences(compiled, mjcf_model(compiled))
    assert set(found) == {"gravity", "mass", "inverse dynamics", "positions", "rotations", "centre of mass"}
    assert max(found.values()) < ROUNDING, found


def test_included_files_are_the_robot(tmp_path: Path):
    written(tmp_path, QUADRUPED, "quad.xml")
    robot = Robot.from_mjcf(written(tmp_path, SCENE), contacts=FEET)
    assert robot.name == "scene"
    assert list(robot.model.inertias) == list(Robot.from_mjcf(tmp_path / "quad.xml").model.inertias)


def test_a_body_of_a_fixed_file_moves_with_the_base_asked_for(tmp_path: Path):
    scene = '<body name="table" pos="1 0 0"><geom size="0.3"/></body>'
    path = written(tmp_path, arm(scene=scene, second=""))
    for base, rows in (("freeflyer", 6), ("virtual", 6), ("planar", 3)):
        robot = Robot.from_mjcf(path, base=base)
        assert (robot.base, robot.nv, robot.nu) == (base, rows + 1, 1)
        moved = {
            name: robot.model.frames[robot.model.getFrameId(name)].parentJoint for name in ("a", "table")
        }
        assert moved == {"a": robot.model.njoints - 1, "table": 0}


def test_names_are_unique_and_a_body_keeps_its_own(tmp_path: Path):
    text = QUADRUPED.replace('<site name="FL_site"', '<site name="FL_calf"').replace('name="FR_foot"', "")
    model = Robot.from_mjcf(written(tmp_path, text)).model
    names = [frame.name for frame in model.frames]
    assert len(set(names)) == len(names)
    assert {"FL_calf_site", "FR_calf_ball", "FL_foot", "root"} <= set(names)
    assert model.frames[model.getFrameId("FL_calf")].type == pin.FrameType.BODY
    unnamed = arm(first="<joint/>", second="<joint/><joint axis='0 1 0'/>").replace('name="b"', "")
    compiled = compile_mjcf(written(tmp_path, unnamed))
    assert joint_names(compiled) == ["a_joint", "body2_joint", "body2_joint_2"]


def test_locking_joints_with_the_names_of_their_bodies_keeps_all_frames(tmp_path: Path):
    robot = Robot.from_mjcf(written(tmp_path, QUADRUPED), contacts=FEET)
    locked = robot.with_locked(["FL_hip", "RR_calf"]).with_locked(["FL_thigh"])
    assert (locked.nu, locked.mass) == (9, pytest.approx(robot.mass, rel=1e-12))
    places = []
    for each in (robot, locked):
        data = each.model.createData()
        pin.framesForwardKinematics(each.model, data, each.reference)
        places.append(
            [data.oMf[each.model.getFrameId(frame.name)].homogeneous for frame in robot.model.frames]
        )
    np.testing.assert_allclose(*places, atol=ROUNDING)


def test_free_bodies_besides_the_robot_are_refused_by_name(tmp_path: Path):
    scene = "".join(f'<body name="{n}"><freejoint/><geom size="0.1"/></body>' for n in ("box", "cup"))
    with pytest.raises(InputError, match="free bodies besides 'box': 'cup'; one free joint"):
        Robot.from_mjcf(written(tmp_path, arm(scene=scene)))


def test_a_free_body_beside_a_fixed_robot_is_refused_with_the_joints_of_the_robot(tmp_path: Path):
    scene = '<body name="box"><freejoint/><geom size="0.1"/></body>'
    with pytest.raises(
        InputError, match=r"joints besides the free body 'box': .*; a file of the robot alone"
    ):
        Robot.from_mjcf(written(tmp_path, arm(scene=scene)))


def test_missing_mujoco_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(__import__("sys").modules, "mujoco", None)
    with pytest.raises(InputError, match=r"reading MJCF needs MuJoCo.*the extra 'mujoco'"):
        Robot.from_mjcf(written(tmp_path, arm()))


def test_limits_are_those_that_are_in_force(tmp_path: Path):
    hinge = '<joint name="{}" axis="0 1 0" range="-1 2" limited="{}" damping="0.3" frictionloss="0.2"/>'
    text = arm(first=hinge.format("ja", "true"), second=hinge.format("jb", "false"))
    robot = Robot.from_mjcf(written(tmp_path, text))
    np.testing.assert_array_equal(robot.position_lower, [-1, -np.inf])
    np.testing.assert_array_equal(robot.position_upper, [2, np.inf])
    assert np.isinf(robot.velocity_limit).all()
    np.testing.assert_array_equal(robot.model.damping, [0.3, 0.3])
    np.testing.assert_array_equal(robot.model.upperDryFrictionLimit, [0.2, 0.2])
    assert robot.torque_limit is None
    assert HINGES["first"] not in text
