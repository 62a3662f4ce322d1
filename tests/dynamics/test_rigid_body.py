"""Every symbolic function against numeric Pinocchio."""

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.models import JOINT_KINDS, ROBOTS, TIP, hand_built, random_state, robot
from trajopt import _pinocchio
from trajopt.dynamics import contact_forward_dynamics, contact_inverse_dynamics, rigid_body
from trajopt.errors import InputError, UnsupportedJointError, VersionMismatchError
from trajopt.versions import check_versions, installed_version
from trajopt_library import robots

# Both sides evaluate the same formulas in double precision; entries near zero need an absolute part.
SAME = {"rtol": 1e-9, "atol": 1e-10}
# Central differences of step 1e-6 on values of order 1 to 1e3.
ROUNDING = 1e-14  # of configurations of order 1
DIFFERENCE_STEP = 1e-6
DIFFERENCE = {"rtol": 1e-5, "atol": 2e-5}

SEEDS = (0, 1)
MODELS = [*ROBOTS, *(f"joint:{kind}" for kind in JOINT_KINDS), "reduced"]
REFERENCES = {"world_aligned": pin.LOCAL_WORLD_ALIGNED, "local": pin.LOCAL, "world": pin.WORLD}


def reduced_talos() -> tuple[pin.Model, str]:
    model, frame = robot("talos")
    locked = [model.getJointId(name) for name in model.names if name.startswith(("arm", "torso", "head"))]
    return pin.buildReducedModel(model, locked, random_state(model, 5)[0]), frame


@pytest.fixture(params=MODELS)
def case(request) -> tuple[pin.Model, str]:
    if request.param == "reduced":
        return reduced_talos()
    kind = request.param.removeprefix("joint:")
    return hand_built(kind) if kind != request.param else robot(kind)


def evaluate(function: ca.Function, *arguments: np.ndarray) -> list[np.ndarray]:
    return [value.full() for value in function.call([ca.DM(argument) for argument in arguments])]


def assert_same(function: ca.Function, arguments: tuple, *expected: np.ndarray) -> None:
    for value, reference in zip(evaluate(function, *arguments), expected, strict=True):
        assert_allclose(value, np.reshape(reference, value.shape), **SAME)


def world_force_on_joints(model: pin.Model, q: np.ndarray, frame: str, wrench: np.ndarray) -> np.ndarray:
    index = model.getFrameId(frame)
    jacobian = pin.computeFrameJacobian(model, model.createData(), q, index, pin.LOCAL_WORLD_ALIGNED)
    return jacobian[: len(wrench)].T @ wrench


@pytest.mark.long
@pytest.mark.parametrize("seed", SEEDS)
def test_dynamics_equal_numeric_pinocchio(case, seed):
    model, _ = case
    data = model.createData()
    q, v, a = random_state(model, seed)
    assert_same(rigid_body.rnea(model), (q, v, a), pin.rnea(model, data, q, v, a))
    assert_same(rigid_body.bias_forces(model), (q, v), pin.nonLinearEffects(model, data, q, v))
    upper = np.triu(pin.crba(model, data, q))
    assert_same(rigid_body.mass_matrix(model), (q,), upper + np.triu(upper, 1).T)


@pytest.mark.parametrize("seed", SEEDS)
def test_fused_function_equals_numeric_pinocchio(case, seed):
    model, frame = case
    frames, sizes = [frame, model.frames[-1].name, frame, model.frames[1].name], [3, 6, 0, 3]
    data = model.createData()
    q, v, a = random_state(model, seed)
    w = np.random.default_rng(seed).uniform(-1, 1, sum(sizes))
    tau = pin.rnea(model, data, q, v, a)
    for name, wrench in zip(frames, np.split(w, np.cumsum(sizes)[:-1]), strict=True):
        tau = tau - world_force_on_joints(model, q, name, wrench)
    pin.forwardKinematics(model, data, q, v, a)
    pin.updateFramePlacements(model, data)
    indices = [model.getFrameId(name) for name in frames]
    aligned = pin.LOCAL_WORLD_ALIGNED
    velocity = [pin.getFrameVelocity(model, data, index, aligned).vector for index in indices]
    acceleration = [
        pin.getFrameClassicalAcceleration(model, data, index, aligned).vector for index in indices
    ]
    assert_same(
        rigid_body.fused(model, frames, sizes),
        (q, v, a, w),
        tau,
        np.transpose([data.oMf[index].rotation.ravel("F") for index in indices]),
        np.transpose([data.oMf[index].translation for index in indices]),
        np.transpose(velocity),
        np.transpose(acceleration),
    )


def test_fused_function_respects_the_models_gravity():
    model = robot("solo12")[0].copy()
    model.gravity.linear = np.array([1.0, -2.0, 3.0])
    q, v, a = random_state(model, 0)
    tau, _, _, _, acceleration = evaluate(rigid_body.fused(model, ["HR_FOOT"], [0]), q, v, a, np.zeros(0))
    data = model.createData()
    assert_allclose(tau.ravel(), pin.rnea(model, data, q, v, a), **SAME)
    pin.forwardKinematics(model, data, q, v, a)
    expected = pin.getFrameClassicalAcceleration(
        model, data, model.getFrameId("HR_FOOT"), pin.LOCAL_WORLD_ALIGNED
    )
    assert_allclose(acceleration.ravel(), expected.vector, **SAME)


@pytest.mark.long
@pytest.mark.parametrize("reference", REFERENCES)
def test_frame_functions_equal_numeric_pinocchio(case, reference):
    model, frame = case
    data, index, axes = model.createData(), model.getFrameId(frame), REFERENCES[reference]
    q, v, a = random_state(model, 2)
    pin.forwardKinematics(model, data, q, v, a)
    pin.updateFramePlacements(model, data)
    placement = data.oMf[index].copy()
    velocity = pin.getFrameVelocity(model, data, index, axes)
    acceleration = pin.getFrameClassicalAcceleration(model, data, index, axes)
    jacobian = pin.computeFrameJacobian(model, data, q, index, axes)
    assert_same(rigid_body.frame_placement(model, frame), (q,), placement.rotation, placement.translation)
    assert_same(rigid_body.frame_velocity(model, frame, reference), (q, v), velocity.vector)
    assert_same(rigid_body.frame_acceleration(model, frame, reference), (q, v, a), acceleration.vector)
    assert_same(rigid_body.frame_jacobian(model, frame, reference), (q,), jacobian)


@pytest.mark.long
@pytest.mark.parametrize("seed", SEEDS)
def test_centroidal_functions_and_energies_equal_numeric_pinocchio(case, seed):
    model, _ = case
    data = model.createData()
    q, v, a = random_state(model, seed)
    pin.centerOfMass(model, data, q, v)
    assert_same(rigid_body.centre_of_mass(model), (q, v), data.com[0], data.vcom[0])
    pin.computeCentroidalMomentumTimeVariation(model, data, q, v, a)
    assert_same(rigid_body.centroidal_momentum(model), (q, v), data.hg.vector)
    assert_same(rigid_body.centroidal_momentum_rate(model), (q, v, a), data.hg.vector, data.dhg.vector)
    upper = np.triu(pin.crba(model, data, q))
    kinetic = v @ (upper + np.triu(upper, 1).T) @ v / 2
    assert_same(rigid_body.kinetic_energy(model), (q, v), np.array(kinetic))
    assert_same(
        rigid_body.potential_energy(model), (q,), np.array(pin.computePotentialEnergy(model, data, q))
    )


@pytest.mark.parametrize("length", [1e-3, 0.05, 1.0, 1.7])
def test_integrate_and_difference_equal_numeric_pinocchio_at_any_length(case, length):
    model, _ = case
    q, v, _ = random_state(model, 3)
    step = length * v
    end = pin.integrate(model, q, step)
    assert_same(rigid_body.integrate(model), (q, step), end)
    assert_same(rigid_body.difference(model), (q, end), pin.difference(model, q, end))


@pytest.mark.parametrize("length", [0.0, 1e-12, 1e-6, 0.199, 0.201, 1.7])
def test_difference_undoes_integrate(case, length):
    model, _ = case
    q, v, _ = random_state(model, 6)
    end = rigid_body.integrate(model)(q, length * v)
    assert_allclose(
        rigid_body.difference(model)(q, end).full().ravel(), length * v, rtol=1e-12, atol=ROUNDING
    )


@pytest.mark.parametrize("length", [0.0, 1e-12, 0.05, 1.0])
def test_derivatives_of_integrate_equal_pinocchios_also_at_zero(case, length):
    model, _ = case
    q, v, _ = random_state(model, 4)
    step = length * v
    integrate, difference = rigid_body.integrate(model), rigid_body.difference(model)
    u = ca.SX.sym("u", model.nv)
    arrival = difference(pin.integrate(model, q, step), integrate(q, step + u))
    jacobian = ca.Function("jacobian", [u], [ca.jacobian(arrival, u)])
    expected = pin.dIntegrate(model, q, step, pin.ARG1)
    assert_allclose(jacobian(np.zeros(model.nv)).full(), expected, rtol=1e-7, atol=1e-7)


def test_second_derivatives_of_difference_are_finite_at_identity(case):
    model, _ = case
    q, _, _ = random_state(model, 4)
    q1 = ca.SX.sym("q1", model.nq)
    hessian = ca.hessian(ca.sum1(rigid_body.difference(model)(q, q1)), q1)[0]
    assert np.isfinite(ca.Function("hessian", [q1], [hessian])(q).full()).all()


@pytest.mark.parametrize("name", ["solo12", "kinova", "go2_planar"])
def test_jacobian_of_the_fused_function_equals_finite_differences(name):
    model, frame = robot(name)
    function = rigid_body.fused(model, [frame], [3])
    inputs = [function.sx_in(i) for i in range(function.n_in())]
    outputs = ca.vertcat(*(ca.vec(output) for output in function.call(inputs)))
    values = ca.Function("values", [ca.vertcat(*inputs)], [outputs])
    point = np.concatenate([*random_state(model, 1), [1.0, 2.0, 3.0]])
    jacobian = values.jacobian()(point, 0).full()
    for entry, step in enumerate(DIFFERENCE_STEP * np.eye(len(point))):
        slope = (values(point + step) - values(point - step)).full().ravel() / (2 * DIFFERENCE_STEP)
        assert_allclose(jacobian[:, entry], slope, **DIFFERENCE)


def test_a_function_is_built_once_for_the_content_of_a_model():
    model, _ = robot("ur5")
    heavier = model.copy()
    heavier.inertias[2] = pin.Inertia(9.0, np.zeros(3), np.eye(3))
    assert rigid_body.rnea(model) is rigid_body.rnea(model.copy())
    assert rigid_body.rnea(model) is not rigid_body.rnea(heavier)


@pytest.mark.parametrize("joint", [pin.JointModelUniversal(1, 0, 0, 0, 1, 0), pin.JointModelHX(0.1)])
def test_unsupported_joint_is_named_with_its_kind(joint):
    model = pin.Model()
    model.addJoint(0, joint, pin.SE3.Identity(), "wrist")
    with pytest.raises(UnsupportedJointError, match=r"'wrist' is of kind (Universal|HX)"):
        rigid_body.rnea(model)
    with pytest.raises(UnsupportedJointError):
        rigid_body.integrate(model)


def test_wrong_frame_name_lists_close_matches():
    with pytest.raises(InputError, match=r"no frame 'HR_FOOOT'.*HR_FOOT"):
        rigid_body.fused(robot("solo12")[0], ["HR_FOOOT"], [3])
    with pytest.raises(InputError, match=TIP):
        rigid_body.frame_jacobian(hand_built("RX")[0], "no such frame")


def test_wrong_wrench_size_and_reference_are_refused():
    model, frame = robot("solo12")
    with pytest.raises(InputError, match="0, 3, 6"):
        rigid_body.fused(model, [frame], [4])
    with pytest.raises(InputError, match="0, 3, 6"):
        rigid_body.fused(model, [frame], [3, 3])
    with pytest.raises(InputError, match="world_aligned, local, world"):
        rigid_body.frame_velocity(model, frame, "body")


def test_wheels_of_other_versions_are_refused_in_one_line():
    check_versions({"casadi": installed_version("casadi")})
    with pytest.raises(
        VersionMismatchError, match=r"casadi .*against casadi 0\.0\.1; run: .*casadi==0\.0\.1"
    ):
        check_versions({"casadi": "0.0.1"})
    with pytest.raises(VersionMismatchError, match="no-such-wheel none"):
        check_versions({"no-such-wheel": "1"})


# Rows of a robot of 90 kg: 1e3 N and 1e3 rad/s^2.
AGREES = {"rtol": 1e-8, "atol": 1e-7}
HELD = {"solo12": {"FL_FOOT": 3, "FR_FOOT": 3, "HR_FOOT": 3}, "talos": {"left_sole_link": 6}}


@pytest.mark.parametrize("name", HELD)
def test_symbolic_dynamics_in_contact_are_pinocchios(name):
    robot, held = robots.load(name), HELD[name]
    model, random = robot.model, np.random.default_rng(0)
    v, tau = 0.3 * random.normal(size=(2, model.nv))
    tau[:6] = 0.0
    a, f = contact_forward_dynamics(model, held)(robot.reference, v, tau)
    data = model.createData()
    mass, bias = pin.crba(model, data, robot.reference), pin.nle(model, data, robot.reference, v)
    pin.computeJointJacobians(model, data, robot.reference)
    pin.forwardKinematics(model, data, robot.reference, v, np.zeros(model.nv))
    rows, drift = [], []
    for frame, size in held.items():
        number, axes = model.getFrameId(frame), pin.LOCAL_WORLD_ALIGNED
        pin.updateFramePlacement(model, data, number)
        rows.append(pin.getFrameJacobian(model, data, number, axes)[:size])
        drift.append(pin.getFrameClassicalAcceleration(model, data, number, axes).vector[:size])
    jacobian, drift = np.vstack(rows), np.concatenate(drift)
    a, f = np.array(a).ravel(), np.array(f).ravel()
    assert_allclose(mass @ a + bias, tau + jacobian.T @ f, **AGREES)
    assert_allclose(jacobian @ a + drift, 0.0, atol=1e-9)
    torque, wrench = contact_inverse_dynamics(model, held, robot.actuated_rows.tolist())(
        robot.reference, v, a
    )
    expected = np.linalg.pinv(np.hstack([jacobian.T, np.eye(model.nv)[:, 6:]])) @ (mass @ a + bias)
    assert_allclose(np.array(wrench).ravel(), expected[: len(jacobian)], **AGREES)
    assert_allclose(np.array(torque).ravel(), expected[len(jacobian) :], **AGREES)


def test_it_can_be_differentiated_and_names_what_is_unknown():
    robot = robots.load("solo12")
    function = contact_forward_dynamics(robot.model, {"FL_FOOT": 3})
    q, v, tau = (ca.MX.sym(name, function.size1_in(name)) for name in ("q", "v", "tau"))
    slope = ca.Function("slope", [q, v, tau], [ca.jacobian(function(q, v, tau)[0], tau)])
    still = np.zeros(robot.nv)
    assert np.isfinite(np.array(slope(robot.reference, still, still))).all()
    with pytest.raises(InputError, match="nowhere"):
        contact_forward_dynamics(robot.model, {"nowhere": 3})


def joint(parent: int = 0, kind: str = "RX") -> _pinocchio.Joint:
    made = _pinocchio.Joint()
    made.name, made.kind, made.parent, made.mass = "joint", kind, parent, 1.0
    made.rotation = made.inertia = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    made.translation = made.axis = made.lever = [0.0] * 3
    return made


def description(*joints: _pinocchio.Joint, armature: int | None = None) -> _pinocchio.Description:
    made = _pinocchio.Description()
    made.joints, made.gravity = list(joints), [0.0, 0.0, -9.81]
    made.armature = [0.0] * (len(joints) if armature is None else armature)
    return made


def frame(joint: int, wrench_size: int = 0) -> _pinocchio.Frame:
    made = _pinocchio.Frame()
    made.joint, made.wrench_size = joint, wrench_size
    made.rotation, made.translation = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], [0.0] * 3
    return made


@pytest.mark.parametrize("number", [-1, 2, 1000, 2**31 - 1])
def test_a_frame_on_a_joint_that_is_not_there_is_refused(number: int) -> None:
    robot, wrong = description(joint()), frame(number)
    for function in (_pinocchio.frame_velocity, _pinocchio.frame_acceleration):
        with pytest.raises(ValueError, match="the joint of a frame is"):
            function(robot, wrong, "world_aligned")
    with pytest.raises(ValueError, match="the joint of a frame is"):
        _pinocchio.frame_placement(robot, wrong)
    with pytest.raises(ValueError, match="the joint of a frame is"):
        _pinocchio.fused(robot, [frame(1), wrong])


def test_a_wrench_of_another_size_and_a_reference_that_is_none_are_refused() -> None:
    with pytest.raises(ValueError, match="wrench size is 4"):
        _pinocchio.fused(description(joint()), [frame(1, wrench_size=4)])
    with pytest.raises(ValueError, match="reference 'here'"):
        _pinocchio.frame_velocity(description(joint()), frame(1), "here")


@pytest.mark.parametrize("parent", [-1, 1, 7])
def test_a_joint_that_does_not_come_after_its_parent_is_refused(parent: int) -> None:
    with pytest.raises(ValueError, match="the parent of joint 'joint' is"):
        _pinocchio.mass_matrix(description(joint(parent)))


@pytest.mark.parametrize("count", [0, 2])
def test_a_wrong_number_of_armatures_is_refused(count: int) -> None:
    with pytest.raises(ValueError, match=f"armature has {count} entries"):
        _pinocchio.mass_matrix(description(joint(), armature=count))
