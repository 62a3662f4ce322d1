"""Power, energy and cost of transport, against numpy and closed forms."""

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.goals import integral, objective, sampled, wandering, with_terms
from tests.support.problems import hop, hopper, one_joint_arm, reach
from tests.support.synthetic_motions import with_meta
from trajopt.motion.energy_use import cost_of_transport, energy
from trajopt.robot.actuators.drive import Drive
from trajopt.robot.units import Units
from trajopt.solving.solving import solve
from trajopt.terms import PowerCost
from trajopt.terms.drives import heat_coefficients

# Sums of the same numbers in another order.
ROUNDING = 1e-11


@pytest.mark.parametrize("recovered", [-1.0, 0.0, 0.4])
def test_power_cost_is_the_integral_of_what_joints_draw(recovered):
    robot, s = hopper(), 0.05
    problem = replace(hop(), guess=wandering(robot))
    solution, x = sampled(problem)
    unit = Units(robot)
    power = solution.tau * solution.v[:, 6:] * unit.time / unit.torque
    drawn = (1 + recovered) / 2 * power + (1 - recovered) / 2 * (np.sqrt(power**2 + s**2) - s)
    expected = 2.0 * integral(solution, drawn.sum(axis=1)) / unit.time
    cost = PowerCost(weight=2.0, recovered=recovered, smoothing=s)
    assert_allclose(objective(with_terms(problem, cost), x), expected, rtol=ROUNDING)


def test_energy_of_a_motion_between_rests_is_twice_its_largest_kinetic_energy():
    solution = solve(reach(), intervals=40)
    inertia = pin.crba(solution.model, solution.model.createData(), solution.q[0])[0, 0]
    largest = inertia * np.abs(solution.v).max() ** 2 / 2
    assert_allclose(energy(solution, recovered=0.0), largest, rtol=1e-3)
    assert_allclose(energy(solution), 2 * largest, rtol=1e-3)
    assert_allclose(energy(solution, recovered=1.0), 0.0, atol=1e-6 * largest)
    assert cost_of_transport(solution) == math.inf  # an arm goes nowhere


def test_heat_is_that_of_the_windings():
    resistance, constant, ratio = 0.5, 0.08, -9.0
    drive = Drive.from_motor(gear_ratio=ratio, voltage=24.0, resistance=resistance, torque_constant=constant)
    (found,) = heat_coefficients((drive,), 1)
    torque = 3.0
    current = torque / ratio / constant
    assert_allclose(found * torque**2, resistance * current**2, rtol=ROUNDING)
    assert_allclose(heat_coefficients((None, Drive(gear_ratio=9.0)), 2), 0.0)
    assert_allclose(heat_coefficients(None, 3), np.zeros(3))


def test_drives_heat_is_in_the_cost_and_in_the_energy():
    drive = Drive.from_motor(gear_ratio=9.0, voltage=48.0, resistance=0.5, torque_constant=0.08)
    robot = one_joint_arm(gravity=True).with_drives((drive,))
    problem = replace(reach(gravity=True), robot=robot)
    solution, x = sampled(problem)
    heat = integral(solution, (solution.tau[:, 0] / 9.0 / 0.08) ** 2 * 0.5)
    bare = with_meta(solution, drives=None)
    assert_allclose(energy(solution) - energy(bare), heat, rtol=ROUNDING)
    unit = Units(robot)
    only = with_terms(problem, PowerCost(weight=1.0, recovered=1.0))
    expected = energy(solution, recovered=1.0) / (unit.force * unit.length)
    assert_allclose(objective(only, x), expected, rtol=ROUNDING)


def test_cost_of_transport_is_energy_over_weight_and_way():
    robot = hopper()
    solution, _ = sampled(replace(hop(), guess=wandering(robot)))
    model, data = robot.model, robot.model.createData()
    ends = [pin.centerOfMass(model, data, q).copy() for q in solution.q[[0, -1]]]
    way = np.linalg.norm((ends[1] - ends[0])[:2])
    drawn = integral(solution, np.abs(solution.tau * solution.v[:, 6:]).sum(axis=1))
    assert_allclose(cost_of_transport(solution), drawn / robot.weight / way, rtol=ROUNDING)
    still = replace(solution, q=np.tile(solution.q[0], (solution.n_samples, 1)))
    assert cost_of_transport(still) == math.inf
