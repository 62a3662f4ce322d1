"""Joints that cannot be moved are named before anything is solved: limits of 0, and no inertia."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import trajopt
from trajopt.errors import InputError
from trajopt.inspection.faults import find_faults
from trajopt.inspection.standing import standing_posture
from trajopt.problem.problem import Problem
from trajopt.robot.joint_checks import joints_without_inertia, require_inertia, require_moving
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.terms import TorqueCost
from trajopt_library import robots

SMALL = 1e-7  # kg m^2, of a finger's last link


def chain(*links: pin.Inertia, armature: float = 0.0, axes: str = "yyy") -> Robot:
    """An arm whose joints 'j0', 'j1', ... turn about ``axes``, a link of 0.3 m behind each."""
    model, parent = pin.Model(), 0
    kinds = {"x": pin.JointModelRX, "y": pin.JointModelRY, "z": pin.JointModelRZ}
    for index, (link, axis) in enumerate(zip(links, axes, strict=False)):
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.3 if index else 0.0]))
        parent = model.addJoint(parent, kinds[axis](), place, f"j{index}")
        model.addJointFrame(parent)
        model.appendBodyToJoint(parent, link, pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.15])))
    model.armature = np.full(model.nv, armature)
    limits = {"velocity_limit": np.full(model.nv, 3.0), "torque_limit": np.full(model.nv, 50.0)}
    return replace(Robot.from_model(model, name="chain"), **limits)


BAR, NOTHING = pin.Inertia.FromBox(2.0, 0.05, 0.05, 0.3), pin.Inertia.Zero()
POINT = pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3)))
FINGER = pin.Inertia(1e-5, np.zeros(3), SMALL * np.eye(3))


@pytest.mark.parametrize(
    ("robot", "expected"),
    [
        (chain(BAR, BAR), []),
        (chain(BAR, NOTHING), ["j1"]),
        (chain(BAR, NOTHING, NOTHING), ["j1", "j2"]),
        (chain(BAR, NOTHING, BAR), []),
        (chain(BAR, NOTHING, armature=1e-4), []),
        (chain(BAR, FINGER), []),
        (chain(BAR, POINT, axes="yz"), ["j1"]),
        (chain(BAR, NOTHING, POINT, axes="yzy"), []),
    ],
)
def test_a_joint_without_inertia_is_found_wherever_it_moves_none(robot: Robot, expected: list[str]) -> None:
    assert joints_without_inertia(robot) == expected


@pytest.mark.parametrize("name", robots.names())
def test_all_joints_of_the_library_can_be_moved(name: str) -> None:
    robot = robots.load(name)
    require_inertia(robot)
    require_moving(robot)


def still(robot: Robot, *terms: trajopt.terms.Term, actuation: str = "torque") -> Problem:
    return Problem(
        name="still", robot=robot, schedule=Schedule((Phase(name="rest", duration=1.0),)), terms=terms,
        actuation=actuation,
    )  # fmt: skip


def test_a_problem_with_torques_needs_inertia() -> None:
    robot = chain(BAR, NOTHING)
    with pytest.raises(InputError, match=r"no inertia is moved by joint 'j1' of 'chain'.*lock it") as refused:
        still(robot, TorqueCost(weight=1.0))
    assert "\n" not in str(refused.value)
    assert still(robot, actuation="acceleration").robot is robot
    assert still(robot.with_locked(["j1"]), TorqueCost(weight=1.0)).robot.nv == 1


def test_a_report_says_which_joints_move_nothing() -> None:
    robot = chain(BAR, POINT, axes="yz")
    assert any("no inertia is moved by j1" in line for line in find_faults(robot, standing_posture(robot)))


@pytest.mark.parametrize("family", ["arm-reach", "arm-avoid", "arm-pick-place", "arm-transfer", "arm-wipe"])
def test_an_arm_whose_limits_are_zero_is_one_line(
    family: str, monkeypatch: pytest.MonkeyPatch, tmp_path
) -> None:
    file = tmp_path / "still.py"
    file.write_text(
        "import numpy as np\nfrom dataclasses import replace\nfrom trajopt_library import robots\n"
        "def build():\n    ur5 = robots.load('ur5')\n    return replace(ur5, velocity_limit=np.zeros(6))\n"
    )
    with pytest.raises(InputError, match=r"velocity limit of joint 'shoulder_pan_joint' and 5 more"):
        trajopt.load(family, robot=str(file))


def test_a_jump_of_legs_whose_limits_are_zero_is_one_line(tmp_path) -> None:
    file = tmp_path / "still.py"
    file.write_text(
        "import numpy as np\nfrom dataclasses import replace\nfrom trajopt_library import robots\n"
        "def build():\n    go2 = robots.load('go2')\n    return replace(go2, torque_limit=np.zeros(12))\n"
    )
    with pytest.raises(InputError, match=r"torque limit of joint '\w+' and 11 more of 'go2' is 0"):
        trajopt.load("quadruped-jump-up", robot=str(file))
