"""`trajopt robot`: what standing takes, what looks wrong, and first files of legs, arms, hands and wheels."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import trajopt
from tests.support.command_lines import invoke
from tests.support.models import placement
from tests.support.repository import ROOT
from trajopt import Contact, Robot
from trajopt.inspection.faults import depths_below
from trajopt.inspection.limbs import Limbs, find_limbs
from trajopt.inspection.report import robot_report
from trajopt.inspection.standing import inside, standing_feet, standing_posture
from trajopt.inspection.starter import guessed, starter
from trajopt.problem.problem import rest
from trajopt.robot import read_urdf, robot_file
from trajopt.robot.legs import wheel_rows
from trajopt_library import robots

URDF = ROOT / "docs" / "tutorial" / "puppy" / "urdf" / "puppy.urdf"
LEGS = ("lf", "rf", "lh", "rh")
BALL = 0.015  # radius of its feet, m
BENT = {f"{leg}_{joint}": angle for leg in LEGS for joint, angle in (("pitch", 0.7), ("knee", -1.4))}
# Virtual work by central differences of 1e-6: the truncation is 1e-12 of the work, rounding 1e-10.
STEP, WORK = 1e-6, 1e-7
# Least squares with equations weighted by 1e4 leave their residual's square of that.
BALANCE = 1e-6


def puppy(urdf: Path = URDF, feet: str = "foot", radius: float = BALL, **angles: float) -> Robot:
    return Robot.from_urdf(
        urdf,
        contacts=[Contact(frame=f"{leg}_{feet}", radius=radius) for leg in LEGS],
        reference=BENT | angles,
        package_dirs=[URDF.parents[2]],
    )


def changed(folder: Path, pattern: str, replacement: str) -> Robot:
    """Puppy of a URDF with the text of a pattern replaced, which must be there."""
    text, count = re.subn(pattern, replacement, URDF.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert count
    path = folder / "changed.urdf"
    path.write_text(text, encoding="utf-8")
    return puppy(path)


@pytest.mark.parametrize("name", ["puppy", "go2", "hyq"])
def test_forces_and_torques_at_rest_do_no_virtual_work(name: str) -> None:
    """dU = f dx + tau dq for any displacement, U and the feet's x by finite differences."""
    robot = puppy() if name == "puppy" else robots.load(name)
    found, model = standing_posture(robot), robot.model
    generator = np.random.default_rng(0)
    force = {}
    for foot, load in zip(found.feet, found.load, strict=True):
        force[robot.contact(foot).frame] = load

    def potential(q: np.ndarray) -> float:
        return float(pin.computePotentialEnergy(model, model.createData(), q))

    def height(q: np.ndarray, frame: str) -> float:
        return float(placement(model, q, frame).translation[2])

    for _ in range(10):
        step = STEP * generator.normal(size=model.nv)
        step[[0, 1, 5]] = 0.0  # level forces are small: only the vertical ones are reported
        ends = [pin.integrate(model, robot.reference, sign * step) for sign in (-1, 1)]
        work = potential(ends[1]) - potential(ends[0]) - 2 * found.effort @ step[robot.n_unactuated :]
        work -= sum(load * (height(ends[1], frame) - height(ends[0], frame)) for frame, load in force.items())
        assert abs(work) / (2 * STEP) < WORK * robot.weight * 1e2 * robot.length
    assert found.load.sum() == pytest.approx(robot.weight, rel=BALANCE)


def test_loads_of_feet_have_the_centre_of_mass_as_their_middle() -> None:
    robot = robots.load("go2")
    found = standing_posture(robot)
    places = np.array([c.position for c in robot_report(robot).contacts if c.name in found.feet])
    middle = found.load @ places[:, :2] / found.load.sum()
    assert middle == pytest.approx(found.centre, abs=1e-6)


def test_a_posture_whose_centre_is_not_over_the_feet_falls_over() -> None:
    robot = puppy(**{f"{leg}_pitch": 1.6 for leg in LEGS})
    found = standing_posture(robot)
    assert not found.balanced
    assert found.margin is not None
    assert found.margin < 0
    assert any("falls over" in text for text in robot_report(robot).warnings)


@pytest.mark.parametrize("lean", [0.0, 0.1, 0.35])
def test_a_robot_on_soles_stands_while_its_centre_is_over_them(lean: float) -> None:
    robot = robots.load("talos")
    q = robot.reference.copy()
    base = pin.XYZQUATToSE3(q[:7])
    q[:7] = pin.SE3ToXYZQUAT(pin.SE3(pin.utils.rotate("y", lean), np.zeros(3)) * base)
    for side in ("left", "right"):  # soles stay level
        q[robot.model.joints[robot.model.getJointId(f"leg_{side}_5_joint")].idx_q] -= lean
    found = standing_posture(replace(robot, reference=q))
    assert found.margin is not None
    assert found.balanced == (found.margin > 0) == (lean < 0.2)


@pytest.mark.parametrize(
    ("place", "margin"), [((0.0, 0.0), 1.0), ((0.5, 0.0), 0.5), ((1.5, 0.2), -0.5), ((1.0, 1.0), 0.0)]
)
def test_distance_to_the_border_of_a_square(place: tuple[float, float], margin: float) -> None:
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [0, 0]], dtype=float)
    assert inside(square, np.array(place)) == pytest.approx(margin, abs=1e-12)


def test_points_on_a_line_have_no_polygon() -> None:
    assert inside(np.array([[0.0, 0], [1, 0], [2, 0]]), np.zeros(2)) is None
    assert inside(np.zeros((2, 2)), np.zeros(2)) is None


def test_hands_do_not_stand() -> None:
    assert [contact.name for contact in standing_feet(robots.load("talos"))] == ["left", "right"]
    assert standing_feet(robots.load("ur5")) == ()


def test_shapes_of_feet_reach_a_ball_below_their_centres() -> None:
    for radius in (0.0, 0.01, BALL):
        robot = puppy(radius=radius)
        depths = depths_below(robot, standing_posture(robot))
        assert depths == pytest.approx({f"{leg}_foot": BALL - radius for leg in LEGS}, abs=1e-9)


def test_a_radius_that_is_not_the_foots_is_a_warning_with_the_right_one() -> None:
    (warning,) = robot_report(puppy(radius=0.0)).warnings
    assert "15.0 mm into the ground under lf_foot" in warning
    assert "Contact(radius=0.015)" in warning
    report = robot_report(puppy())
    assert report.warnings == ()
    assert [contact.radius for contact in report.contacts] == [BALL] * 4
    assert "15 mm" in report.table()


SHANK = r'(<link name="lf_shank">.*?<inertia) ixx="[^"]*"(.*?)iyy="[^"]*"(.*?)izz="[^"]*"'


@pytest.mark.parametrize(
    ("pattern", "replacement", "warning"),
    [
        (r"<inertial>.*?</inertial>", "", "robot 'puppy' has no mass"),
        (r'effort="9"', 'effort="0"', "torque limit 0"),
        (r'effort="9"', 'effort="1e30"', "no torque limit: all joints"),
        (r'effort="9"', 'effort="1000"', "a placeholder"),
        (r'effort="9"', 'effort="0.9"', "takes 1.25 at joint 'lh_knee', beyond its torque limit 0.9"),
        (r'velocity="22"', 'velocity="0"', "velocity limit 0"),
        (r'velocity="22"', 'velocity="1e30"', "no velocity limit: all joints"),
        (SHANK, r'\1 ixx="1"\2 iyy="1"\3 izz="1"', "bodies larger than the robot are moved by lf_knee"),
        (SHANK, r'\1 ixx="1e-3"\2 iyy="1e-5"\3 izz="1e-5"', "I1 \\+ I2 < I3"),
        (r'upper="-0.2"', 'upper="-1.4"', "at a position limit of lf_knee"),
        (r'(joint name="lf_pitch".*?axis xyz=)"0 1 0"', r'\1"1 0 0"', "left and right differ"),
        (r'(joint name="lf_ankle".*?xyz=)"0 0 -0.14"', r'\1"0 0 -0.13"', "feet are not at one height"),
    ],
)
def test_a_fault_is_warned_of(pattern: str, replacement: str, warning: str, tmp_path: Path) -> None:
    try:
        found = robot_report(changed(tmp_path, pattern, replacement)).warnings
    except trajopt.InputError as error:
        found = (str(error),)
    assert any(re.search(warning, text) for text in found), found


def test_straight_knees_and_wrong_frames_are_warned_of() -> None:
    straight = puppy(**{f"{leg}_knee": -0.2 for leg in LEGS}, **{f"{leg}_pitch": 0.1 for leg in LEGS})
    assert any("position limit" in text for text in robot_report(straight).warnings)
    shanks = robot_report(puppy(feet="shank")).warnings
    assert any("are they the feet's" in text for text in shanks)
    assert any("cannot move lf_shank" in text for text in shanks)


@pytest.mark.long
def test_puppy_and_most_robots_of_the_library_are_without_warnings() -> None:
    known = {"solo12": "placeholder"}
    for name in ("bolt", "go2", "hopper", "panda", "solo12", "ur5"):
        found = robot_report(robots.load(name)).warnings
        assert len(found) == (name in known), (name, found)
        assert all(known[name] in text for text in found)
    assert robot_report(puppy()).warnings == ()


def test_a_straight_arm_is_warned_of() -> None:
    source = robots.load("ur5").visual
    assert source is not None
    assert "singular" in robot_report(Robot.from_urdf(source.urdf, base="fixed")).warnings[0]


def test_a_first_file_builds_the_robot_that_was_guessed(tmp_path: Path) -> None:
    found = guessed(URDF)
    assert found.base == "freeflyer"
    assert {contact.frame for contact in found.contacts} == {f"{leg}_foot" for leg in LEGS}
    assert {contact.radius for contact in found.contacts} == {BALL}
    assert standing_posture(found).balanced
    path = tmp_path / "mine.py"
    path.write_text(starter(found, path), encoding="utf-8")
    built = robots.load(str(path))
    assert built.reference == pytest.approx(found.reference, abs=1e-3)
    assert robots.kind(str(path)) == "quadruped"
    assert robot_report(built).warnings == ()


def test_feet_of_a_root_on_the_ground_are_all_found(tmp_path: Path) -> None:
    # Some descriptions have a root below the robot; one leg of this one is a millimetre longer.
    text = URDF.read_text(encoding="utf-8")
    under = '<link name="base_footprint"/><joint name="up" type="fixed"><parent link="base_footprint"/>'
    under += '<child link="trunk"/><origin xyz="0 0 0.28"/></joint></robot>'
    start = text.index('<child link="lf_foot"/>')
    found = re.search(r'<origin xyz="(\S+) (\S+) (\S+)"', text[text.rindex("<joint", 0, start) :])
    assert found is not None
    at = text.rindex("<joint", 0, start) + found.start(3)
    text = text[:at] + str(float(found[3]) - 1e-3) + text[at + len(found[3]) :]
    path = tmp_path / "footprint.urdf"
    path.write_text(text.replace("</robot>", under), encoding="utf-8")
    assert {c.frame for c in guessed(path).contacts} == {f"{leg}_foot" for leg in LEGS}


def test_a_chain_is_guessed_to_be_bolted_down(tmp_path: Path) -> None:
    source = robots.load("ur5").visual
    assert source is not None
    found = guessed(source.urdf)
    assert (found.base, found.contacts) == ("fixed", ())
    path = tmp_path / "arm.py"
    path.write_text(starter(found, path), encoding="utf-8")
    assert (robots.kind(str(path)), robots.tool_frame(str(path))) == ("arm", robots.tool_frame("ur5"))


@pytest.mark.parametrize("name", ["puppy", "ur5", "hopper"])
def test_a_robot_at_rest_stays_where_it_is(name: str) -> None:
    robot = puppy() if name == "puppy" else robots.load(name)
    solution = trajopt.solve(rest(robot), fixed_mesh=True)
    assert solution.converged
    assert np.abs(solution.v).max() < 1e-3
    if robot.base != "fixed":
        assert solution.f[:, :, 2].sum(axis=1) == pytest.approx(robot.weight, rel=1e-3)


def run(*words: str) -> tuple[int, str]:
    done = invoke(*words)
    return done.exit_code, done.output


def test_command_prints_names_files_and_json(tmp_path: Path) -> None:
    assert run("robot", "ur5")[1].startswith("ur5: fixed base, 16.99 kg")
    status, text = run("robot", str(URDF), "--write", str(tmp_path / "mine.py"), "--json")
    assert status == 0
    told = json.loads(text[: text.rindex("}") + 1])
    assert (told["name"], told["nu"], len(told["joints"])) == ("puppy", 12, 12)
    assert run("robot", str(tmp_path / "mine.py"))[1].startswith("puppy: freeflyer base, 5.93 kg")


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("nobody",), "robot 'nobody' is unknown"),
        (("nobody.urdf",), "does not exist"),
        (("nobody.py",), "does not exist"),
        (("ur5", "--write", "mine.py"), "--write needs a .urdf or .xml file, and ur5 is not one; allowed: "),
        ((str(URDF), "--base", "wheels"), "base of Robot.from_urdf is 'wheels'; allowed: freeflyer"),
        ((str(URDF), "--write", "mine.txt"), "a .py file in an existing folder"),
        ((str(URDF), "--write", "/nowhere/mine.py"), "a .py file in an existing folder"),
        ((str(URDF), "--write", __file__), "exists and is not overwritten"),
    ],
)
def test_bad_input_is_one_line(words: tuple[str, ...], line: str) -> None:
    status, text = run("robot", *words)
    assert status == 2
    assert line in text
    assert len(text.strip().splitlines()) == 1


def test_a_description_in_place_of_a_robot_is_told_how_to_become_one() -> None:
    status, text = run("solve", "quadruped-jump-up", "--set", f"robot={URDF}")
    assert status == 2
    assert "--write FILE.py" in text
    assert len(text.strip().splitlines()) == 1


WHEELS = ("wheel_left_joint", "wheel_right_joint")
# File, base, velocities of the guess, contacts, wheels, joints without drive.
GUESSES = [
    ("tiago_description/robots/tiago.urdf", "fixed", 46, 0, 2, 0),
    ("tiago_description/robots/tiago_no_hand.urdf", "fixed", 10, 0, 2, 0),
    ("romeo_description/urdf/romeo.urdf", "freeflyer", 37, 2, 0, 24),
    ("centauro_description/urdf/centauro.urdf", "freeflyer", 45, 4, 4, 0),
    ("panda_description/urdf/panda.urdf", "fixed", 7, 0, 0, 0),
    ("ur_description/urdf/ur5_gripper.urdf", "fixed", 6, 0, 0, 0),
    ("double_pendulum_description/urdf/double_pendulum_continuous.urdf", "fixed", 2, 0, 0, 0),
    ("b1_description/urdf/b1-z1.urdf", "freeflyer", 25, 4, 0, 0),
    ("g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf", "freeflyer", 49, 2, 0, 0),
]


def limbs_of(path: Path) -> Limbs:
    return find_limbs(read_urdf(path, "fixed"))


@pytest.mark.parametrize(("file", "base", "nv", "contacts", "wheels", "undriven"), GUESSES)
def test_base_feet_wheels_and_hands_are_guessed(
    file: str, base: str, nv: int, contacts: int, wheels: int, undriven: int
) -> None:
    path = robot_file(file)
    limbs, found = limbs_of(path), guessed(path)
    assert (found.base, found.nv, len(found.contacts)) == (base, nv, contacts)
    assert (len(limbs.wheels), len(limbs.undriven)) == (wheels, undriven)


def test_wheels_are_named_and_fingers_of_effort_zero_are() -> None:
    assert limbs_of(robot_file("tiago_description/robots/tiago.urdf")).wheels == WHEELS
    romeo = limbs_of(robot_file("romeo_description/urdf/romeo.urdf"))
    assert all(name[1:].startswith(("Finger", "Thumb", "Hand")) for name in romeo.undriven)


def test_a_robot_on_wheels_with_a_free_base_rolls() -> None:
    found = guessed(robot_file("tiago_description/robots/tiago_no_hand.urdf"), "freeflyer")
    assert set(wheel_rows(found)) == {"wheel_left_link", "wheel_right_link"}
    assert {contact.radius for contact in found.contacts} == {0.0985}


LINK = (
    '<inertial><mass value="{mass}"/>'
    '<inertia ixx="{i}" ixy="0" ixz="0" iyy="{i}" iyz="0" izz="{i}"/></inertial>'
)


def arm(folder: Path, finger: float, limit: str) -> Path:
    """Three joints and two fingers that slide, of a mass in kg and with that <limit>."""
    links = "".join(f'<link name="l{k}">{LINK.format(mass=2, i=0.02)}</link>' for k in range(4)) + "".join(
        f'<link name="f{k}">{LINK.format(mass=finger, i=finger * 1e-4)}</link>' for k in range(2)
    )
    turning = '<limit lower="-2" upper="2" effort="50" velocity="3"/>'
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
        f'<origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>{turning}</joint>'
        for k in range(3)
    ) + "".join(
        f'<joint name="s{k}" type="prismatic"><parent link="l3"/><child link="f{k}"/>'
        f'<origin xyz="0 {0.02 - 0.04 * k} 0.1"/><axis xyz="0 1 0"/>{limit}</joint>'
        for k in range(2)
    )
    path = folder / "arm.urdf"
    path.write_text(f'<robot name="arm">{links}{joints}</robot>', encoding="utf-8")
    return path


DRIVEN = '<limit lower="0" upper="0.04" effort="20" velocity="0.2"/>'


@pytest.mark.parametrize(
    ("finger", "limit", "nv"),
    [
        (0.05, DRIVEN, 5),
        (0.05, DRIVEN.replace("20", "0"), 3),
        (0.5, DRIVEN.replace("20", "0"), 5),  # too heavy to be left out
        (0.0, DRIVEN, 3),
    ],
)
def test_a_gripper_makes_no_feet_and_is_locked_without_drive(
    finger: float, limit: str, nv: int, tmp_path: Path
) -> None:
    path = arm(tmp_path, finger, limit)
    found = guessed(path)
    assert (found.base, found.nv, found.contacts) == ("fixed", nv, ())
    file = tmp_path / "arm.py"
    file.write_text(starter(found, file), encoding="utf-8")
    built = robots.load(str(file))
    assert list(built.model.names) == list(found.model.names)
    np.testing.assert_allclose(built.reference, found.reference, atol=1e-3)
    assert robots.tool_frame(str(file)) == ("l3" if nv == 5 else "f1")


def test_heavy_branches_are_limbs(tmp_path: Path) -> None:
    assert not limbs_of(arm(tmp_path, 4.0, DRIVEN)).is_fixed


def test_without_any_effort_limit_nothing_is_locked(tmp_path: Path) -> None:
    path = arm(tmp_path, 0.05, DRIVEN)
    path.write_text(
        path.read_text().replace('effort="50"', 'effort="0"').replace('effort="20"', 'effort="0"')
    )
    assert limbs_of(path).undriven == ()


def test_the_command_says_what_is_locked() -> None:
    shown = invoke("robot", str(robot_file("tiago_description/robots/tiago_no_hand.urdf")))
    assert "guess: wheels, locked as the base is fixed: wheel_left_joint, wheel_right_joint" in shown.stdout


CART = """<mujoco><worldbody><body name="cart" pos="0 0 0.2"><freejoint/><geom type="box" size="0.3 0.2 0.1"/>
{wheels}<body name="mast" pos="0 0 0.1"><joint name="pan" axis="0 0 1"/>
<geom type="capsule" fromto="0 0 0 0 0 0.5" size="0.03"/></body></body></worldbody>
<actuator><motor joint="pan" forcerange="-1 1" forcelimited="true"/></actuator></mujoco>"""
WHEEL = """<body name="wheel_{n}" pos="{x} {y} -0.1" euler="90 0 0">
<joint name="wheel_{n}_joint" axis="0 0 1"/><geom type="cylinder" size="0.1 0.02"/></body>"""


def test_wheels_of_an_mjcf_file_roll(tmp_path: Path) -> None:
    places = [(0.2, 0.2), (0.2, -0.2), (-0.2, 0.2), (-0.2, -0.2)]
    wheels = "".join(WHEEL.format(n=n, x=x, y=y) for n, (x, y) in enumerate(places))
    path = tmp_path / "cart.xml"
    path.write_text(CART.format(wheels=wheels), encoding="utf-8")
    robot = guessed(path)
    assert (robot.base, robot.nu) == ("freeflyer", 1)
    assert wheel_rows(robot) == {f"wheel_{n}": 6 + n for n in range(4)}
    assert {contact.radius for contact in robot.contacts} == {0.1}


@pytest.mark.parametrize("joint", ["", "<freejoint/>"])
def test_a_single_wheel_is_a_flywheel(joint: str, tmp_path: Path) -> None:
    path, wheel = tmp_path / "one.xml", WHEEL.format(n=0, x=0, y=0)
    body = f'<body name="box">{joint}<geom size="0.1"/>{wheel}</body>'
    path.write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>", encoding="utf-8")
    assert "wheel_0_joint" in guessed(path).model.names
