"""Gimbal lock of virtual joints is measured, found between samples, and reported; a quaternion has none."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import trajopt
from tests.support.problems import hop, hopper
from trajopt.certify.report import AT_POINTS
from trajopt.dynamics.base_joint import ORDERS
from trajopt.dynamics.virtual_base import (
    LEAST_MARGIN,
    from_free_flyer,
    gimbal_margin,
    gimbal_margin_along,
    margin_of,
    rotation_jacobian,
    rotation_of,
)
from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.reduced.base_conversion import with_virtual_base
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Phase, Schedule
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
