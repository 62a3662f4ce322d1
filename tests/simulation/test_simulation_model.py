"""The MuJoCo model of a robot is the robot: mass matrix, bias and kinematics as by Pinocchio."""

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from tests.support.models import JOINT_KINDS, hand_built, random_state
from trajopt.errors import InputError
from trajopt.simulation.bodies import body_name, build_bodies, compile_bodies, write_inertias
from trajopt_library import robots

# Two recursions over a few dozen bodies in double precision.
SAME = 1e-10
SEEDS = range(3)


def without_linear_armature(model: pin.Model) -> pin.Model:
    """A copy without inertias of drives along axes that turn with the body: MuJoCo has other axes there."""
    copied = pin.Model(model)
    armature = copied.armature.copy()
    for joint in list(copied.joints)[1:]:
        linear = {"JointModelFreeFlyer": 3, "JointModelPlanar": 2}.get(joint.shortname(), 0)
        armature[joint.idx_v : joint.idx_v + linear] = 0.0
    copied.armature[:] = armature
    return copied


def agrees(model: pin.Model, seed: int) -> None:
    """Assert that everything of a random state agrees, each relative to its largest entry."""
    compiled, coordinates = compile_bodies(build_bodies(model))
    state, data, own = mujoco.MjData(compiled), model.createData(), random_state(model, seed)
    q, v, _ = own
    qpos = coordinates.to_mujoco(q[None])
    qvel = coordinates.rates_to_mujoco(qpos, v[None])
    np.testing.assert_allclose(coordinates.from_mujoco(qpos)[0], q, atol=SAME)
    np.testing.assert_allclose(coordinates.rates_from_mujoco(qpos, qvel)[0], v, atol=SAME)
    state.qpos[:], state.qvel[:] = qpos[0], qvel[0]
    mujoco.mj_forward(compiled, state)
    mass, columns = np.zeros((model.nv, model.nv)), np.eye(model.nv)
    mujoco.mj_fullM(compiled, state, mass)
    turn = np.array([coordinates.rates_to_mujoco(qpos, column[None])[0] for column in columns]).T
    crba = np.triu(pin.crba(model, data, q))
    crba = crba + np.triu(crba, 1).T
    np.testing.assert_allclose(turn.T @ mass @ turn, crba, atol=SAME * np.abs(crba).max())
    # Pinocchio's acceleration where MuJoCo's is zero: the bias is the force that this takes.
    still = coordinates.accelerations_from_mujoco(qpos, qvel, np.zeros((1, model.nv)))[0]
    bias = pin.rnea(model, data, q, v, still)
    np.testing.assert_allclose(turn.T @ state.qfrc_bias, bias, atol=SAME * np.abs(bias).max())
    pin.forwardKinematics(model, data, q)
    for index in range(1, model.njoints):
        body, placement = state.body(body_name(index)), data.oMi[index]
        np.testing.assert_allclose(body.xpos, placement.translation, atol=SAME)
        np.testing.assert_allclose(body.xmat.reshape(3, 3), placement.rotation, atol=SAME)


@pytest.mark.long
@pytest.mark.parametrize("name", robots.names())
def test_every_robot_has_the_same_dynamics(name):
    for seed in SEEDS:
        agrees(robots.load(name).model, seed)


@pytest.mark.long
@pytest.mark.parametrize("kind", JOINT_KINDS)
def test_every_kind_of_joint_has_the_same_dynamics(kind):
    for seed in SEEDS:
        agrees(without_linear_armature(hand_built(kind)[0]), seed)


def test_virtual_base_has_the_same_dynamics():
    agrees(robots.load("solo12").with_virtual_base().model, 0)


def test_gravity_of_any_direction_has_the_same_dynamics():
    model = pin.Model(robots.load("ur5").model)
    model.gravity.linear = np.array([1.0, -2.0, 3.0])
    agrees(model, 0)


def test_bodies_without_mass_have_the_same_dynamics():
    model = pin.Model(robots.load("ur5").model)
    model.inertias[3] = pin.Inertia.Zero()
    agrees(model, 0)


def test_inertias_that_no_solid_has_are_kept():
    model = pin.Model(robots.load("ur5").model)
    model.inertias[6] = pin.Inertia(0.3, np.array([0.1, 0.0, 0.02]), np.diag([1.0, 0.1, 0.1]))
    agrees(model, 1)


def test_inertias_can_change_after_compilation():
    model, heavier = robots.load("ur5").model, pin.Model(robots.load("ur5").model)
    heavier.appendBodyToJoint(6, pin.Inertia.FromSphere(2.0, 0.1), pin.SE3.Random())
    compiled, _ = compile_bodies(build_bodies(model))
    expected, _ = compile_bodies(build_bodies(heavier))
    write_inertias(compiled, heavier)
    for name in ("body_mass", "body_inertia", "body_ipos", "body_subtreemass", "dof_invweight0"):
        np.testing.assert_allclose(getattr(compiled, name), getattr(expected, name), atol=SAME)


def test_angles_of_continuous_joints_go_on_without_jumps():
    robot = robots.load("double_pendulum")
    coordinates = compile_bodies(build_bodies(robot.model))[1]
    angle = np.linspace(0.0, 8.0 * np.pi, 200)
    q = np.column_stack([np.cos(angle), np.sin(angle), np.cos(-angle), np.sin(-angle)])
    np.testing.assert_allclose(coordinates.to_mujoco(q), np.column_stack([angle, -angle]), atol=1e-9)


def test_armature_of_the_linear_rows_of_a_base_is_refused_in_one_line():
    model = pin.Model(robots.load("solo12").model)
    model.armature[:] = np.r_[1.0, np.zeros(model.nv - 1)]
    with pytest.raises(InputError, match=r"armatures .* allowed in a simulation: none"):
        compile_bodies(build_bodies(model))
