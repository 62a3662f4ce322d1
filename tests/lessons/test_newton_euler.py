"""The recursive Newton-Euler method: joint forces, constraint forces, contacts, the lecture's formulas."""

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.lecture_models import named, three_joint_arm
from tests.support.models import JOINT_KINDS, random_state, robot
from trajopt.dynamics.model_quantities import generalized_force
from trajopt.errors import InputError, UnsupportedJointError
from trajopt_library.lessons.newton_euler import joint_forces, recursive_newton_euler

# Both sides sum the same numbers of order 1 to 1e3 in another order.
SAME = {"rtol": 1e-10, "atol": 1e-10}
SEEDS = (0, 1)
MODELS = [
    "ur5", "kinova", "panda", "solo12", "talos", "planar:go2", "virtual:solo12", "three_joint_arm",
    "planar_hopper", *(f"joint:{kind}" for kind in JOINT_KINDS),
]  # fmt: skip
FEET = ("FL_FOOT", "HR_FOOT")


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", MODELS)
def test_torques_and_joint_forces_equal_pinocchios(name, seed):
    model = named(name)
    q, v, a = random_state(model, seed)
    forces, data = joint_forces(model, q, v, a), model.createData()
    assert_allclose(forces.tau, pin.rnea(model, data, q, v, a), **SAME)
    expected = np.array([data.f[index].vector for index in range(1, model.njoints)])
    assert_allclose(np.hstack([forces.force, forces.moment]), expected, **SAME)
    assert forces.joints == tuple(model.names)[1:]


@pytest.mark.parametrize("name", MODELS)
def test_constraint_forces_do_no_work_in_any_direction_of_their_joint(name):
    model = named(name)
    q, v, a = random_state(model, 2)
    forces = joint_forces(model, q, v, a)
    for index in range(1, model.njoints):
        joint = model.joints[index]
        data = joint.createData()
        joint.calc(data, q[joint.idx_q : joint.idx_q + joint.nq])
        subspace = np.reshape(np.asarray(data.S), (6, -1), order="F")
        carried = np.concatenate([forces.constraint_force[index - 1], forces.constraint_moment[index - 1]])
        assert_allclose(subspace.T @ carried, 0.0, atol=SAME["atol"])


def test_a_free_flyer_has_no_constraint_force_and_a_revolute_joint_five():
    model = named("solo12")
    forces = joint_forces(model, *random_state(model, 0))
    assert_allclose(forces.constraint_force[0], 0.0, atol=SAME["atol"])
    assert_allclose(forces.constraint_moment[0], 0.0, atol=SAME["atol"])
    axis = 0 if "RX" in model.joints[2].shortname() else 1
    others = [i for i in range(3) if i != axis]
    assert_allclose(forces.constraint_force[1], forces.force[1], **SAME)
    assert_allclose(forces.constraint_moment[1][others], forces.moment[1][others], **SAME)


def test_contact_wrenches_act_as_in_the_equations_of_motion_and_reach_the_joints():
    model = named("solo12")
    q, v, a = random_state(model, 3)
    wrenches = np.random.default_rng(3).uniform(-20, 20, (2, 6))
    forces = joint_forces(model, q, v, a, frames=FEET, wrenches=wrenches)
    ids, data = [model.getFrameId(foot) for foot in FEET], model.createData()
    assert_allclose(forces.tau, generalized_force(model, data, (q, v, a), ids, wrenches), **SAME)
    external = pin.StdVec_Force()
    external.extend(pin.Force.Zero() for _ in range(model.njoints))
    pin.framesForwardKinematics(model, data, q)
    for frame, wrench in zip(ids, wrenches, strict=True):
        joint = model.frames[frame].parentJoint
        at_foot = pin.SE3(np.eye(3), data.oMf[frame].translation)
        external[joint] = external[joint] + data.oMi[joint].actInv(at_foot.act(pin.Force(wrench)))
    pin.rnea(model, data, q, v, a, external)
    expected = np.array([data.f[index].vector for index in range(1, model.njoints)])
    assert_allclose(np.hstack([forces.force, forces.moment]), expected, **SAME)


def test_a_hanging_chain_at_rest_carries_the_weight_below_each_joint():
    model = three_joint_arm()
    q = random_state(model, 0)[0]
    forces, rest = joint_forces(model, q, np.zeros(3), np.zeros(3)), model.createData()
    pin.forwardKinematics(model, rest, q)
    masses = np.array([inertia.mass for inertia in list(model.inertias)[1:]])
    for index in range(3):
        world = rest.oMi[index + 1].rotation @ forces.force[index]
        assert_allclose(world, -masses[index:].sum() * model.gravity.linear, **SAME)


def test_the_lectures_formulas_for_revolute_joints_give_the_same():
    """The lecture's recursion word for word, with the I_i that its balance of moments has lost."""
    model = three_joint_arm()
    q, v, a = random_state(model, 4)
    axes, n = [np.array([0.0, 0, 1]), np.array([0.0, 1, 0]), np.array([0.0, 1, 0])], 3
    rotations = [pin.exp3(axis * angle) for axis, angle in zip(axes, q, strict=True)]  # R_i^(i-1)
    offsets = [model.jointPlacements[i + 1].translation for i in range(n)] + [np.zeros(3)]
    omega = alpha = np.zeros(3)
    gravity, states = model.gravity.linear, []
    end_acceleration = np.zeros(3)
    for i in range(n):
        inertia, to_link = model.inertias[i + 1], rotations[i].T
        omega = to_link @ omega + axes[i] * v[i]
        alpha = to_link @ alpha + axes[i] * a[i] + np.cross(omega, axes[i] * v[i])
        start = to_link @ end_acceleration
        gravity = to_link @ gravity
        to_end, to_centre = offsets[i + 1], inertia.lever
        end_acceleration = start + np.cross(alpha, to_end) + np.cross(omega, np.cross(omega, to_end))
        centre = start + np.cross(alpha, to_centre) + np.cross(omega, np.cross(omega, to_centre))
        states.append((inertia, omega, alpha, centre, gravity))
    force, moment, torque = np.zeros(3), np.zeros(3), np.zeros(n)
    for i in reversed(range(n)):
        inertia, omega, alpha, centre, gravity = states[i]
        outward = rotations[i + 1] if i + 1 < n else np.eye(3)
        next_force, next_moment = outward @ force, outward @ moment
        force = next_force + inertia.mass * centre - inertia.mass * gravity
        spin = inertia.inertia @ alpha + np.cross(omega, inertia.inertia @ omega)
        from_end = inertia.lever - offsets[i + 1]
        moment = next_moment - np.cross(force, inertia.lever) + np.cross(next_force, from_end) + spin
        torque[i] = axes[i] @ moment + model.armature[i] * a[i]
    forces = joint_forces(model, q, v, a)
    assert_allclose(forces.tau, torque, **SAME)
    assert_allclose(forces.force[0], force, **SAME)
    assert_allclose(forces.moment[0], moment, **SAME)


def test_derivatives_of_the_symbolic_function_are_pinocchios():
    model = named("ur5")
    q, v, a = random_state(model, 5)
    function = recursive_newton_euler(model)
    inputs = [function.sx_in(i) for i in range(3)]
    tau = function.call([*inputs, ca.SX(0, 1)])[0]
    slopes = ca.Function("slopes", inputs, [ca.jacobian(tau, symbol) for symbol in inputs])(q, v, a)
    data = model.createData()
    expected = pin.computeRNEADerivatives(model, data, q, v, a)
    for slope, reference in zip(slopes[:2], expected[:2], strict=True):
        assert_allclose(slope.full(), reference, **SAME)
    assert_allclose(slopes[2].full(), pin.crba(model, data, q), **SAME)


def test_a_function_is_built_once_for_the_content_of_a_model():
    model = robot("ur5")[0]
    heavier = model.copy()
    heavier.inertias[2] = pin.Inertia(9.0, np.zeros(3), np.eye(3))
    assert recursive_newton_euler(model) is recursive_newton_euler(model.copy())
    assert recursive_newton_euler(model) is not recursive_newton_euler(heavier)


def test_bad_input_is_refused():
    model = named("solo12")
    q, v, a = random_state(model, 0)
    with pytest.raises(InputError, match=r"q has shape \(3,\)"):
        joint_forces(model, q[:3], v, a)
    with pytest.raises(InputError, match=r"wrenches have shape"):
        joint_forces(model, q, v, a, frames=FEET, wrenches=np.zeros((1, 6)))
    with pytest.raises(InputError, match="no frame 'hoof'"):
        joint_forces(model, q, v, a, frames=["hoof"])
    with pytest.raises(InputError, match="0, 3, 6"):
        recursive_newton_euler(model, FEET, [3, 4])
    helical = pin.Model()
    helical.addJoint(0, pin.JointModelHX(0.1), pin.SE3.Identity(), "screw")
    with pytest.raises(UnsupportedJointError, match="'screw'"):
        recursive_newton_euler(helical)
