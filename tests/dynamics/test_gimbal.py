"""Coordinates of every joint against numeric Pinocchio, and gimbal lock of virtual joints."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.models import JOINT_KINDS, hand_built, random_state, robot
from tests.support.problems import hop, hopper
from trajopt import InputError, Phase, Problem, Robot, Schedule
from trajopt.certify.report import AT_POINTS
from trajopt.dynamics import ORDERS, Coordinates
from trajopt.dynamics.rotations import body_rates, exp_quaternion, right_jacobian, rotation_matrix
from trajopt.dynamics.virtual_base import (
    LEAST_MARGIN,
    from_free_flyer,
    gimbal_margin,
    gimbal_margin_along,
    margin_of,
    rotation_jacobian,
    rotation_of,
)
from trajopt.errors import UnsupportedJointError
from trajopt.reduced import with_virtual_base
from trajopt.solvers.status import Status
from trajopt_library import problems, robots

ROUNDING = 1e-12
# Objectives of the same flip on two bases, solved to 1e-6 and to the order of the scheme.
SAME_OBJECTIVE = 1e-4

every_order = pytest.mark.parametrize("order", ORDERS)
RIGHT = np.pi / 2


def virtual(order: str = "ZYX") -> Robot:
    return hopper().with_virtual_base(order)


def pitching(middle: np.ndarray) -> np.ndarray:
    """Configurations (n, nq) of the virtual hopper with these middle angles."""
    q = np.tile(virtual().reference, (len(middle), 1))
    q[:, 4] = middle
    return q


@every_order
def test_the_margin_is_the_least_singular_value_of_the_jacobian(order):
    for angles in np.random.default_rng(0).uniform(-10, 10, (50, 3)):
        singular = np.linalg.svd(rotation_jacobian(order, angles))[1]
        assert margin_of(angles[1]) == pytest.approx(singular[-1], abs=1e-7)  # a root of rounding near 0
        expected = np.sqrt([1 + abs(np.sin(angles[1])), 1.0])
        np.testing.assert_allclose(singular[:2], expected, atol=ROUNDING)
        assert abs(np.linalg.det(rotation_jacobian(order, angles))) == pytest.approx(abs(np.cos(angles[1])))


def test_the_margin_vanishes_at_right_angles_alone_and_keeps_its_digits_there():
    np.testing.assert_allclose(margin_of(np.array([RIGHT, -RIGHT, 5 * RIGHT])), 0, atol=1e-15)
    np.testing.assert_allclose(margin_of(np.array([0.0, np.pi, -7 * np.pi])), 1, atol=ROUNDING)
    assert margin_of(RIGHT - 1e-9) == pytest.approx(1e-9 / np.sqrt(2), rel=1e-6)


def test_rates_of_the_angles_reach_the_angular_velocity_over_the_margin():
    angles = np.array([0.3, RIGHT - 0.1, -0.4])
    jacobian = rotation_jacobian("ZYX", angles)
    hardest = np.linalg.svd(jacobian)[0][:, -1]
    rates = np.linalg.solve(jacobian, hardest)
    assert np.linalg.norm(rates) == pytest.approx(1 / margin_of(angles[1]), rel=1e-9)


def test_the_mass_matrix_is_singular_in_lock_and_the_free_flyers_is_not():
    robot = virtual()
    conditions = []
    for model, q in ((robot.model, pitching(np.array([RIGHT]))[0]), (hopper().model, hopper().reference)):
        conditions.append(np.linalg.cond(pin.crba(model, model.createData(), q)))
    assert conditions[0] > 1e14
    assert conditions[1] < 1e6


def test_the_margin_of_configurations_is_their_least():
    model = virtual().model
    found = gimbal_margin(model, pitching(np.array([0.0, 1.2, -0.5])))
    assert found == pytest.approx(np.sqrt(1 - np.sin(1.2)))
    assert gimbal_margin(hopper().model, hopper().reference) is None


def along(t: list[float], middle: list[float], rate: list[float]) -> float | None:
    q, v = pitching(np.array(middle)), np.zeros((len(t), virtual().nv))
    v[:, 4] = rate
    return gimbal_margin_along(virtual().model, np.array(t), q, v)


def test_a_lock_passed_between_samples_is_found():
    assert along([0.0, 0.1], [1.2, 1.9], [7.0, 7.0]) == 0
    assert along([0.0, 0.1], [-1.2, -1.9], [-7.0, -7.0]) == 0
    assert along([0.0, 0.1], [-1.2, 1.2], [24.0, 24.0]) == pytest.approx(margin_of(1.2))


def test_an_overshoot_between_samples_is_found_by_their_rates():
    """The cubic of 1.5 to 1.5 rad with rates +-4 rad/s rises by 0.1 rad in between: h rate / 4."""
    assert along([0.0, 0.1], [1.5, 1.5], [4.0, -4.0]) == 0
    below = along([0.0, 0.1], [1.3, 1.3], [4.0, -4.0])
    assert below == pytest.approx(margin_of(1.4))
    assert along([0.0, 0.1], [1.3, 1.3], [0.0, 0.0]) == pytest.approx(margin_of(1.3))


def test_samples_at_one_time_and_jumps_of_velocity_do_no_harm():
    assert along([0.0, 0.1, 0.1, 0.2], [0.0, 0.1, 0.1, 0.2], [1, 1, -30, 1]) > 0.5
    assert along([0.0], [0.4], [1.0]) == pytest.approx(margin_of(0.4))


@every_order
def test_a_reference_in_lock_is_refused_in_one_line(order):
    floating = hopper()
    q = floating.reference.copy()
    for middle, refused in ((RIGHT, True), (RIGHT - 0.05, True), (RIGHT - 0.2, False)):
        q[3:7] = pin.Quaternion(rotation_of(order, [0.1, middle, 0.2])).coeffs()
        turned = replace(floating, reference=q)
        if refused:
            with pytest.raises(InputError, match=r"in gimbal lock: margin 0\.0.*base='freeflyer'"):
                turned.with_virtual_base(order)
        else:
            assert gimbal_margin(turned.with_virtual_base(order).model, q[:-1] * 0) == 1


def test_a_problem_that_starts_in_lock_is_refused():
    q = hopper().reference.copy()
    q[2] += 0.5
    q[3:7] = pin.Quaternion(rotation_of("ZYX", [0.3, RIGHT, 0.0])).coeffs()
    with pytest.raises(InputError, match="problem 'hop' starts in gimbal lock"):
        with_virtual_base(replace(thrown(), initial_q=q, initial_v=np.zeros(8)))


def test_velocities_in_lock_are_refused_and_postures_are_not():
    q, still = hopper().reference.copy(), np.zeros(8)
    q[3:7] = pin.Quaternion(rotation_of("ZYX", [0.3, RIGHT, 0.0])).coeffs()
    found, _, _ = from_free_flyer("ZYX", q, still, still)
    np.testing.assert_allclose(found[3:6], [0.3, RIGHT, 0.0], atol=1e-7)
    turning = still.copy()
    turning[3] = 1.0
    with pytest.raises(InputError, match="turns in gimbal lock"):
        from_free_flyer("ZYX", q, turning, still)


def thrown() -> Problem:
    """The hopper thrown up, pitching over through a right angle."""
    robot = hopper()
    v = np.zeros(robot.nv)
    v[2], v[4] = 2.5, 4.5
    q = robot.reference.copy()
    q[2] += 0.5
    flight = Schedule((Phase(name="flight", duration=0.5),))
    kept = ("torque_cost", "acceleration_cost", "velocity_cost")
    terms = tuple(term for term in hop().terms if term.name in kept)
    return hop(schedule=flight, initial_q=q, initial_v=v, terms=terms, guess=tumbling(robot, q, v))


def tumbling(robot: Robot, q: np.ndarray, v: np.ndarray):
    def guess(t: float) -> np.ndarray:
        moved = np.array(pin.integrate(robot.model, q, np.concatenate([np.zeros(3), v[3:] * t])))
        moved[2] += v[2] * t - 9.81 * t * t / 2
        return moved

    return guess


def test_a_converged_plan_through_the_lock_is_no_success():
    """In the sagittal plane angles pass the lock without noticing: the solver converges, the status tells."""
    problem = thrown()
    turning = trajopt.solve(problem, intervals=12)
    assert turning.converged
    assert trajopt.check(turning).gimbal_margin is None
    assert turning.statistics.gimbal_margin is None
    solution = trajopt.solve(with_virtual_base(problem), intervals=12)
    assert (solution.statistics.status, solution.success) == (Status.SINGULAR_BASE.word, False)
    assert solution.statistics.gimbal_margin == 0
    assert solution.statistics.max_violation < 1e-5
    assert "use base='freeflyer'" in solution.statistics.advice
    report = trajopt.check(solution)
    assert report.gimbal_margin == 0
    assert "gimbal_margin" in report.failures(AT_POINTS)
    assert "margin to gimbal lock" in str(report)
    other = trajopt.solve(with_virtual_base(problem, "YXZ"), intervals=12)
    assert other.converged, other.statistics.advice
    assert other.statistics.gimbal_margin > 0.9


@pytest.mark.long
def test_half_a_flip_solves_with_the_quaternion():
    flip = problems.load("solo12-flip")
    solution = trajopt.solve(flip, intervals=30)
    assert solution.converged, solution.statistics.advice
    assert solution.statistics.iterations <= 60
    assert trajopt.check(solution).within(AT_POINTS)
    rotation = pin.Quaternion(*solution.q[-1][[6, 3, 4, 5]]).toRotationMatrix()
    assert rotation[2, 0] == pytest.approx(np.sin(np.radians(110)), abs=1e-5)  # how far the nose is up
    assert rotation[2, 2] < 0  # upside down
    heights = solution.q[:, 2]
    assert heights[-1] >= flip.robot.reference[2] + 0.1 - 1e-5


@pytest.mark.long
@pytest.mark.parametrize("pitch", [0.5, 3.0])
@pytest.mark.parametrize("yaw", [-1.2, 0.0])
def test_flips_of_other_angles_solve_from_their_own_guess(pitch, yaw):
    flip = problems.load("solo12-flip", pitch=pitch, yaw=yaw)
    solution = trajopt.solve(flip, intervals=20)
    assert solution.converged, solution.statistics.advice
    assert solution.statistics.iterations <= 60


@pytest.mark.slow
def test_half_a_flip_fails_with_yaw_pitch_roll_and_agrees_with_another_order():
    turning = trajopt.solve(problems.load("solo12-flip"), intervals=30)
    failed = trajopt.solve(problems.load("solo12-flip", base="virtual"), intervals=30, max_iterations=150)
    assert not failed.success
    assert failed.statistics.gimbal_margin < LEAST_MARGIN
    assert "gimbal_margin" in trajopt.check(failed).failures(AT_POINTS)
    other = trajopt.solve(problems.load("solo12-flip", base="virtual", order="YXZ"), intervals=30)
    assert other.converged, other.statistics.advice
    assert other.statistics.objective == pytest.approx(turning.statistics.objective, rel=SAME_OBJECTIVE)
    assert trajopt.check(other).within(AT_POINTS)


def test_the_solo12_that_stands_is_far_from_the_lock():
    assert robots.load("solo12").with_virtual_base().base == "virtual"
    assert gimbal_margin(virtual().model, virtual().reference) == 1


# A few roundings of numbers of order one.
MANIFOLD_ROUNDING = 1e-14
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
        assert_allclose(np.linalg.norm(quaternion), 1.0, atol=MANIFOLD_ROUNDING)
        assert_allclose(
            pin.Quaternion(quaternion).toRotationMatrix(), pin.exp3(theta), atol=MANIFOLD_ROUNDING
        )
        assert_allclose(np.array(JACOBIAN(theta)), pin.Jexp3(theta), atol=MANIFOLD_ROUNDING)


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
    assert_allclose(
        np.array(first(np.zeros(3))), np.vstack([np.eye(3) / 2, np.zeros(3)]), atol=MANIFOLD_ROUNDING
    )
    curvature = [np.zeros((3, 3))] * 3 + [-np.eye(3) / 4]
    for i in range(4):
        second = ca.Function("second", [THETA], [ca.hessian(quaternion[i], THETA)[0]])
        assert_allclose(np.array(second(np.zeros(3))), curvature[i], atol=MANIFOLD_ROUNDING)


def test_derivatives_of_the_right_jacobian_at_zero_are_exact():
    jacobian, basis = right_jacobian(THETA), [pin.skew(axis) for axis in np.eye(3)]
    first = ca.Function("first", [THETA], [ca.jacobian(ca.vec(jacobian), THETA)])
    assert_allclose(
        np.array(first(np.zeros(3))), -0.5 * np.array([b.T.ravel() for b in basis]).T, atol=MANIFOLD_ROUNDING
    )
    for row in range(3):
        for column in range(3):
            second = ca.Function("second", [THETA], [ca.hessian(jacobian[row, column], THETA)[0]])
            exact = [[(a @ b + b @ a)[row, column] / 6 for a in basis] for b in basis]
            assert_allclose(np.array(second(np.zeros(3))), exact, atol=MANIFOLD_ROUNDING)


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
    assert pin.isNormalized(model, q, MANIFOLD_ROUNDING)
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
        assert_allclose(back_q[0], q, atol=MANIFOLD_ROUNDING)
        assert_allclose(back_v[0], v, atol=MANIFOLD_ROUNDING)


@pytest.mark.parametrize("name", MODELS)
def test_acceleration_survives_the_way_through_local_coordinates(name):
    model = model_of(name)
    curve = Curve(model, 7)
    curve.coefficients[0][curve.coordinates.rotation_index] = 0.0
    q, v, a = curve(0.0)
    assert_allclose(
        curve.coordinates.acceleration_from_pinocchio(q, v, a),
        curve.local(0.0)[2][0],
        atol=10 * MANIFOLD_ROUNDING,
    )


@pytest.mark.parametrize("name", ["solo12", "joint:Spherical"])
def test_next_node_has_the_rotation_and_rate_of_the_interval_end(name):
    model = model_of(name)
    curve = Curve(model, 9)
    q, v, _ = curve(0.5)
    xi, dxi, _ = curve.local(0.5)
    index = curve.coordinates.rotation_index
    symbols = [ca.SX.sym("r", 4), ca.SX.sym("theta", 3), ca.SX.sym("dtheta", 3)]
    ends = ca.Function("end", symbols, curve.coordinates.next_rotations(*symbols, 0 * symbols[2])[:2])
    quaternion, omega = (
        np.array(part).ravel() for part in ends(curve.rotations[0], xi[0, index], dxi[0, index])
    )
    joint = next(joint for joint in curve.coordinates.joints if joint.rotation is not None)
    assert_allclose(quaternion, q[joint.q][-4:], atol=MANIFOLD_ROUNDING)
    assert_allclose(omega, v[joint.rotation], atol=MANIFOLD_ROUNDING)


def test_rotation_matrix_equals_pinocchio():
    quaternion = pin.Quaternion(np.array([0.1, -0.5, 0.7, 0.3]) / np.sqrt(0.84))
    symbol = ca.SX.sym("quaternion", 4)
    matrix = ca.Function("matrix", [symbol], [rotation_matrix(symbol)])
    assert_allclose(
        np.array(matrix(quaternion.coeffs())), quaternion.toRotationMatrix(), atol=MANIFOLD_ROUNDING
    )


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
    assert np.max(np.abs(continued - previous)) <= 0.4 + MANIFOLD_ROUNDING * 10
    for part, expected in zip(coordinates.node_to_pinocchio(continued), (q, v), strict=True):
        joint = next((j for j in coordinates.joints if j.kind == "freeflyer" or j.kind == "spherical"), None)
        part = part[0]
        if joint is not None and len(part) == model.nq:
            part[joint.q][-4:] *= np.sign(part[joint.q][-4:] @ expected[joint.q][-4:])
        assert_allclose(part, expected, atol=10 * MANIFOLD_ROUNDING)


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
