"""Descriptions that need a remedy, and inertias of beams from their geometry."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from trajopt.errors import InputError
from trajopt.inspection.report import robot_report
from trajopt.inspection.starter import guessed, starter
from trajopt.robot.actuators.beams import DENSITY, Beam, assembled
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


# Sums of a few products of doubles.
ROUNDING = 1e-13
# Midpoint rule with 60 cells an edge on a quadratic: relative error 1 / 60^2 of each moment at most.
QUADRATURE = 3e-4
CELLS = 60
HOLLOW = Beam(length=0.7, width=0.16, height=0.2, wall=0.006)


def quadrature(beam: Beam) -> tuple[float, np.ndarray]:
    """Mass and inertia tensor by the lecture's integrals of the density, cell by cell."""
    sizes = np.array([beam.length, beam.width, beam.height])
    edges = [np.linspace(-size / 2, size / 2, CELLS + 1) for size in sizes]
    axes = [(edge[1:] + edge[:-1]) / 2 for edge in edges]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    inner = np.array(beam.hole) / 2
    full = (np.abs(y) > inner[0]) | (np.abs(z) > inner[1])
    cell = beam.kilograms_per_cubic_metre * np.prod(sizes) / CELLS**3 * full
    r = np.stack([x, y, z])
    second = np.einsum("iabc,jabc,abc->ij", r, r, cell)
    return float(cell.sum()), np.trace(second) * np.eye(3) - second


def test_solid_beam_is_the_uniform_box_of_pinocchio():
    beam = Beam(length=0.3, width=0.1, height=0.2, density=2500.0)
    mass = 2500.0 * 0.3 * 0.1 * 0.2
    box = pin.Inertia.FromBox(mass, 0.3, 0.1, 0.2)
    assert beam.mass == pytest.approx(mass, rel=ROUNDING)
    np.testing.assert_allclose(beam.spatial_inertia().matrix(), box.matrix(), rtol=0, atol=ROUNDING * mass)


def test_hollow_beam_agrees_with_quadrature_of_the_density():
    """Walls of ten and five cells lie on cell edges, so only the rule's own error is left."""
    beam = Beam(length=0.6, width=0.12, height=0.24, wall=0.02, density="aluminium")
    mass, inertia = quadrature(beam)
    assert beam.mass == pytest.approx(mass, rel=ROUNDING)
    np.testing.assert_allclose(beam.inertia, inertia, rtol=QUADRATURE, atol=QUADRATURE * mass * 1e-3)


def test_hollow_beam_is_the_sum_of_its_four_plates():
    t = HOLLOW.wall
    sides = Beam(length=0.7, width=t, height=0.2)
    lids = Beam(length=0.7, width=0.16 - 2 * t, height=t)
    plates = [(sides, (0, s * (0.16 - t) / 2, 0)) for s in (-1, 1)]
    plates += [(lids, (0, 0, s * (0.2 - t) / 2)) for s in (-1, 1)]
    total = assembled([plate.spatial_inertia(pin.SE3(np.eye(3), np.array(at))) for plate, at in plates])
    np.testing.assert_allclose(total.matrix(), HOLLOW.spatial_inertia().matrix(), rtol=0, atol=1e-12)


def test_wall_of_half_the_smaller_size_is_solid():
    solid, full = (Beam(length=1.0, width=0.1, height=0.2, wall=wall) for wall in (None, 0.05))
    assert full.mass == pytest.approx(solid.mass, rel=ROUNDING)
    np.testing.assert_allclose(full.inertia, solid.inertia, rtol=ROUNDING)


@pytest.mark.parametrize("end", [(0.0, 0.0, 0.7), (0.0, 0.0, -0.7), (0.7, 0.0, 0.0), (0.3, -0.4, 0.5)])
def test_beam_between_points_has_its_centre_halfway_and_its_axis_along_the_line(end):
    start = np.array([0.1, 0.2, 0.3])
    placed = HOLLOW.between(start, start + np.array(end))
    along = np.array(end) / np.linalg.norm(end)
    np.testing.assert_allclose(placed.lever, start + np.array(end) / 2, atol=ROUNDING)
    assert along @ placed.inertia @ along == pytest.approx(HOLLOW.inertia[0, 0], rel=1e-12)
    np.testing.assert_allclose(
        np.linalg.eigvalsh(placed.inertia), np.sort(np.diag(HOLLOW.inertia)), rtol=1e-12
    )


def test_mass_is_that_of_the_material():
    for material, density in DENSITY.items():
        section = 0.16 * 0.2 - (0.16 - 0.012) * (0.2 - 0.012)
        beam = Beam(length=0.7, width=0.16, height=0.2, wall=0.006, density=material)
        assert beam.mass == pytest.approx(density * 0.7 * section, rel=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"length": 0.0}, "length of Beam is 0"),
        ({"width": -1.0}, "width of Beam"),
        ({"height": float("nan")}, "height of Beam"),
        ({"wall": 0.09}, "at most 0.08 m"),
        ({"wall": 0.0}, "wall of Beam"),
        ({"density": "wood"}, "steel, aluminium, iron"),
        ({"density": -5.0}, "density of Beam"),
    ],
)
def test_beams_that_cannot_be_are_refused(change, message):
    sizes = {"length": 0.7, "width": 0.16, "height": 0.2, "wall": 0.006}
    with pytest.raises(InputError, match=message):
        Beam(**{**sizes, **change})


def test_beam_between_equal_points_is_refused():
    with pytest.raises(InputError, match="two different points"):
        HOLLOW.between(np.ones(3), np.ones(3))
