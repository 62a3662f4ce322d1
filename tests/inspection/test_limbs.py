"""Arms with hands, wheels, and joints without drive in first guesses of robots."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.command_lines import invoke
from trajopt.inspection.starter import Limbs, find_limbs, guessed, starter
from trajopt.robot.data import robot_file
from trajopt.robot.reading import read_urdf
from trajopt_library import robots

WHEELS = ("wheel_left_joint", "wheel_right_joint")
# File, base, velocities of the guess, contacts, wheels, joints without drive.
GUESSES = [
    ("tiago_description/robots/tiago.urdf", "fixed", 46, 0, 2, 0),
    ("tiago_description/robots/tiago_no_hand.urdf", "fixed", 10, 0, 2, 0),
    ("romeo_description/urdf/romeo.urdf", "freeflyer", 37, 2, 0, 24),
    ("centauro_description/urdf/centauro.urdf", "fixed", 35, 0, 4, 0),
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


def test_a_robot_on_wheels_with_a_free_base_has_no_feet() -> None:
    assert guessed(robot_file("tiago_description/robots/tiago_no_hand.urdf"), "freeflyer").contacts == ()


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
    assert "guess: wheels, locked and not taken as feet: wheel_left_joint, wheel_right_joint" in shown.stdout


CART = """<mujoco><worldbody><body name="cart" pos="0 0 0.2"><freejoint/><geom type="box" size="0.3 0.2 0.1"/>
{wheels}<body name="mast" pos="0 0 0.1"><joint name="pan" axis="0 0 1"/>
<geom type="capsule" fromto="0 0 0 0 0 0.5" size="0.03"/></body></body></worldbody>
<actuator><motor joint="pan" forcerange="-1 1" forcelimited="true"/></actuator></mujoco>"""
WHEEL = """<body name="wheel_{n}" pos="{x} {y} -0.1" euler="90 0 0">
<joint name="wheel_{n}_joint" axis="0 0 1"/><geom type="cylinder" size="0.1 0.02"/></body>"""


def test_wheels_of_an_mjcf_file_are_no_feet(tmp_path: Path) -> None:
    places = [(0.2, 0.2), (0.2, -0.2), (-0.2, 0.2), (-0.2, -0.2)]
    wheels = "".join(WHEEL.format(n=n, x=x, y=y) for n, (x, y) in enumerate(places))
    path = tmp_path / "cart.xml"
    path.write_text(CART.format(wheels=wheels), encoding="utf-8")
    robot = guessed(path)
    assert (robot.base, robot.nu, robot.contacts) == ("freeflyer", 1, ())
    assert "wheels, locked and not taken as feet: wheel_0_joint" in invoke("robot", str(path)).output


@pytest.mark.parametrize("joint", ["", "<freejoint/>"])
def test_a_single_wheel_is_a_flywheel(joint: str, tmp_path: Path) -> None:
    path, wheel = tmp_path / "one.xml", WHEEL.format(n=0, x=0, y=0)
    body = f'<body name="box">{joint}<geom size="0.1"/>{wheel}</body>'
    path.write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>", encoding="utf-8")
    assert "wheel_0_joint" in guessed(path).model.names
