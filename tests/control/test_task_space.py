"""Task-space control without a plan: what the page shows does what it says, and limits hold."""

import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.repository import ROOT
from trajopt.control import CenterOfMassTask, ContactForceTask, FrameTask, PostureTask, TaskSpaceController
from trajopt.control.tasks import Task
from trajopt.errors import InputError
from trajopt.robot import Contact, frame_pose
from trajopt_library import robots

PAGE = (ROOT / "docs" / "how-to" / "task-space-control.md").read_text(encoding="utf-8")
SCRIPTS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
# Of a script without its imports.
MOST_LINES = 15


@pytest.mark.parametrize("script", SCRIPTS, ids=["circle", "centre of mass", "force"])
def test_scripts_of_the_page_are_short(script):
    lines = [line for line in script.splitlines() if line and not line.startswith(("import", "from"))]
    assert len(lines) <= MOST_LINES


@pytest.mark.long
def test_a_tool_follows_a_circle():
    left: dict = {}
    exec(SCRIPTS[0], left)
    robot, q, t = left["robot"], left["q"], left["t"] + left["dt"]
    wanted = left["start"].translation + 0.1 * np.array([np.cos(np.pi * t) - 1, np.sin(np.pi * t), 0.0])
    assert_allclose(frame_pose(robot, q, "tool0").translation, wanted, atol=1e-3)
    assert (np.abs(left["torque"]) <= robot.torque_limit).all()


@pytest.mark.long
def test_a_centre_of_mass_sways_over_feet_that_stand():
    left: dict = {}
    exec(SCRIPTS[1], left)
    robot, moved = left["robot"], left["controller"].state.centre_of_mass()[0] - left["centre"]
    assert abs(moved[1]) < 0.04
    assert_allclose(moved[[0, 2]], 0.0, atol=1e-3)
    for foot in left["feet"]:
        frame = robot.contact(foot).frame
        before, now = (frame_pose(robot, at, frame) for at in (robot.reference, left["q"]))
        assert_allclose(now.translation, before.translation, atol=1e-3)
    forces = left["controller"].last.forces[:, 2]
    assert forces.sum() == pytest.approx(robot.weight, rel=0.05)


def test_a_tool_presses_as_it_is_told():
    left: dict = {}
    exec(SCRIPTS[2], left)
    robot, data = left["robot"], left["robot"].model.createData()
    assert_allclose(left["controller"].last.forces[0, :3], [0.0, 0.0, 20.0], atol=1e-2)
    gravity = pin.computeGeneralizedGravity(robot.model, data, robot.reference)
    frame = robot.model.getFrameId("tool0")
    jacobian = pin.computeFrameJacobian(robot.model, data, robot.reference, frame, pin.LOCAL_WORLD_ALIGNED)
    assert_allclose(left["torque"], gravity - 20.0 * jacobian[2], atol=0.05)


def test_joints_keep_within_their_ranges():
    robot = robots.load("ur5")
    upper = robot.reference + 0.05
    robot = replace(robot, position_upper=upper)
    controller, q, v = TaskSpaceController(robot), robot.reference, np.zeros(6)
    for _ in range(500):
        controller.torque(q, v, [PostureTask(q=robot.reference + 0.5, bandwidth=10.0)])
        q, v = controller.step(q, v, 2e-3)
    assert_allclose(q, upper, atol=1e-3)
    assert (q <= upper + 1e-9).all()


def test_what_cannot_be_is_said_in_one_line():
    robot = robots.load("ur5")
    controller = TaskSpaceController(robot)
    with pytest.raises(InputError, match="no torques were asked for yet"):
        controller.step(robot.reference, np.zeros(6), 1e-3)
    with pytest.raises(InputError, match="no contact 'hand'"):
        controller.torque(robot.reference, np.zeros(6), [], contacts=["hand"])
    tool = FrameTask(frame="nowhere", pose=pin.SE3.Identity(), bandwidth=1.0)
    with pytest.raises(InputError, match="nowhere"):
        controller.torque(robot.reference, np.zeros(6), [tool])
    press = ContactForceTask(wanted=np.zeros((0, 6)))
    with pytest.raises(InputError, match="no force of contact 0"):
        TaskSpaceController(replace(robot, contacts=(Contact(frame="tool0"),))).torque(
            robot.reference, np.zeros(6), [press], contacts=["tool0"]
        )


@pytest.mark.parametrize(
    ("task", "message"),
    [
        (FrameTask(frame="tool0", pose=np.eye(4), bandwidth=5.0), "pose of FrameTask .* pinocchio.SE3"),
        (FrameTask(frame="tool0", pose=pin.SE3.Identity(), bandwidth=-1.0), "bandwidth of FrameTask is -1"),
        (
            FrameTask(frame="tool0", pose=pin.SE3.Identity(), velocity=np.zeros(3), bandwidth=1.0),
            r"velocity of FrameTask .* shape \(6,\)",
        ),
        (CenterOfMassTask(position=np.zeros(2), bandwidth=1.0), r"position of CenterOfMassTask .* \(3,\)"),
        (PostureTask(q=np.zeros(4), bandwidth=1.0), r"q of PostureTask .* shape \(6,\)"),
        (PostureTask(q=np.zeros(6), bandwidth=1.0, weight=-1.0), "weight of PostureTask is -1"),
        (PostureTask(q=np.zeros(6), bandwidth=1.0, weight=float("nan")), "weight of PostureTask is nan"),
        (PostureTask(q=np.full(6, np.nan), bandwidth=1.0), "q of PostureTask .* finite"),
        (ContactForceTask(wanted=np.zeros((1, 6))), "'ur5' has no contact, which ContactForceTask needs"),
    ],
)
def test_a_task_that_cannot_act_is_refused_by_name(task: Task, message: str) -> None:
    robot = robots.load("ur5")
    with pytest.raises(InputError, match=message):
        TaskSpaceController(robot).torque(robot.reference, np.zeros(6), [task])


def test_a_contact_twice_a_name_for_a_robot_and_a_step_back_are_refused() -> None:
    robot = robots.load("solo12")
    controller, state = TaskSpaceController(robot), (robot.reference, np.zeros(robot.nv))
    with pytest.raises(InputError, match="contacts are FL_FOOT, FL_FOOT; allowed: each once"):
        controller.torque(*state, [], contacts=["FL_FOOT", "FL_FOOT"])
    with pytest.raises(InputError, match="robot"):
        TaskSpaceController("go1")  # type: ignore[arg-type]
    controller.torque(*state, [PostureTask(q=robot.reference, bandwidth=5.0)])
    with pytest.raises(InputError, match="dt"):
        controller.step(*state, -0.01)


def test_a_cart_with_a_passive_pole_is_controlled_by_its_cart_alone():
    robot = trajopt.robot("cart_pole")
    controller = TaskSpaceController(robot)
    torque = controller.torque(
        np.array([0.0, 0.3]),
        np.zeros(2),
        [PostureTask(q=np.array([0.2, 0.0]), bandwidth=2.0, rows_of_v=np.array([0]))],
    )
    assert torque.shape == (1,)
    a = controller.last.acceleration
    force = pin.rnea(robot.model, robot.model.createData(), np.array([0.0, 0.3]), np.zeros(2), a)
    assert_allclose(force, [torque[0], 0.0], atol=1e-6)
