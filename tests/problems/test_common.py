"""What families share: paths of guesses meet their ends at their rates, a hop lands where it is told."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trajopt.errors import InputError
from trajopt.robot.kinematics import contact_positions
from trajopt_library import problems, robots
from trajopt_library.problems import common

# Central differences over this step, s, of polynomials of order one.
STEP, DIFFERENCE = 1e-5, 1e-8


def rate(path, t):
    return (path(t + STEP) - path(t - STEP)) / (2 * STEP)


def test_only_modules_with_a_family_are_problems():
    assert "common" not in problems.families()
    assert "solo12-jump" in problems.families()


def test_hermite_cubic_has_the_values_and_rates_of_its_ends():
    start, start_rate, end, end_rate = np.random.default_rng(0).normal(size=(4, 3))

    def path(t):
        return common.hermite(t / 0.4, 0.4, start, start_rate, end, end_rate)

    assert_allclose(path(0.0), start, atol=1e-15)
    assert_allclose(path(0.4), end, atol=1e-15)
    # One-sided differences: the path stands still beyond its ends.
    assert_allclose((path(STEP) - start) / STEP, start_rate, atol=1e3 * STEP)
    assert_allclose((end - path(0.4 - STEP)) / STEP, end_rate, atol=1e3 * STEP)
    assert_allclose([path(-1.0), path(1.0)], [start, end], atol=1e-15)


@pytest.mark.parametrize("impact", [False, True])
def test_hop_leaves_with_all_contacts_and_lands_on_all_footholds(impact):
    robot = robots.load("solo12")
    feet = contact_positions(robot, robot.reference)
    stance, flight, landing = common.hop_schedule(feet, (0.3, 0.2, 0.4), impact=impact).phases
    assert (stance.duration, flight.duration, landing.duration) == (0.3, 0.2, 0.4)
    assert stance.contacts == landing.contacts == tuple(feet)
    assert flight.contacts == ()
    assert landing.impact is impact
    for name, place in feet.items():
        assert_allclose(landing.footholds[name], place)


def test_share_of_effort_scales_limits_and_leaves_a_robot_without_limits_alone():
    robot = robots.load("ur5")
    assert_allclose(common.torque_limits(robot, torque_share=0.5).limit, robot.torque_limit / 2)
    assert common.torque_limits(replace(robot, torque_limit=None), torque_share=0.5).limit is None


def test_wall_is_upright_without_tilt_and_a_table_at_a_right_angle():
    assert_allclose(common.wall_normal(0.0), [-1.0, 0.0, 0.0])
    assert_allclose(common.wall_normal(math.pi / 2), [0.0, 0.0, 1.0], atol=1e-15)


@pytest.mark.parametrize("name", ["friction", "distance", "touchdown"])
def test_shared_parameters_refuse_what_is_out_of_range(name):
    with pytest.raises(InputError, match=name):
        problems.load("solo12-jump", **{name: -20.0})
