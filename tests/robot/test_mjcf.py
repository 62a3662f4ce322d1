"""MJCF: poses, masses and dynamics as MuJoCo compiles them; actuators, keyframes, constraints, shapes."""

import re
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.support.mjcf_files import FEET, HINGES, QUADRUPED, SCENE, arm
from tests.support.models import placement
from tests.support.mujoco_comparison import differences
from tests.support.refusals import refused
from trajopt import InputError, Robot
from trajopt.collision import robot_shapes
from trajopt.inspection.report import robot_report
from trajopt.inspection.starter import guessed, starter
from trajopt.robot.mjcf import compile_mjcf, joint_names, mjcf_model
from trajopt.robot.mjcf_actuators import actuation_of

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
    assert_allclose(*places, atol=ROUNDING)


def test_free_bodies_besides_the_robot_are_refused_by_name(tmp_path: Path):
    scene = "".join(f'<body name="{n}"><freejoint/><geom size="0.1"/></body>' for n in ("box", "cup"))
    with refused("free bodies besides 'box': 'cup'; one free joint"):
        Robot.from_mjcf(written(tmp_path, arm(scene=scene)))


def test_a_free_body_beside_a_fixed_robot_is_refused_with_the_joints_of_the_robot(tmp_path: Path):
    scene = '<body name="box"><freejoint/><geom size="0.1"/></body>'
    with refused(r"joints besides the free body 'box': .*; a file of the robot alone"):
        Robot.from_mjcf(written(tmp_path, arm(scene=scene)))


def test_missing_mujoco_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(__import__("sys").modules, "mujoco", None)
    with refused(r"reading MJCF needs MuJoCo.*the extra 'mujoco'"):
        Robot.from_mjcf(written(tmp_path, arm()))


def test_limits_are_those_that_are_in_force(tmp_path: Path):
    hinge = '<joint name="{}" axis="0 1 0" range="-1 2" limited="{}" damping="0.3" frictionloss="0.2"/>'
    text = arm(first=hinge.format("ja", "true"), second=hinge.format("jb", "false"))
    robot = Robot.from_mjcf(written(tmp_path, text))
    assert_array_equal(robot.position_lower, [-1, -np.inf])
    assert_array_equal(robot.position_upper, [2, np.inf])
    assert np.isinf(robot.velocity_limit).all()
    assert_array_equal(robot.model.damping, [0.3, 0.3])
    assert_array_equal(robot.model.upperDryFrictionLimit, [0.2, 0.2])
    assert robot.torque_limit is None
    assert HINGES["first"] not in text


TENDON = '<tendon><fixed name="t"><joint joint="ja" coef="1"/><joint joint="jb" coef="2"/></fixed>'
TENDON += '<spatial name="s"><site site="foot"/><site site="tip"/></spatial></tendon>'


@pytest.mark.parametrize(
    ("actuators", "limit"),
    [
        ('<motor joint="ja" gear="20" ctrllimited="true" ctrlrange="-1 1"/>', 20),
        ('<motor joint="ja" gear="-20" ctrllimited="true" ctrlrange="-1 0.5"/>', 10),
        ('<motor joint="ja" gear="20" forcerange="-3 3" ctrlrange="-1 1"/>', 20),
        ('<motor joint="ja" gear="20" forcerange="-3 3"/>', 60),
        ('<position joint="ja" kp="100" forcerange="-30 40" ctrlrange="-1 1"/>', 30),
        ('<position joint="ja" kp="100" ctrlrange="-1 1"/>', np.inf),
        ('<general joint="ja" gainprm="50" ctrlrange="-2 2"/>', 100),
        ('<motor joint="ja" ctrlrange="-2 2"/><motor jointinparent="ja" gear="3" ctrlrange="-1 1"/>', 5),
        ('<motor joint="ja"/>', np.inf),
        ('<motor joint="ja" ctrllimited="false" ctrlrange="-1 1"/>', np.inf),
    ],
)
def test_torque_limit_is_what_the_actuators_of_a_joint_can_do(actuators: str, limit: float, tmp_path: Path):
    path = written(tmp_path, arm(after=f"<actuator>{actuators}</actuator>"))
    found = actuation_of(compile_mjcf(path))
    assert_allclose(found.effort, [limit, np.inf])
    assert_array_equal(found.driven, [True, False])


def test_force_range_of_a_joint_clamps_its_actuators(tmp_path: Path):
    first = '<joint name="ja" axis="0 1 0" actuatorfrcrange="-7 9" actuatorfrclimited="true"/>'
    motors = [f'<motor joint="{j}" gear="{g}" ctrlrange="-1 1"/>' for j, g in (("ja", 20), ("jb", 4))]
    path = written(tmp_path, arm(first=first, after=f"<actuator>{''.join(motors)}</actuator>"))
    robot = Robot.from_mjcf(path)
    assert_array_equal(robot.torque_limit, [7, 4])
    assert robot.passive == ()


def test_joints_without_actuator_are_passive_if_others_have_one(tmp_path: Path):
    path = written(tmp_path, arm(after='<actuator><motor joint="jb"/></actuator>'))
    assert Robot.from_mjcf(path).passive == ("ja",)
    assert Robot.from_mjcf(path, passive=[]).nu == 2
    assert Robot.from_mjcf(path, locked=["ja"]).passive == ()
    assert Robot.from_mjcf(written(tmp_path, arm(), "plain.xml")).nu == 2


def test_keyframe_is_the_reference_and_stands_on_its_contacts(tmp_path: Path):
    path = written(tmp_path, QUADRUPED)
    bare = Robot.from_mjcf(path)
    assert_array_equal(bare.reference, [0, 0, 0.28, 0, 0, 0, 1, *[0, 0.8, -1.6] * 4])
    for base, joints in (("freeflyer", 7), ("virtual", 6)):
        robot = Robot.from_mjcf(path, base=base, contacts=FEET)
        assert_array_equal(robot.reference[joints:], bare.reference[7:])
        heights = [placement(robot.model, robot.reference, foot).translation[2] for foot in FEET]
        assert_allclose(heights, 0, atol=ROUNDING)
    named = Robot.from_mjcf(path, reference={"FL_calf": -1.0})
    assert_array_equal(named.reference[2:], [0.28, 0, 0, 0, 1, 0, 0.8, -1.0, *[0, 0.8, -1.6] * 3])


def test_keyframe_turns_quaternions_and_goes_before_others_if_it_is_called_home(tmp_path: Path):
    keys = '<keyframe><key qpos="0 0 0 1 0 0 0 0"/><key name="home" qpos="1 2 3 0.6 0 0.8 0 0.5"/></keyframe>'
    path = written(tmp_path, arm(first="<freejoint/>", after=keys))
    assert_allclose(Robot.from_mjcf(path).reference, [1, 2, 3, 0, 0.8, 0, 0.6, 0.5])
    first = written(tmp_path, arm(first="<freejoint/>", after=keys.replace("home", "other")), "first.xml")
    assert_allclose(Robot.from_mjcf(first).reference, [0, 0, 0, 0, 0, 0, 1, 0])


def test_keyframe_beyond_the_limits_leaves_neutral(tmp_path: Path):
    text = QUADRUPED.replace("0 0.8 -1.6", "0 0.8 -0.1")
    robot = Robot.from_mjcf(written(tmp_path, text))
    assert_allclose(robot.reference[7:], [0, 0, np.radians(-20)] * 4)


def test_without_a_keyframe_bodies_start_where_the_file_has_them(tmp_path: Path):
    placed, turned = 'pos="0.1 0 0.2" euler="0.2 0.1 0.3"', 'pos="1 2 3" quat="0.6 0 0.8 0"'
    text = arm(first="<freejoint/>", second='<joint axis="0 1 0" ref="0.7"/>').replace(placed, turned)
    assert_allclose(Robot.from_mjcf(written(tmp_path, text)).reference, [1, 2, 3, 0, 0.8, 0, 0.6, 0.7])
    path = written(tmp_path, QUADRUPED.split("<keyframe>")[0] + "</mujoco>")
    assert_allclose(Robot.from_mjcf(path).reference[:7], [0, 0, 0.45, 0, 0, 0, 1])
    standing = 0.2 + 0.2 * np.cos(np.radians(20))  # knees at their limits
    assert Robot.from_mjcf(path, contacts=FEET).reference[2] == pytest.approx(standing)


@pytest.mark.parametrize(
    ("axes", "told"),
    [
        (("1 0 0", "0 1 0", "0 0 1"), "j0 along x, j1 along y, j2 about z"),
        (("0 0 1", "0.6 0.8 0", "-0.8 0.6 0"), "j0 along z, j1 along (0.6, 0.8, 0), j2 about (-0.8, 0.6, 0)"),
        (("1 0 0", "0 1 0", "0 1 0"), ""),
    ],
)
def test_a_planar_root_of_the_file_is_told_and_gets_no_other_base(axes, told: str, tmp_path: Path):
    kinds = zip(axes, ("slide", "slide", "hinge"), strict=True)
    joints = (f'<joint name="j{i}" type="{kind}" axis="{axis}"/>' for i, (axis, kind) in enumerate(kinds))
    path = written(tmp_path, arm(first="".join(joints)).replace(' euler="0.2 0.1 0.3"', ""))
    notes = [note for note in robot_report(Robot.from_mjcf(path)).notes if "planar root" in note]
    if told:
        assert told in notes[0]
        with refused(re.escape(f"has a planar root ({told}) of its own, base='planar' contradicts it")):
            Robot.from_mjcf(path, base="planar")
    else:
        assert (notes, Robot.from_mjcf(path, base="planar").nv) == ([], 7)


@pytest.mark.parametrize(
    ("equality", "what", "needed"),
    [
        (
            '<joint name="e" joint1="jb" joint2="ja" polycoef="0 1 2 0 0"/>',
            "equality joint 'e' of jb, ja",
            ["jb", "ja"],
        ),
        ('<joint joint1="jb"/>', "equality joint of jb", ["jb"]),
        ('<connect body1="b" anchor="0 0 0"/>', "equality connect of ja, jb", ["ja", "jb"]),
        ('<weld body1="b" body2="a"/>', "equality weld of jb", ["jb"]),
        ('<weld site1="tip" site2="foot"/>', "equality weld of ja, jb", ["ja", "jb"]),
        ('<tendon tendon1="t"/>', "equality tendon of ja, jb", ["ja", "jb"]),
        ('<tendon name="e" tendon1="s"/>', "equality tendon 'e' of ja, jb", ["ja", "jb"]),
    ],
)
def test_joints_that_an_equality_couples_are_refused_unless_locked(equality, what, needed, tmp_path: Path):
    text = arm(scene='<site name="foot"/>', after=f"{TENDON}<equality>{equality}</equality>")
    path = written(tmp_path, text)
    with pytest.raises(InputError) as caught:
        Robot.from_mjcf(path)
    assert f"{what}; lock them: locked={needed}" in str(caught.value)
    if len(needed) == 1:
        assert Robot.from_mjcf(path, locked=needed).nu == 1
    inactive = written(tmp_path, text.replace("/></equality>", ' active="false"/></equality>'), "off.xml")
    assert Robot.from_mjcf(inactive).nu == 2


def test_a_weld_of_bodies_that_cannot_move_apart_is_no_coupling(tmp_path: Path):
    after = '<equality><weld body1="b" body2="c"/></equality>'
    path = written(tmp_path, arm(more='<body name="c"><geom size="0.1"/></body>', after=after))
    assert Robot.from_mjcf(path).nu == 2


def test_geoms_are_shapes_on_the_frames_of_their_bodies(tmp_path: Path):
    kinds = {"sphere": "0.1", "capsule": "0.1 0.2", "cylinder": "0.1 0.2", "ellipsoid": "0.1 0.2 0.3"}
    more = "".join(
        f'<geom name="{k}" type="{k}" size="{s}" pos="0 0.1 0.2" group="3"/>' for k, s in kinds.items()
    )
    more += '<geom name="mesh" type="mesh" mesh="m" contype="0" conaffinity="0" rgba="1 0 0 1"/>'
    mesh = '<asset><mesh name="m" vertex="0 0 0 0.1 0 0 0 0.1 0 0 0 0.2"/></asset>'
    plane = '<geom type="plane" size="1 1 1"/><body><geom name="table" size="0.1"/></body>'
    path = written(tmp_path, arm(options=mesh, more=more, scene=plane))
    for robot in (
        Robot.from_mjcf(path),
        Robot.from_mjcf(path, base="virtual"),
        Robot.from_mjcf(path, locked=["jb"]),
    ):
        touching = robot.visual.geometry(robot.model, pin.GeometryType.COLLISION)
        drawn = robot.visual.geometry(robot.model)
        assert [entry.name for entry in touching.geometryObjects] == ["a_0", "b_0", *kinds]
        assert [entry.name for entry in drawn.geometryObjects] == ["a_0", "b_0", "mesh"]
        data, placed = robot.model.createData(), touching.createData()
        q = pin.neutral(robot.model)
        pin.updateGeometryPlacements(robot.model, data, touching, placed, q)
        pin.framesForwardKinematics(robot.model, data, q)
        body = data.oMf[robot.model.getFrameId("b")]
        assert_allclose(placed.oMg[2].translation, body.act(np.array([0, 0.1, 0.2])), atol=ROUNDING)
    shapes = {entry.name: entry.geometry for entry in touching.geometryObjects}
    assert isinstance(shapes["ellipsoid"], coal.Ellipsoid)
    assert (shapes["capsule"].radius, shapes["capsule"].halfLength) == (0.1, 0.2)
    assert_allclose(shapes["b_0"].halfSide, [0.03, 0.05, 0.1])
    mesh = drawn.geometryObjects[2]
    assert_allclose(mesh.meshColor, [1, 0, 0, 1])
    corners = mesh.geometry.vertices() @ mesh.placement.rotation.T + mesh.placement.translation
    within = robot.model.frames[robot.model.getFrameId("b")].placement
    expected = [within.act(np.array(corner)) for corner in ([0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.2])]
    assert all(np.abs(corners - corner).max(axis=1).min() < 1e-6 for corner in expected)  # single precision


def test_excluded_pairs_are_not_judged(tmp_path: Path):
    exclude = '<contact><exclude body1="RL_calf" body2="FL_calf"/></contact>'
    robot = Robot.from_mjcf(written(tmp_path, QUADRUPED.replace("<actuator>", f"{exclude}<actuator>")))
    found = robot_shapes(robot)
    left_out = {pair for pair, reason in found.left_out.items() if reason == "excluded by the MJCF file"}
    assert left_out == {(f"FL_calf_{i}", f"RL_calf_{j}") for i in (0, 1) for j in (0, 1)}


def test_report_names_what_the_model_does_not_use(tmp_path: Path):
    spring = '<joint name="ja" axis="0 1 0" stiffness="3"/>'
    after = f'{TENDON}<actuator><motor joint="jb"/><motor name="pull" tendon="t"/></actuator>'
    foot = '<site name="foot"/>'
    text = arm(first=spring, scene=foot, after=after, options='<option density="1.2"/>').replace(
        'name="a"', 'name="a" gravcomp="1"'
    )
    notes = robot_report(Robot.from_mjcf(written(tmp_path, text))).notes
    for what in (
        "tendons: t, s",
        "actuators other than of hinges, slides and thrusters on the base: pull",
        "springs of joints: ja",
        "gravity compensation of bodies: a",
        "fluid forces: density",
    ):
        assert f"not part of the dynamics: {what}" in notes


@pytest.mark.parametrize("text", [QUADRUPED, QUADRUPED.split("<keyframe>")[0] + "</mujoco>"])
def test_a_first_file_builds_the_robot_that_was_guessed(text: str, tmp_path: Path):
    found = guessed(written(tmp_path, text))
    assert [(c.frame, c.radius) for c in found.contacts] == [(foot, 0.02) for foot in FEET]
    assert found.reference[9] < -0.5
    target = tmp_path / "mini.py"
    scope = {"__file__": str(target)}
    exec(starter(found, target), scope)
    assert_allclose(scope["build"]().reference, found.reference, atol=2e-3)


def test_a_first_file_locks_coupled_joints_at_the_keyframe(tmp_path: Path):
    after = '<equality><joint joint1="jb"/></equality><keyframe><key qpos="0.1 0.2"/></keyframe>'
    found, target = guessed(written(tmp_path, arm(after=after))), tmp_path / "mine.py"
    assert list(found.model.names)[1:] == ["ja"]
    assert "couplings of joints, which are locked: equality joint of jb" in robot_report(found).table()
    scope = {"__file__": str(target)}
    exec(starter(found, target), scope)
    assert_allclose(scope["build"]().model.inertias[1].lever, found.model.inertias[1].lever)


FLYING = """<mujoco><compiler angle="radian"/><worldbody><body name="hull">
<freejoint/><geom size="0.1 0.1 0.03" type="box"/>
<site name="s1" pos="0.1 0.1 0" euler="0.2 0 0"/>
<site name="s2" pos="-0.1 0.1 0"/><site name="s3" pos="0 -0.1 0"/>
<body pos="0 0 -0.05">
<joint name="swing" axis="0 1 0" stiffness="2" springref="0.3" damping="0.1" frictionloss="0.02"/>
<geom size="0.02" fromto="0 0 0 0 0 -0.2" type="capsule"/><site name="tip" pos="0 0 -0.2"/></body>
</body></worldbody>
<actuator><motor name="u1" site="s1" gear="0 0 2 0 0 0.04" ctrllimited="true" ctrlrange="0 5"/>
<motor name="u2" site="s2" gear="0 0 1 0 0 -0.02" ctrllimited="true" ctrlrange="1 5"/>
<motor name="both ways" site="s3" gear="0 0 1 0 0 0" ctrllimited="true" ctrlrange="-1 1"/>
<motor name="skew" site="s3" gear="0 0 1 0.1 0 0" ctrllimited="true" ctrlrange="0 1"/>
<motor name="on a link" site="tip" gear="0 0 1 0 0 0" ctrllimited="true" ctrlrange="0 1"/>
</actuator></mujoco>"""


@pytest.fixture
def flying(tmp_path: Path) -> Path:
    path = tmp_path / "flying.xml"
    path.write_text(FLYING, encoding="utf-8")
    return path


def test_motors_at_sites_of_the_base_are_thrusters(flying: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    robot = Robot.from_mjcf(flying)
    assert [thruster.name for thruster in robot.thrusters] == ["u1", "u2"]
    assert robot.passive == ("swing",)
    assert "thrusters on the base: both ways, skew, on a link" in robot_report(robot).table()
    assert [(t.least, t.most) for t in robot.thrusters] == [(0.0, 10.0), (1.0, 5.0)]
    model = mujoco.MjModel.from_xml_path(str(flying))
    data = mujoco.MjData(model)
    random = np.random.default_rng(0)
    q = pin.randomConfiguration(robot.model, -np.ones(8), np.ones(8))
    data.qpos[:] = np.concatenate([q[:3], q[[6, 3, 4, 5]], q[7:]])
    control = random.uniform(1.0, 5.0, 2)
    data.ctrl[:2] = control
    mujoco.mj_forward(model, data)
    force = robot.actuation.force(np.append(np.zeros(robot.nu - 2), control * [2.0, 1.0]))
    rotation = pin.Quaternion(*q[[6, 3, 4, 5]]).toRotationMatrix()
    assert_allclose(data.qfrc_actuator[:3], rotation @ force[:3], atol=1e-9)
    assert_allclose(data.qfrc_actuator[3:], force[3:], atol=1e-9)


def test_springs_damping_and_dry_friction_of_a_file_count_where_they_are_asked_for(flying: Path) -> None:
    robot = Robot.from_mjcf(flying)
    assert robot.joint_forces == ()
    (force,) = robot.with_joint_forces().joint_forces
    assert (force.joint, force.stiffness, force.rest) == ("swing", 2.0, 0.3)
    assert (force.damping, force.dry_friction) == (0.1, 0.02)
