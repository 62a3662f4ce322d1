"""The MJCF of a plan opens in MuJoCo alone, and is the robot: names, mass matrix, gravity, ground."""

import json
import re
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import trajopt
from tests.support.models import JOINT_KINDS, hand_built, random_state
from tests.support.refusals import assert_refused_in_one_line
from tests.support.sampled_problems import solution_of_kind
from tests.support.synthetic_motions import at_rest, sampled
from trajopt.motion.solution import Solution
from trajopt.robot.actuators.mimic import MimicJoint
from trajopt.robot.robot import Robot
from trajopt.simulation import write_mjcf
from trajopt.simulation.mjcf import mjcf_of
from trajopt.simulation.scene import Scene, build_scene
from trajopt.simulation.settings import SimulationSettings
from trajopt.simulation.site import Site

pytestmark = pytest.mark.long

# Numbers are written in full; what MuJoCo needs of a body without mass is below this.
SAME = 1e-9
KINDS = (
    "torque",
    "continuous joints",
    "grasp",
    "passive joint",
    "planar base",
    "virtual joints",
    "drives",
    "soles",
)
READ_ALONE = """
import json, mujoco, sys
model = mujoco.MjModel.from_xml_path(sys.argv[1])
data = mujoco.MjData(model)
mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
data.qvel[:] = 0.0
mujoco.mj_forward(model, data)
print(json.dumps({
    "mass": model.body_subtreemass[0],
    "joints": [model.joint(i).name for i in range(model.njnt)],
    "motors": [model.actuator(i).name for i in range(model.nu)],
    "sites": [model.site(i).name for i in range(model.nsite)],
    "gravity": data.qfrc_bias.tolist(),
}))
"""


def standing_still(robot: Robot) -> Solution:
    """A plan that holds the reference posture without torques."""
    return sampled(robot, [at_rest(robot, 0.1)], 2)


def assert_same_dynamics(plan: Solution, written: mujoco.MjModel, scene: Scene, seed: int) -> None:
    """The equations of motion of a file at a random state are Pinocchio's."""
    model, coordinates, state = plan.model, scene.coordinates, mujoco.MjData(written)
    q, v, _ = random_state(model, seed)
    qpos = coordinates.to_mujoco(q[None])
    state.qpos[:], state.qvel[:] = qpos[0], coordinates.rates_to_mujoco(qpos, v[None])[0]
    mujoco.mj_forward(written, state)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(written, state, mass)
    turn = np.array([coordinates.rates_to_mujoco(qpos, column[None])[0] for column in np.eye(model.nv)]).T
    expected = np.triu(pin.crba(model, model.createData(), q))
    expected = expected + np.triu(expected, 1).T
    np.testing.assert_allclose(turn.T @ mass @ turn, expected, atol=SAME * np.abs(expected).max())
    still = coordinates.accelerations_from_mujoco(qpos, state.qvel[None], np.zeros((1, model.nv)))[0]
    bias = pin.rnea(model, model.createData(), q, v, still)
    np.testing.assert_allclose(turn.T @ state.qfrc_bias, bias, atol=SAME * max(np.abs(bias).max(), 1.0))


@pytest.mark.parametrize("kind", KINDS)
def test_file_opens_from_another_folder_and_process_and_is_the_robot(kind: str, tmp_path: Path) -> None:
    plan, elsewhere = solution_of_kind(kind), tmp_path / "elsewhere"
    elsewhere.mkdir()
    path = write_mjcf(plan, tmp_path / "robot.xml")
    words = [sys.executable, "-I", "-c", READ_ALONE, str(path)]
    done = subprocess.run(words, cwd=elsewhere, check=True, capture_output=True, timeout=120)
    read, model = json.loads(done.stdout), plan.model
    assert read["mass"] == pytest.approx(sum(one.mass for one in list(model.inertias)[1:]), abs=SAME)
    named = [re.sub("_(x|y|angle)$", "", name) for name in read["joints"]]  # parts of a planar base
    assert list(dict.fromkeys(named)) == list(model.names)[1:]
    assert read["motors"] == list(plan.torque_names)
    assert [name for name in read["sites"] if name in plan.contact_frames] == list(plan.contact_frames)
    scene = build_scene(Site.of_plan(plan), SimulationSettings())
    gravity = pin.computeGeneralizedGravity(model, model.createData(), plan.q[0])
    qpos = scene.coordinates.to_mujoco(plan.q[:1])
    found = scene.coordinates.rates_from_mujoco(qpos, np.array([read["gravity"]]))[0]
    np.testing.assert_allclose(found, gravity, atol=SAME * max(np.abs(gravity).max(), 1.0))
    assert_same_dynamics(plan, mujoco.MjModel.from_xml_path(str(path)), scene, 0)


@pytest.mark.parametrize("kind", JOINT_KINDS)
def test_every_kind_of_joint_is_written(kind: str, tmp_path: Path) -> None:
    model = pin.Model(hand_built(kind)[0])
    for index in range(1, model.njoints):  # of solid bodies: theirs are random
        model.inertias[index] = pin.Inertia.FromBox(1.0 + index, 0.1, 0.2, 0.3)
    armature = np.array(model.armature)
    for joint in list(model.joints)[1:]:
        if joint.nv > 1:  # MuJoCo has one number a joint
            armature[joint.idx_v : joint.idx_v + joint.nv] = 0.0
    model.armature[:] = armature
    plan = standing_still(Robot.from_model(model, reference=pin.neutral(model), name=kind))
    target = tmp_path / "robot.xml"
    if kind in ("FreeFlyer", "Planar"):  # with motors, as nothing that moves is here a base
        assert_refused_in_one_line(lambda: write_mjcf(plan, target), "has motors")
        return
    written = mujoco.MjModel.from_xml_path(str(write_mjcf(plan, target)))
    assert written.nu == plan.tau.shape[1]
    assert_same_dynamics(plan, written, build_scene(Site.of_plan(plan), SimulationSettings()), 1)


def test_motors_in_the_order_of_tau_accelerate_the_robot_as_planned() -> None:
    plan = solution_of_kind("torque")
    model = mujoco.MjModel.from_xml_string(mjcf_of(plan))
    data = mujoco.MjData(model)
    for row in np.flatnonzero(plan.collocation):
        data.qpos[:], data.qvel[:], data.ctrl[:] = plan.q[row], plan.v[row], plan.tau[row]
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.qacc, plan.a[row], atol=1e-6)
    high = np.array(plan.description.effort_limit)
    np.testing.assert_allclose(model.actuator_ctrlrange, np.column_stack([-high, high]))


def test_friction_and_ground_are_those_of_the_simulation() -> None:
    plan = solution_of_kind("drives")
    scene = build_scene(Site.of_plan(plan), SimulationSettings())
    written = mujoco.MjModel.from_xml_string(mjcf_of(plan))
    for name in ("dof_damping", "dof_frictionloss", "dof_armature", "body_parentid"):
        np.testing.assert_allclose(getattr(written, name), getattr(scene.compiled, name), rtol=1e-12)
    for name in ("geom_pos", "geom_size", "pair_friction", "pair_solref", "site_pos"):  # six digits
        own, expected = getattr(written, name), getattr(scene.compiled, name)
        np.testing.assert_allclose(own, expected, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(written.opt.gravity, plan.model.gravity.linear)


def test_what_mjcf_cannot_express_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    model = pin.Model(hand_built("RX")[0])
    model.inertias[1] = pin.Inertia(0.3, np.zeros(3), np.diag([1.0, 0.1, 0.1]))  # no solid body has it
    model.armature[:] = 0.0
    plan = standing_still(Robot.from_model(model, reference=pin.neutral(model), name="odd"))
    assert_refused_in_one_line(
        lambda: write_mjcf(plan, tmp_path / "odd.xml"), "MJCF cannot express the model"
    )
    assert not list(tmp_path.iterdir())
    assert_refused_in_one_line(lambda: write_mjcf(solution_of_kind("points"), tmp_path), "cannot write")


def test_a_joint_that_follows_another_is_an_equality_of_their_names() -> None:
    rule = MimicJoint(joint="wrist_2_joint", mimics="wrist_1_joint", ratio=-0.5, offset=0.1)
    robot: Robot = trajopt.robot("ur5").with_mimics([rule])
    model = mujoco.MjModel.from_xml_string(
        mjcf_of(sampled(robot, [at_rest(robot, 0.2)], 2, mimics=[rule.to_meta()]))
    )
    assert model.neq == 1
    names = [model.joint(int(number)).name for number in (model.eq_obj1id[0], model.eq_obj2id[0])]
    assert names == ["wrist_2_joint", "wrist_1_joint"]
    np.testing.assert_allclose(model.eq_data[0, :2], [rule.offset, rule.ratio])
