"""Coordinates of every joint against numeric Pinocchio: rotations, rates, nodes."""

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.models import JOINT_KINDS, hand_built, random_state, robot
from trajopt.dynamics.manifold import Coordinates
from trajopt.dynamics.rotations import body_rates, exp_quaternion, right_jacobian, rotation_matrix
from trajopt.errors import UnsupportedJointError

# A few roundings of numbers of order one.
ROUNDING = 1e-14
# Accuracy that the module states for its series: at most pi, and at most 2 pi.
TO_PI, TO_TWO_PI = 2e-15, 1e-11
# Fourth-order differences of step 2e-3 on curves of order one: h^4 = 2e-11, rounding 1e-16 / h.
STEP = 2e-3
DIFFERENCES = {"rtol": 1e-8, "atol": 1e-8}
ANGLES = (0.0, 1e-160, 1e-12, 1e-8, 1e-4, 1e-2, 1.0, 3.0, np.pi - 1e-9, np.pi)
MODELS = [*(f"joint:{kind}" for kind in JOINT_KINDS), "solo12", "go2_planar"]

THETA = ca.SX.sym("theta", 3)
EXP = ca.Function("exp", [THETA], [exp_quaternion(THETA)])
JACOBIAN = ca.Function("jacobian", [THETA], [right_jacobian(THETA)])


def model_of(name: str) -> pin.Model:
    kind = name.removeprefix("joint:")
    return (hand_built(kind) if kind != name else robot(name))[0]


def directions(count: int) -> np.ndarray:
    vectors = np.random.default_rng(3).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


@pytest.mark.parametrize("angle", ANGLES)
def test_rotation_and_right_jacobian_equal_pinocchio(angle):
    for axis in directions(5):
        theta = angle * axis
        quaternion = np.array(EXP(theta)).ravel()
        assert_allclose(np.linalg.norm(quaternion), 1.0, atol=ROUNDING)
        assert_allclose(pin.Quaternion(quaternion).toRotationMatrix(), pin.exp3(theta), atol=ROUNDING)
        assert_allclose(np.array(JACOBIAN(theta)), pin.Jexp3(theta), atol=ROUNDING)


@pytest.mark.parametrize("angle", [1.0, np.pi, 5.0, 2 * np.pi])
def test_series_are_as_accurate_as_the_module_states(angle):
    accuracy = TO_PI if angle <= np.pi else TO_TWO_PI
    for axis in directions(5):
        exact = np.append(np.sin(angle / 2) * axis, np.cos(angle / 2))
        assert_allclose(np.array(EXP(angle * axis)).ravel(), exact, atol=accuracy)
        cross = pin.skew(axis)
        jacobian = (
            np.eye(3) - (1 - np.cos(angle)) / angle * cross + (1 - np.sin(angle) / angle) * cross @ cross
        )
        assert_allclose(np.array(JACOBIAN(angle * axis)), jacobian, atol=accuracy * angle**2)


def test_derivatives_of_the_rotation_at_zero_are_exact():
    quaternion = exp_quaternion(THETA)
    first = ca.Function("first", [THETA], [ca.jacobian(quaternion, THETA)])
    assert_allclose(np.array(first(np.zeros(3))), np.vstack([np.eye(3) / 2, np.zeros(3)]), atol=ROUNDING)
    curvature = [np.zeros((3, 3))] * 3 + [-np.eye(3) / 4]
    for i in range(4):
        second = ca.Function("second", [THETA], [ca.hessian(quaternion[i], THETA)[0]])
        assert_allclose(np.array(second(np.zeros(3))), curvature[i], atol=ROUNDING)


def test_derivatives_of_the_right_jacobian_at_zero_are_exact():
    jacobian, basis = right_jacobian(THETA), [pin.skew(axis) for axis in np.eye(3)]
    first = ca.Function("first", [THETA], [ca.jacobian(ca.vec(jacobian), THETA)])
    assert_allclose(
        np.array(first(np.zeros(3))), -0.5 * np.array([b.T.ravel() for b in basis]).T, atol=ROUNDING
    )
    for row in range(3):
        for column in range(3):
            second = ca.Function("second", [THETA], [ca.hessian(jacobian[row, column], THETA)[0]])
            exact = [[(a @ b + b @ a)[row, column] / 6 for a in basis] for b in basis]
            assert_allclose(np.array(second(np.zeros(3))), exact, atol=ROUNDING)


def test_body_rates_and_their_second_derivatives_are_finite_at_zero():
    symbols = [THETA, ca.SX.sym("d", 3), ca.SX.sym("dd", 3)]
    stacked = ca.vertcat(*symbols)
    for rate in ca.vertsplit(ca.vertcat(*body_rates(*symbols))):
        second = ca.Function("second", symbols, [ca.hessian(rate, stacked)[0]])
        assert np.all(np.isfinite(np.array(second(np.zeros(3), np.ones(3), np.ones(3)))))


class Curve:
    """Local coordinates as a cubic in time, and Pinocchio's (q, v, a) along it."""

    def __init__(self, model: pin.Model, seed: int) -> None:
        generator = np.random.default_rng(seed)
        self.model, self.coordinates = model, Coordinates(model)
        self.coefficients = generator.uniform(-1, 1, (4, model.nv))
        rotations = generator.normal(size=(self.coordinates.n_rotations, 4))
        self.rotations = (rotations / np.linalg.norm(rotations, axis=1)[:, None]).reshape(1, -1)

    def local(self, t: float) -> list[np.ndarray]:
        powers = np.array([[1, t, t**2 / 2, t**3 / 6], [0, 1, t, t**2 / 2], [0, 0, 1, t]])
        return [row[None] for row in powers @ self.coefficients]

    def __call__(self, t: float) -> tuple[np.ndarray, ...]:
        return tuple(part[0] for part in self.coordinates.local_to_pinocchio(self.rotations, *self.local(t)))


def fourth_order(values: list[np.ndarray]) -> np.ndarray:
    """Derivative at the middle from values at -2, -1, 1, 2 steps."""
    return (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * STEP)


@pytest.mark.parametrize("name", MODELS)
def test_velocity_and_acceleration_are_derivatives_of_the_configuration(name):
    model, t = model_of(name), 0.7
    curve = Curve(model, 5)
    q, v, a = curve(t)
    assert pin.isNormalized(model, q, ROUNDING)
    around = [curve(t + steps * STEP) for steps in (-2, -1, 1, 2)]
    assert_allclose(v, fourth_order([pin.difference(model, q, other[0]) for other in around]), **DIFFERENCES)
    assert_allclose(a, fourth_order([other[1] for other in around]), **DIFFERENCES)


@pytest.mark.parametrize("name", MODELS)
def test_configuration_and_velocity_survive_the_way_through_a_node(name):
    model = model_of(name)
    coordinates = Coordinates(model)
    for seed in range(3):
        q, v, _ = random_state(model, seed)
        node = coordinates.node_from_pinocchio(q, v)
        assert node.shape == (coordinates.n_node,)
        back_q, back_v = coordinates.node_to_pinocchio(node)
        assert_allclose(back_q[0], q, atol=ROUNDING)
        assert_allclose(back_v[0], v, atol=ROUNDING)


@pytest.mark.parametrize("name", MODELS)
def test_acceleration_survives_the_way_through_local_coordinates(name):
    model = model_of(name)
    curve = Curve(model, 7)
    curve.coefficients[0][curve.coordinates.rotation_index] = 0.0
    q, v, a = curve(0.0)
    assert_allclose(
        curve.coordinates.acceleration_from_pinocchio(q, v, a), curve.local(0.0)[2][0], atol=10 * ROUNDING
    )


@pytest.mark.parametrize("name", ["solo12", "joint:Spherical"])
def test_next_node_has_the_rotation_and_rate_of_the_interval_end(name):
    model = model_of(name)
    curve = Curve(model, 9)
    q, v, _ = curve(0.5)
    xi, dxi, _ = curve.local(0.5)
    index = curve.coordinates.rotation_index
    symbols = [ca.SX.sym("r", 4), ca.SX.sym("theta", 3), ca.SX.sym("dtheta", 3)]
    ends = ca.Function("end", symbols, list(curve.coordinates.next_rotations(*symbols)))
    quaternion, omega = (
        np.array(part).ravel() for part in ends(curve.rotations[0], xi[0, index], dxi[0, index])
    )
    joint = next(joint for joint in curve.coordinates.joints if joint.rotation is not None)
    assert_allclose(quaternion, q[joint.q][-4:], atol=ROUNDING)
    assert_allclose(omega, v[joint.rotation], atol=ROUNDING)


def test_rotation_matrix_equals_pinocchio():
    quaternion = pin.Quaternion(np.array([0.1, -0.5, 0.7, 0.3]) / np.sqrt(0.84))
    symbol = ca.SX.sym("quaternion", 4)
    matrix = ca.Function("matrix", [symbol], [rotation_matrix(symbol)])
    assert_allclose(np.array(matrix(quaternion.coeffs())), quaternion.toRotationMatrix(), atol=ROUNDING)


@pytest.mark.parametrize("name", ["solo12", "joint:Spherical", "joint:RUBZ", "go2_planar"])
def test_continued_node_is_the_same_configuration_next_to_the_previous(name):
    model = model_of(name)
    coordinates = Coordinates(model)
    q, v, _ = random_state(model, 1)
    node = coordinates.node_from_pinocchio(q, v)
    previous = node.copy()
    previous[: 4 * coordinates.n_rotations] *= -1
    whole_turns = [
        4 * coordinates.n_rotations + int(np.searchsorted(coordinates.additive_index, joint.v.stop - 1))
        for joint in coordinates.joints
        if joint.kind in ("planar", "continuous")
    ]
    previous[whole_turns] += 3 * 2 * np.pi + 0.4
    continued = coordinates.continued(node, previous)
    assert np.max(np.abs(continued - previous)) <= 0.4 + ROUNDING * 10
    for part, expected in zip(coordinates.node_to_pinocchio(continued), (q, v), strict=True):
        joint = next((j for j in coordinates.joints if j.kind == "freeflyer" or j.kind == "spherical"), None)
        part = part[0]
        if joint is not None and len(part) == model.nq:
            part[joint.q][-4:] *= np.sign(part[joint.q][-4:] @ expected[joint.q][-4:])
        assert_allclose(part, expected, atol=10 * ROUNDING)


def composite_model() -> pin.Model:
    model = pin.Model()
    composite = pin.JointModelComposite()
    composite.addJoint(pin.JointModelRX(), pin.SE3.Identity())
    composite.addJoint(pin.JointModelRY(), pin.SE3.Identity())
    model.addJoint(0, composite, pin.SE3.Identity(), "shoulder")
    return model


def test_composite_joint_is_refused_by_name():
    with pytest.raises(UnsupportedJointError, match=r"'shoulder'.*supported: free-flyer") as refused:
        Coordinates(composite_model())
    assert refused.value.joint == "shoulder"


def test_mimic_joint_is_refused_by_name():
    model = pin.Model()
    leader = model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "leader")
    follower = model.addJoint(leader, pin.JointModelRX(), pin.SE3.Identity(), "follower")
    mimicking = pin.transformJointIntoMimic(model, leader, follower, 2.0, 0.0)
    with pytest.raises(UnsupportedJointError, match="'follower'"):
        Coordinates(mimicking)


@pytest.mark.parametrize("name", MODELS)
def test_every_coordinate_is_either_additive_or_of_a_rotation(name):
    coordinates = Coordinates(model_of(name))
    together = np.sort(np.concatenate([coordinates.rotation_index, coordinates.additive_index]))
    assert_allclose(together, np.arange(coordinates.nv))
    assert (
        coordinates.n_node == 4 * coordinates.n_rotations + len(coordinates.additive_index) + coordinates.nv
    )
