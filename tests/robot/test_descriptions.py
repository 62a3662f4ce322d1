"""Robots from descriptions that need a remedy, from Denavit and Hartenberg's parameters, and from beams."""

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.refusals import refusals, refused, refused_calls
from trajopt import Robot
from trajopt.inspection.report import robot_report
from trajopt.inspection.starter import guessed, starter
from trajopt.robot import Beam, DhJoint, MimicJoint, frame_pose, robot_from_dh
from trajopt.robot.actuators.beams import DENSITY, assembled
from trajopt_library import robots

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
    with refused(r"'right_joint' mimics 'thumb'; lock them: locked=\['right_joint'\]"):
        Robot.from_urdf(path, base="fixed")


def test_a_xacro_file_is_refused_with_the_command_that_expands_it(tmp_path):
    path = gripper(tmp_path / "gripper.urdf.xacro")
    with refused(r"expand it: xacro gripper.urdf.xacro > gripper\.urdf$"):
        Robot.from_urdf(path)
    macro = gripper(tmp_path / "gripper.urdf")
    text = macro.read_text().replace('name="gripper">', 'name="gripper" xmlns:xacro="http://ros.org/xacro">')
    macro.write_text(text)  # a file that was expanded may keep the namespace
    assert Robot.from_urdf(macro, base="fixed", locked=["right_joint"]).nu == 1
    macro.write_text(text.replace("</robot>", '<xacro:leg name="a"/></robot>'))
    with refused(r"xacro gripper.urdf > gripper_expanded\.urdf$"):
        Robot.from_urdf(macro)


def test_reversed_limits_name_their_joint_and_unit(tmp_path):
    path = gripper(tmp_path / "gripper.urdf", more="", lower="0.1")
    with refused(r"of joint 'left_joint' of 'gripper' are empty: 0\.1 > 0\.04 m"):
        Robot.from_urdf(path, base="fixed")


@pytest.mark.parametrize(("least", "accepted"), [("-5e-17", True), ("-1e-9", False)])
def test_an_inertia_may_be_negative_by_the_rounding_of_the_robot(least: str, accepted: bool, tmp_path):
    body = BODY.replace('izz="1"', f'izz="{least}"').replace('ixx="1" iyy="1"', 'ixx="1e-12" iyy="1e-12"')
    path = gripper(tmp_path / "gripper.urdf", more="", body=body)
    if accepted:
        assert Robot.from_urdf(path).nu == 2
    else:
        with refused("least principal inertia of the body moved by joint"):
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
    with refused(f"value of <mass> of link 'left' is '{value}'; allowed: a finite"):
        Robot.from_urdf(path)
    path = gripper(path, f'<mimic joint="left_joint" multiplier="{value}"/>')
    with refused(f"multiplier of <mimic> of joint 'right_joint' is '{value}'"):
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
    assert_allclose(beam.spatial_inertia().matrix(), box.matrix(), rtol=0, atol=ROUNDING * mass)


def test_hollow_beam_agrees_with_quadrature_of_the_density():
    """Walls of ten and five cells lie on cell edges, so only the rule's own error is left."""
    beam = Beam(length=0.6, width=0.12, height=0.24, wall=0.02, density="aluminium")
    mass, inertia = quadrature(beam)
    assert beam.mass == pytest.approx(mass, rel=ROUNDING)
    assert_allclose(beam.inertia, inertia, rtol=QUADRATURE, atol=QUADRATURE * mass * 1e-3)


def test_hollow_beam_is_the_sum_of_its_four_plates():
    t = HOLLOW.wall
    sides = Beam(length=0.7, width=t, height=0.2)
    lids = Beam(length=0.7, width=0.16 - 2 * t, height=t)
    plates = [(sides, (0, s * (0.16 - t) / 2, 0)) for s in (-1, 1)]
    plates += [(lids, (0, 0, s * (0.2 - t) / 2)) for s in (-1, 1)]
    total = assembled([plate.spatial_inertia(pin.SE3(np.eye(3), np.array(at))) for plate, at in plates])
    assert_allclose(total.matrix(), HOLLOW.spatial_inertia().matrix(), rtol=0, atol=1e-12)


def test_wall_of_half_the_smaller_size_is_solid():
    solid, full = (Beam(length=1.0, width=0.1, height=0.2, wall=wall) for wall in (None, 0.05))
    assert full.mass == pytest.approx(solid.mass, rel=ROUNDING)
    assert_allclose(full.inertia, solid.inertia, rtol=ROUNDING)


@pytest.mark.parametrize("end", [(0.0, 0.0, 0.7), (0.0, 0.0, -0.7), (0.7, 0.0, 0.0), (0.3, -0.4, 0.5)])
def test_beam_between_points_has_its_centre_halfway_and_its_axis_along_the_line(end):
    start = np.array([0.1, 0.2, 0.3])
    placed = HOLLOW.between(start, start + np.array(end))
    along = np.array(end) / np.linalg.norm(end)
    assert_allclose(placed.lever, start + np.array(end) / 2, atol=ROUNDING)
    assert along @ placed.inertia @ along == pytest.approx(HOLLOW.inertia[0, 0], rel=1e-12)
    assert_allclose(np.linalg.eigvalsh(placed.inertia), np.sort(np.diag(HOLLOW.inertia)), rtol=1e-12)


def test_mass_is_that_of_the_material():
    for material, density in DENSITY.items():
        section = 0.16 * 0.2 - (0.16 - 0.012) * (0.2 - 0.012)
        beam = Beam(length=0.7, width=0.16, height=0.2, wall=0.006, density=material)
        assert beam.mass == pytest.approx(density * 0.7 * section, rel=1e-12)


test_beams_that_cannot_be_are_refused = refusals(
    lambda change: Beam(**{"length": 0.7, "width": 0.16, "height": 0.2, "wall": 0.006, **change}),
    ({"length": 0.0}, "length of Beam is 0"),
    ({"width": -1.0}, "width of Beam"),
    ({"height": float("nan")}, "height of Beam"),
    ({"wall": 0.09}, "at most 0.08 m"),
    ({"wall": 0.0}, "wall of Beam"),
    ({"density": "wood"}, "steel, aluminium, iron"),
    ({"density": -5.0}, "density of Beam"),
)
test_beam_between_equal_points_is_refused = refused_calls(
    (lambda: HOLLOW.between(np.ones(3), np.ones(3)), "two different points")
)
EXACT = 1e-12
# Parameters of data sheets are rounded to 1e-5 m, those of descriptions to more digits.
DATA_SHEET = 1e-4
RIGHT = math.pi / 2
LINK = {"mass": 1.0, "inertia": 0.01 * np.eye(3)}


def rot(axis: str, angle: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = pin.utils.rotate(axis, angle)
    return matrix


def trans(axis: str, way: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix["xyz".index(axis), 3] = way
    return matrix


def by_hand(joints: list[DhJoint], q: np.ndarray, convention: str) -> np.ndarray:
    pose = np.eye(4)
    for joint, value in zip(joints, q, strict=True):
        turns = joint.kind == "revolute"
        about = rot("z", joint.theta + value * turns) @ trans("z", joint.d + value * (not turns))
        along = trans("x", joint.a) @ rot("x", joint.alpha)
        pose = pose @ (about @ along if convention == "standard" else along @ about)
    return pose


@pytest.mark.parametrize("convention", ["standard", "modified"])
@pytest.mark.parametrize("seed", range(5))
def test_links_are_where_the_transforms_put_them(convention: Any, seed: int) -> None:
    random = np.random.default_rng(seed)
    joints = [
        DhJoint(a=a, alpha=alpha, d=d, theta=theta, kind="prismatic" if slides else "revolute", **LINK)
        for (a, alpha, d, theta), slides in zip(
            random.uniform(-2, 2, (6, 4)), random.random(6) < 0.5, strict=True
        )
    ]
    robot = robot_from_dh(joints, convention=convention)
    q = random.uniform(-1, 1, 6)
    for number in range(1, 7):
        expected = by_hand(joints[:number], q[:number], convention)
        assert_allclose(frame_pose(robot, q, f"link{number}").homogeneous, expected, atol=EXACT)


def test_the_ur5_of_its_data_sheet_is_that_of_its_urdf() -> None:
    rows = zip(
        (0.0, -0.425, -0.39225, 0.0, 0.0, 0.0),
        (RIGHT, 0.0, 0.0, RIGHT, -RIGHT, 0.0),
        (0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823),
        strict=True,
    )
    arm = robot_from_dh([DhJoint(a=a, alpha=alpha, d=d, **LINK) for a, alpha, d in rows], name="ur5")
    random, known = np.random.default_rng(0), robots.load("ur5")
    moves = []
    for q in random.uniform(-1.0, 1.0, (8, 6)):
        moves.append((frame_pose(arm, q, "link6"), frame_pose(known, q, "wrist_3_link")))
    # The frames differ by a constant at each end: angles and pitches of the screws between them are the same.
    for (first, its), (second, other) in itertools.pairwise(moves):
        screws = [pin.log6(first.actInv(second)).vector, pin.log6(its.actInv(other)).vector]
        angles = [np.linalg.norm(screw[3:]) for screw in screws]
        pitches = [screw[:3] @ screw[3:] for screw in screws]
        assert_allclose(angles[0], angles[1], atol=DATA_SHEET)
        assert_allclose(pitches[0], pitches[1], atol=DATA_SHEET)


def test_the_panda_of_its_data_sheet_is_that_of_its_urdf() -> None:
    rows = zip(
        (0.0, 0.0, 0.0, 0.0825, -0.0825, 0.0, 0.088),
        (0.0, -RIGHT, RIGHT, RIGHT, -RIGHT, RIGHT, RIGHT),
        (0.333, 0.0, 0.316, 0.0, 0.384, 0.0, 0.0),
        strict=True,
    )
    joints = [DhJoint(a=a, alpha=alpha, d=d, **LINK) for a, alpha, d in rows]
    arm, known = robot_from_dh(joints, convention="modified"), robots.load("panda")
    q = np.array([0.1, -0.4, 0.2, -1.5, 0.3, 1.2, -0.6])
    for number in range(1, 8):
        expected = frame_pose(known, np.append(q, np.zeros(known.nq - 7)), f"panda_link{number}")
        assert_allclose(frame_pose(arm, q, f"link{number}").homogeneous, expected.homogeneous, atol=EXACT)


def test_masses_are_in_the_frames_of_their_links() -> None:
    # A pendulum in a vertical plane: the base's axis is turned level by the first, fixed twist.
    length, mass, inertia = 0.8, 2.0, 0.03
    joint = DhJoint(
        a=length,
        alpha=0.0,
        mass=mass,
        centre=(-length / 2, 0.0, 0.0),
        inertia=inertia * np.eye(3),
        armature=0.1,
    )
    robot = robot_from_dh([joint], convention="standard")
    matrix = pin.crba(robot.model, robot.model.createData(), np.zeros(1))
    assert matrix[0, 0] == pytest.approx(inertia + mass * (length / 2) ** 2 + 0.1)


def test_limits_are_the_robots() -> None:
    turns = DhJoint(a=0.5, lower=-1.0, upper=2.0, velocity=3.0, torque=40.0, **LINK)
    slides = DhJoint(kind="prismatic", upper=0.3, **LINK)
    robot = robot_from_dh([turns, slides], name="scara", reference=[0.5, 0.1])
    assert robot.name == "scara"
    assert list(robot.model.names)[1:] == ["joint1", "joint2"]
    assert_allclose(robot.position_lower, [-1.0, -np.inf])
    assert_allclose(robot.position_upper, [2.0, 0.3])
    assert_allclose(robot.velocity_limit, [3.0, np.inf])
    assert robot.torque_limit is not None
    assert_allclose(robot.torque_limit, [40.0, np.inf])
    assert_allclose(robot.reference, [0.5, 0.1])


test_what_is_no_arm_is_one_line = refusals(
    lambda joints, options: robot_from_dh(joints, **options),
    ([], {}, "robot_from_dh has no joints"),
    ([DhJoint()], {}, "has no mass"),
    ([DhJoint(**LINK)], {"convention": "classic"}, "convention of robot_from_dh is 'classic'"),
    ([DhJoint(lower=1.0, upper=-1.0, **LINK)], {}, "position limits of joint 'joint1' of 'arm' are empty"),
    (
        [DhJoint(mass=1.0, inertia=-np.eye(3))],
        {},
        "inertia of joint 1 of robot_from_dh is not that of a rigid body",
    ),
    ([3], {}, r"joints\[0\] of robot_from_dh is 3; allowed: a DhJoint"),
)


def test_wrong_parameters_are_one_line() -> None:
    with refused(r"alpha of DhJoint is nan"):
        DhJoint(alpha=math.nan)
    with refused(r"centre of DhJoint"):
        DhJoint(centre=(1.0, 2.0))
    with refused(r"kind of DhJoint is 'ball'"):
        DhJoint(kind="ball")  # type: ignore[arg-type]


@pytest.mark.long
def test_an_arm_of_parameters_is_solved() -> None:
    rows = ((0.0, RIGHT, 0.3), (0.4, 0.0, 0.0), (0.35, 0.0, 0.0))
    limits = {"lower": -2.5, "upper": 2.5, "velocity": 3.0, "torque": 80.0}
    arm = robot_from_dh(
        [DhJoint(a=a, alpha=alpha, d=d, **LINK, **limits) for a, alpha, d in rows], reference=[0.0, 0.6, -1.0]
    )
    goal = {"x": 0.3, "y": 0.3, "z": 0.5}
    problem = trajopt.load("arm-reach", robot=arm, orientation="free", **goal)
    solution = trajopt.solve(problem)
    assert solution.success
    reached = frame_pose(arm, solution.q[-1], "link3").translation
    assert_allclose(reached, list(goal.values()), atol=1e-5)
