"""The guess of all unknowns from a motion q(t), and its perturbation."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.support.models import hand_built, random_state
from tests.support.problems import SCHEME_ORDERS, hop, hopper, reach
from trajopt.motion.samples import sample_quantities
from trajopt.problem.problem import Problem
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.solving.extraction import extract
from trajopt.terrain.flat import FlatGround
from trajopt.transcription.guess import initial_guess, perturbed
from trajopt.transcription.transcription import Transcription, transcribe
from trajopt_library import problems

ROUNDING = 1e-14
# Wrenches carry the motion exactly; the points of the collocation map lie off it by its curvature in
# an interval, which costs this part of the weight.
BASE_RESIDUAL = 2e-2
# The motion's own differences of step 1e-3: error of order 1e-6 of its fourth derivative.
DIFFERENCES = 1e-4


@lru_cache
def jump(name: str = "legendre:2") -> Transcription:
    return transcribe(problems.load("solo12-jump"), name, 9)


def test_guess_carries_the_robot_in_stance():
    t = jump()
    solution = extract(t, initial_guess(t))
    samples, robot = sample_quantities(solution), t.problem.robot
    stance = solution.collocation & (solution.phase == 0)
    assert solution.active[stance].all()
    base = samples.generalized_force[stance, : robot.n_unactuated]
    assert_allclose(base / robot.weight, 0.0, atol=BASE_RESIDUAL)


def test_a_guess_whose_time_is_over_stays_where_it_is():
    made, times = problems.load("solo12-jump"), []

    def slow(t: float) -> np.ndarray:
        times.append(t)
        return made.guess(t)

    t = transcribe(replace(made, guess=slow), "legendre:2", 9)
    times.clear()
    x = initial_guess(t, deadline=-np.inf)
    assert len(times) <= 4  # at one node or point, with its neighbours
    assert np.isfinite(x).all()
    middle = t.layout.node(t.layout.n_stages // 2)
    assert_allclose(x[middle], x[t.layout.node(t.layout.n_stages)], atol=ROUNDING)


def test_guess_starts_at_the_start_and_has_unit_quaternions():
    t = jump()
    x = initial_guess(t) * t.scale
    layout, problem = t.layout, t.problem
    start = layout.coordinates.node_from_pinocchio(problem.initial_q, problem.initial_v)
    assert_array_equal(x[layout.node(0)], start)
    norms = [np.linalg.norm(x[layout.node(k)][:4]) for k in range(layout.n_intervals + 1)]
    assert_allclose(norms, 1.0, atol=ROUNDING)


@pytest.mark.parametrize("name", SCHEME_ORDERS)
def test_guess_follows_the_motion_at_nodes(name):
    t = transcribe(hop(guess=tumbling_motion), name, 7)
    x, layout, model = initial_guess(t) * t.scale, t.layout, hopper().model
    nodes = np.array([x[layout.node(k)] for k in range(1, layout.n_intervals + 1)])
    q, v = layout.coordinates.node_to_pinocchio(nodes)
    for row, time in enumerate(layout.node_times[1:]):
        apart = pin.difference(model, tumbling_motion(time), q[row])
        assert_allclose(apart, 0.0, atol=1e-12)
        assert_allclose(v[row], TURNING, atol=DIFFERENCES)


TURNING = np.array([0.3, -0.2, 0.1, 1.0, -4.0, 2.0, 0.4, 0.05])


def tumbling_motion(t: float) -> np.ndarray:
    """A motion of constant body-frame velocity, through more than half a turn."""
    return pin.integrate(hopper().model, hopper().reference, t * TURNING)


@pytest.mark.parametrize("name", SCHEME_ORDERS)
def test_accelerations_at_a_kink_are_those_of_the_interval(name):
    model, n = hopper().model, 7
    t = transcribe(hop(guess=tumbling_motion), name, n)
    layout, interval = t.layout, 3
    points = layout.scheme_of(layout.stages[interval].phase).c
    kink = float(layout.node_times[interval] + points[-1] * layout.steps[interval])

    def bent(time: float) -> np.ndarray:
        return pin.integrate(model, tumbling_motion(min(time, kink)), max(time - kink, 0.0) * FASTER)

    x = initial_guess(transcribe(hop(guess=bent), name, n)) * t.scale
    phase, window = layout.stages[interval].phase, x[layout.window(interval)]
    found = [window[layout.local_derivative(phase, i)] for i in range(len(points))]
    # the change of the rate over the time between points, times what a polynomial overshoots
    assert np.abs(found).max() < 20 * np.abs(FASTER - TURNING).max() / layout.steps[interval]


FASTER = np.array([0.3, -0.2, 0.1, 1.0, -4.0, 2.0, 3.4, 0.05])


def test_quaternions_and_turns_of_the_guess_continue_from_node_to_node():
    t = transcribe(hop(guess=tumbling_motion), "legendre:1", 12)
    x, layout = initial_guess(t), t.layout
    quaternions = np.array([x[layout.node(k)][:4] for k in range(13)])
    assert np.all(np.sum(quaternions[1:] * quaternions[:-1], axis=1) > 0.5)


def test_angle_of_a_continuous_joint_is_counted_through_whole_turns():
    model, _ = hand_built("RUBX")
    robot = Robot.from_model(model, name="spinning")
    start, _, _ = random_state(model, 0)
    turning = np.array([0.0, 9.0, 0.0])
    problem = Problem(
        name="spin",
        robot=robot,
        schedule=Schedule((Phase(name="spin", duration=2.0),)),
        terrain=FlatGround(),
        initial_q=start,
        initial_v=turning,
        terms=(),
        guess=lambda t: pin.integrate(model, start, t * turning),
    )
    t = transcribe(problem, "legendre:1", 10)
    x, layout = initial_guess(t) * t.scale, t.layout
    angles = [x[layout.node(k)][layout.forms[0].additive[1]] for k in range(11)]
    assert_allclose(np.diff(angles), 9.0 * 0.2, atol=1e-9)


def test_arm_needs_no_wrench_and_follows_the_motion():
    t = transcribe(reach(), "legendre:2", 5)
    x, layout = initial_guess(t) * t.scale, t.layout
    assert layout.n_wrench(0) == 0
    assert_allclose(x[layout.node(5)][0], reach().guess(0.8))


@pytest.mark.parametrize("sigma", [0.1, 0.3])
def test_perturbation_keeps_what_is_fixed_and_unit_quaternions(sigma):
    t = jump()
    x = initial_guess(t)
    moved = perturbed(t, x, 4, sigma)
    fixed = t.lower_x == t.upper_x
    assert fixed.sum() == t.layout.forms[0].size
    assert_allclose(moved[fixed], x[fixed], atol=ROUNDING)
    norms = [np.linalg.norm(moved[t.layout.node(k)][:4]) for k in range(t.layout.n_intervals + 1)]
    assert_allclose(norms, 1.0, atol=ROUNDING)
    assert np.std((moved - x)[~fixed]) == pytest.approx(sigma, rel=0.1)


def test_perturbation_is_reproducible_by_its_seed():
    t = jump()
    x = initial_guess(t)
    assert_array_equal(perturbed(t, x, 4, 0.1), perturbed(t, x, 4, 0.1))
    assert np.max(np.abs(perturbed(t, x, 4, 0.1) - perturbed(t, x, 5, 0.1))) > 0.1
    assert_array_equal(x, initial_guess(t))
