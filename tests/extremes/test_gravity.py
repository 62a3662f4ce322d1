"""Gravity of 0, of a small body, of the Moon and of 20 m/s^2."""

from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.extremes.changed_robots import made, robot_file, with_gravity
from tests.extremes.motions import stand, turn_over
from tests.extremes.outcomes import Failed, Refused, Solved, assert_outcome
from trajopt.solvers.status import Status
from trajopt_library import robots

# Momenta over mass times length (squared) over duration, and carried weight: what collocation leaves.
MOMENTUM, CARRIED = 5e-3, 1e-3
# A turn of the base and the time for it.
YAW, DURATION = 0.2, 1.0


@pytest.mark.parametrize("gravity", [0.0, 1e-3, 1.62, 20.0])
def test_arm_reaches_in_any_gravity(gravity, tmp_path):
    path = robot_file(tmp_path, "arm", f"with_gravity(own('ur5'), {gravity})")
    assert_outcome(
        Solved(open_loop=4.0 if gravity > 9.81 else 1e-2), partial(made, "arm-reach", path), intervals=10
    )


@pytest.mark.long
@pytest.mark.parametrize("gravity", [0.0, 1e-3, 1.62, 20.0])
def test_quadruped_stands_in_any_gravity(gravity):
    solution = assert_outcome(
        Solved(open_loop=1e-3), lambda: stand(with_gravity(robots.load("solo12"), gravity))
    )
    carried = solution.f[solution.collocation][..., 2].sum(axis=1)
    weight = robots.load("solo12").mass * gravity
    assert_allclose(carried.mean(), weight, atol=CARRIED * max(weight, 1.0))  # from rest to rest


@pytest.mark.long
def test_floating_quadruped_turns_by_its_legs_alone():
    """No gravity, no contact, no momentum: it ends turned all the same, at rest where it was."""
    robot = with_gravity(robots.load("solo12"), 0.0)
    make = partial(turn_over, robot, yaw=YAW, duration=DURATION)
    solution = assert_outcome(Solved(open_loop=5e-2), make, intervals=20)
    model, data = solution.model, solution.model.createData()
    unit = robot.mass * robot.length / DURATION
    for q, v in zip(solution.q, solution.v, strict=True):
        momentum = pin.computeCentroidalMomentum(model, data, q, v)
        assert np.abs(momentum.linear).max() <= MOMENTUM * unit
        assert np.abs(momentum.angular).max() <= MOMENTUM * unit * robot.length
    turned = pin.rpy.matrixToRpy(pin.Quaternion(solution.q[-1, 3:7]).toRotationMatrix())
    assert_allclose(turned, [0.0, 0.0, YAW], atol=1e-6)


@pytest.mark.long
def test_without_gravity_nothing_that_stands_stops_its_rise(tmp_path):
    path = robot_file(tmp_path, "quadruped", "with_gravity(own('solo12'), 0.0)")
    expected = Failed(Status.INFEASIBLE, block="base_dynamics")
    assert_outcome(expected, partial(made, "quadruped-stand-up", path), intervals=15)


@pytest.mark.parametrize("name", ["quadruped-jump-up", "quadruped-jump-forward"])
def test_jump_without_gravity_is_refused(name, tmp_path):
    path = robot_file(tmp_path, "quadruped", "with_gravity(own('solo12'), 0.0)")
    assert_outcome(Refused("is without gravity"), partial(made, name, path))


@pytest.mark.slow
@pytest.mark.parametrize("gravity", [1e-3, 1.62, 20.0])
def test_quadruped_jumps_in_any_gravity(gravity, tmp_path):
    path = robot_file(tmp_path, "quadruped", f"with_gravity(own('solo12'), {gravity})")
    assert_outcome(Solved(open_loop=2.0, coarse=0.05), partial(made, "quadruped-jump-up", path), intervals=15)
