"""The robot: descriptions read, limits normalised, postures placed, bad input refused in one line."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import trajopt
from tests.support.models import placement
from tests.support.refusals import refusals, refused, refused_calls
from trajopt import Contact, InputError, Robot
from trajopt.robot import robot_file
from trajopt.robot.data import VisualSource
from trajopt.robot.payload import Payload
from trajopt_library import robots

FEET = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
ROUNDING = 1e-12  # metres, after a few multiplications of numbers near one

HOPPER = """<mujoco model="hopper"><compiler angle="radian" autolimits="true"/><worldbody>
<body name="trunk" pos="0 0 0.4">{root}<inertial pos="0 0 0" mass="5" diaginertia="0.1 0.1 0.1"/>
<body name="thigh" pos="0.1 0 0"><joint name="hip" axis="0 1 0" range="-1 1"/>
<inertial pos="0 0 -0.1" mass="0.5" diaginertia="0.01 0.01 0.01"/><site name="foot" pos="0 0 -0.2"/>
</body></body></worldbody></mujoco>"""


def solo_urdf() -> Path:
    return robot_file("solo_description/robots/solo12.urdf")


def frame_positions(robot: Robot, frames: tuple[str, ...], q: np.ndarray) -> np.ndarray:
    return np.array([placement(robot.model, q, frame).translation for frame in frames])


@pytest.mark.parametrize("name", robots.names())
def test_every_registered_robot_builds_under_its_name(name):
    robot = robots.load(name)
    assert robot.name == name
    assert robot.nu - len(robot.thrusters) + robot.n_unactuated == robot.nv
    assert robot.length > 0.1


def test_solo12_stands_on_balls_at_height_zero():
    robot = robots.load("solo12")
    heights = frame_positions(robot, FEET, robot.reference)[:, 2]
    np.testing.assert_allclose(heights, 0.016, atol=ROUNDING)
    assert robot.reference[2] == pytest.approx(robot.length + 0.016, abs=1e-3)
    assert robot.weight == pytest.approx(2.5 * 9.81, rel=1e-3)


def test_ur5_reference_is_far_from_singular():
    robot = robots.load("ur5")
    jacobian = pin.computeFrameJacobian(
        robot.model, robot.model.createData(), robot.reference, robot.model.getFrameId("tool0")
    )
    assert np.linalg.svd(jacobian)[1].min() > 0.1
    np.testing.assert_array_equal(robot.torque_limit, [150, 150, 150, 28, 28, 28])


def test_length_of_an_arm_is_its_reach():
    robot = robots.load("ur5")
    tips = [
        np.linalg.norm(frame_positions(robot, ("tool0",), pin.randomConfiguration(robot.model)))
        for _ in range(50)
    ]
    assert 0.8 < max(tips) < robot.length < 1.5


@pytest.mark.parametrize("base", ["freeflyer", "planar"])
def test_base_coordinates_have_no_limits(base):
    robot = Robot.from_urdf(solo_urdf(), base=base, contacts=FEET)
    assert np.isneginf(robot.position_lower[: robot.nq - 12]).all()
    assert np.isposinf(robot.position_upper[: robot.nq - 12]).all()
    np.testing.assert_array_equal(robot.position_upper[-12:], 10)
    assert np.isposinf(robot.velocity_limit[: robot.n_unactuated]).all()
    assert robot.torque_limit.shape == (12,)


def test_planar_base_moves_in_the_sagittal_plane():
    floating = Robot.from_urdf(solo_urdf(), contacts=FEET)
    planar = Robot.from_urdf(solo_urdf(), base="planar", contacts=FEET)
    pitch, joints = 0.3, np.linspace(-0.4, 0.5, 12)
    q_planar = np.concatenate([[0.2, 0.5, np.cos(pitch), np.sin(pitch)], joints])
    q_floating = np.concatenate([[0.2, 0, 0.5, 0, -np.sin(pitch / 2), 0, np.cos(pitch / 2)], joints])
    np.testing.assert_allclose(
        frame_positions(planar, FEET, q_planar), frame_positions(floating, FEET, q_floating), atol=ROUNDING
    )
    moving_planar = np.concatenate([[0.4, -0.3, 0.7], np.zeros(12)])
    moving_floating = np.concatenate([[0.4, 0, -0.3, 0, -0.7, 0], np.zeros(12)])
    energies = [
        pin.computeKineticEnergy(robot.model, robot.model.createData(), q, v)
        for robot, q, v in ((planar, q_planar, moving_planar), (floating, q_floating, moving_floating))
    ]
    assert energies[0] == pytest.approx(energies[1], rel=1e-12)
    assert min(frame_positions(planar, FEET, planar.reference)[:, 2]) == pytest.approx(0, abs=ROUNDING)


def test_planar_meshes_follow_the_turned_base():
    planar = Robot.from_urdf(solo_urdf(), base="planar")
    floating = Robot.from_urdf(solo_urdf())
    source = robots.load("solo12").visual
    placed = []
    for robot in (planar, floating):
        geometry = source.geometry(robot.model)
        data = geometry.createData()
        pin.updateGeometryPlacements(
            robot.model, robot.model.createData(), geometry, data, pin.neutral(robot.model)
        )
        placed.append(np.array([placement.homogeneous for placement in data.oMg]))
    np.testing.assert_allclose(placed[0], placed[1], atol=ROUNDING)


def test_continuous_joint_has_no_limits(tmp_path):
    urdf = tmp_path / "wheel.urdf"
    urdf.write_text(
        '<robot name="wheel"><link name="base"/><link name="rim"><inertial><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="axle" type="continuous"><parent link="base"/><child link="rim"/>'
        '<axis xyz="0 0 1"/></joint></robot>'
    )
    robot = Robot.from_urdf(urdf, base="fixed", reference={"axle": 1.0})
    assert np.isneginf(robot.position_lower).all()
    assert np.isposinf(robot.position_upper).all()
    assert robot.torque_limit is None
    np.testing.assert_allclose(robot.reference, [np.cos(1.0), np.sin(1.0)])


def test_locked_joints_leave_the_other_limits_and_the_mass():
    robot = robots.load("solo12")
    legs = replace(robot, torque_limit=np.arange(12.0))
    front = legs.with_locked(["HL_HAA", "HL_HFE", "HL_KFE", "HR_HAA", "HR_HFE", "HR_KFE"])
    assert (front.nq, front.nv, front.nu) == (13, 12, 6)
    np.testing.assert_array_equal(front.torque_limit, np.arange(6.0))
    assert front.mass == pytest.approx(robot.mass, rel=1e-12)
    np.testing.assert_allclose(
        frame_positions(front, FEET, front.reference),
        frame_positions(robot, FEET, robot.reference),
        atol=ROUNDING,
    )


def test_mjcf_free_joint_makes_a_floating_base(tmp_path):
    path = tmp_path / "hopper.xml"
    path.write_text(HOPPER.format(root='<freejoint name="root"/>'))
    robot = Robot.from_mjcf(path, contacts=["foot"])
    assert (robot.base, robot.nu) == ("freeflyer", 1)
    assert np.isneginf(robot.position_lower[:7]).all()
    assert frame_positions(robot, ("foot",), robot.reference)[0, 2] == pytest.approx(0, abs=ROUNDING)
    with pytest.raises(InputError, match="root joint of its own"):
        Robot.from_mjcf(path, base="planar")


def test_mjcf_without_root_joint_takes_the_base_asked_for(tmp_path):
    path = tmp_path / "hopper.xml"
    path.write_text(HOPPER.format(root=""))
    assert Robot.from_mjcf(path).base == "fixed"
    assert Robot.from_mjcf(path, base="freeflyer").nv == 7
    planar = Robot.from_mjcf(path, base="planar", contacts=["foot"])
    assert (planar.nv, planar.n_unactuated) == (4, 3)
    assert frame_positions(planar, ("foot",), planar.reference)[0, 2] == pytest.approx(0, abs=ROUNDING)


def test_visual_source_travels_as_a_relative_path():
    source = robots.load("solo12").visual
    meta = source.to_meta()
    assert not Path(meta["urdf"]).is_absolute()
    assert VisualSource.from_meta(meta) == source
    assert source.geometry(robots.load("solo12").model).ngeoms > 10


def test_meshes_of_a_package_beside_the_file_are_found(tmp_path):
    folder = tmp_path / "my_robot" / "urdf"
    (tmp_path / "my_robot" / "meshes").mkdir(parents=True)
    folder.mkdir()
    (tmp_path / "my_robot" / "meshes" / "part.stl").write_text(
        "solid part\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
        "endloop\nendfacet\nendsolid part\n"
    )
    urdf = folder / "robot.urdf"
    urdf.write_text(
        '<robot name="r"><link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" '
        'ixy="0" ixz="0" iyz="0"/></inertial><visual><geometry><mesh '
        'filename="package://my_robot/meshes/part.stl"/></geometry></visual></link></robot>'
    )
    robot = Robot.from_urdf(urdf)
    assert robot.visual.geometry(robot.model).ngeoms == 1
    assert Path(robot.visual.to_meta()["urdf"]) == urdf


def test_surface_contact_has_six_rows():
    assert Contact(frame="sole", kind="surface", half_length=0.1, half_width=0.05).dimension == 6
    assert Contact(frame="toe").dimension == 3


def test_arrays_of_a_robot_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        robots.load("ur5").reference[0] = 1.0


test_inconsistent_robot_is_refused = refusals(
    lambda change: replace(robots.load("ur5"), **change),
    ({"reference": np.zeros(3)}, "reference of robot 'ur5' has 3 numbers; allowed: 6"),
    ({"reference": np.array([0, 0, 4.0, 0, 0, 0])}, "outside its limits at joint 'elbow_joint'"),
    ({"reference": np.full(6, np.nan)}, "reference of Robot .* allowed: an array of finite numbers"),
    (
        {"contacts": (Contact(frame="tool0"), Contact(frame="ee_link", name="tool0"))},
        "two contacts named 'tool0'",
    ),
    ({"contacts": (Contact(frame="tool_0"),)}, "close matches: tool0"),
    ({"base": "freeflyer"}, "has a fixed root joint"),
    ({"base": "floating"}, "base of Robot .* is .floating.; allowed: freeflyer, virtual, planar, fixed"),
    (
        {"torque_limit": np.full(6, -1.0)},
        "torque_limit of joint 'shoulder_pan_joint' of 'ur5' is -1: negative or NaN",
    ),
    ({"velocity_limit": "fast"}, "velocity_limit of Robot 'ur5' is 'fast'; allowed: an array of numbers"),
    (
        {"position_lower": np.full(6, 9.0)},
        "position limits of joint 'shoulder_pan_joint' of 'ur5' are empty: 9 > 6.28319 rad",
    ),
)
test_bad_description_of_a_robot_is_refused = refusals(
    lambda options: Robot.from_urdf(solo_urdf(), **options),
    ({"contacts": ["FL_FOOOT"]}, "close matches: FL_FOOT"),
    ({"locked": ["FL_KNEE"]}, "joint 'FL_KNEE' to lock is unknown"),
    ({"reference": {"FL_KNEE": 1.0}}, "joint 'FL_KNEE' of the reference is unknown"),
    ({"reference": np.zeros(5)}, r"joints alone, \(12,\)"),
    ({"reference": np.zeros(19)}, "norm 1"),
    ({"base": "rail"}, "base of Robot.from_urdf is 'rail'; allowed: freeflyer"),
)


def test_missing_and_malformed_files_are_refused_in_one_line(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        Robot.from_urdf(tmp_path / "none.urdf")
    bad = tmp_path / "bad.xml"
    bad.write_text("no robot at all")
    for read in (Robot.from_urdf, Robot.from_mjcf):
        with refused("not a readable"):
            read(bad)


def test_urdf_that_is_no_xml_is_told_by_line_and_column_and_nothing_else_is_printed(tmp_path, capfd):
    bad = tmp_path / "bad.urdf"
    bad.write_text("<robot name='a'>\n<link>\n</robot>")
    with pytest.raises(InputError, match="line 3, column"):
        Robot.from_urdf(bad)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("size", [{}, {"half_length": 0.1}, {"half_length": -0.1, "half_width": 0.1}])
def test_surface_contact_without_a_sole_is_refused(size):
    with pytest.raises(InputError, match="positive lengths"):
        Contact(frame="sole", kind="surface", **size)


def test_contact_of_a_planar_robot_keeps_the_rows_of_its_plane():
    options = {"base": "planar", "contacts": ["FL_FOOT"]}
    abducting = Robot.from_urdf(robot_file("solo_description/robots/solo12.urdf"), **options)
    assert abducting.contact("FL_FOOT").rows == (0, 1, 2)  # its leg may leave the plane
    assert abducting.with_locked(["FL_HAA"]).contact("FL_FOOT").rows == (0, 2)
    sole = Contact(frame="sole", kind="surface", half_length=0.1, half_width=0.05)
    assert sole.within_plane(1).rows == (0, 2, 4)


test_unknown_robots_and_rows_beyond_a_contact_are_refused = refused_calls(
    (lambda: robots.load("solo13"), "solo12"),
    (lambda: Contact(frame="toe", rows=(3,)), r"contact 'toe' has rows \(3,\); some of \(0, 1, 2\)"),
)


def test_complaints_of_the_urdf_parser_are_the_reason_and_nothing_else_is_printed(tmp_path, capfd):
    file = tmp_path / "bad.urdf"
    joint = '<joint name="a" type="revolute"><parent link="b"/><child link="c"/></joint>'
    file.write_text(f'<robot name="x"><link name="b"/><link name="c"/>{joint}</robot>')
    with pytest.raises(InputError, match=r"readable URDF file: Joint \[a\] is of type REVOLUTE .* limits"):
        Robot.from_urdf(file)
    assert capfd.readouterr() == ("", "")


def test_joints_are_locked_where_frames_share_a_name():
    robot = robots.load("z1")
    frames = [frame.name for frame in robot.model.frames]
    assert len(set(frames)) < len(frames)
    locked = robot.with_locked([robot.model.names[3]])
    q, kept = robot.reference, np.delete(np.arange(robot.nv), 2)
    whole = pin.crba(robot.model, robot.model.createData(), q)
    reduced = pin.crba(locked.model, locked.model.createData(), locked.reference)
    np.testing.assert_allclose(np.triu(reduced), np.triu(whole[np.ix_(kept, kept)]), atol=1e-12)


def test_degrees_in_a_reference_are_said() -> None:
    with pytest.raises(InputError, match=r"at joint 'elbow_joint': .* if -90 is in degrees, -1.571 rad"):
        replace(trajopt.robot("ur5"), reference=[0.0, 0.0, -90.0, 0.0, 0.0, 0.0])
    free = replace(
        trajopt.robot("ur5"), position_lower=np.full(6, -np.inf), position_upper=np.full(6, np.inf)
    )
    with pytest.warns(UserWarning, match=r"joint 'elbow_joint'; if 45 is in degrees, 0.7854 rad"):
        replace(free, reference=np.array([0.0, 0.0, 45.0, 0.0, 0.0, 0.0]))


def test_a_number_that_is_not_finite_is_named_with_its_entry() -> None:
    robot = trajopt.robot("solo12")
    posture = robot.reference.copy()
    posture[9] = np.nan
    for given in (posture, posture.tolist()):
        with pytest.raises(InputError, match=r"^reference of Robot .* \(19,\) with nan at \[9\]; allowed: "):
            replace(robot, reference=given)
    with pytest.raises(InputError, match=r"is an array of shape \(3, 3\) with inf at \[1, 2\]; allowed: "):
        Payload(contact="hand", mass=1.0, inertia=np.diag([0.0, np.inf], 1))


def test_an_unknown_robot_is_answered_with_the_nearest_name() -> None:
    with pytest.raises(InputError, match=r"robot 'go3' is unknown; did you mean go\d\? allowed: .*go2"):
        trajopt.robot("go3")
