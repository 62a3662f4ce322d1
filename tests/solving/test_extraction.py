"""From unknowns to samples: layout, interpolation, and the rows that hold at the points."""

import sys
from functools import lru_cache

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.support.problems import FOOT, hop, hopper, planar_hopper, reach
from trajopt.motion.samples import sample_quantities
from trajopt.motion.solution import Solution
from trajopt.solving.extraction import extract
from trajopt.solving.solving import solve
from trajopt.transcription.guess import initial_guess
from trajopt.transcription.schemes import scheme
from trajopt.transcription.transcription import transcribe

INTERVALS = 8
# Rows of a solution to 1e-8 in natural units hold to this in units of the weight.
RESIDUAL = 1e-6
ROUNDING = 1e-10
SCHEMES = ("legendre:2", "radau:2", "hermite-simpson")


@lru_cache
def solved(name: str) -> Solution:
    return solve(hop(), transcription=name, intervals=INTERVALS, tolerance=1e-8)


def by_interval(solution: Solution, name: str) -> np.ndarray:
    values = getattr(solution, name)
    return values.reshape(INTERVALS, -1, *values.shape[1:])


@pytest.mark.parametrize("name", SCHEMES)
def test_samples_are_start_points_and_end_of_each_interval(name):
    solution, method = solved(name), scheme(name)
    assert solution.converged
    assert solution.n_samples == INTERVALS * (method.s + 2)
    assert_array_equal(by_interval(solution, "collocation")[0], [False] + [True] * method.s + [False])
    assert_array_equal(
        by_interval(solution, "interval"), np.tile(np.arange(INTERVALS)[:, None], method.s + 2)
    )
    start, end = solution.interval_t.T
    fractions = np.concatenate([[0.0], method.c, [1.0]])
    expected = start[:, None] + np.outer(end - start, fractions)
    assert_allclose(by_interval(solution, "t"), expected, atol=ROUNDING)
    assert_array_equal(start[1:], end[:-1])


@pytest.mark.parametrize("name", SCHEMES)
def test_extracted_solution_is_a_consistent_file(name, tmp_path):
    solution = solved(name)
    read = Solution.load(solution.save(tmp_path / "hop.npz"))
    assert_array_equal(read.q, solution.q)
    assert read.converged


@pytest.mark.parametrize("name", SCHEMES)
def test_phases_and_active_contacts_follow_the_schedule(name):
    solution = solved(name)
    names = np.array(solution.description.phase_names)[solution.phase]
    assert list(solution.meta["intervals"]) == [3, 2, 3]
    assert_array_equal(solution.active[:, 0], names != "flight")
    assert_array_equal(solution.f[names == "flight"], 0.0)
    assert_array_equal(solution.f[:, :, 3:], 0.0)  # a point transmits no moment
    assert np.all(solution.f[solution.collocation & (names == "stance"), 0, 2] >= -RESIDUAL * hopper().weight)


@pytest.mark.parametrize("name", SCHEMES)
@pytest.mark.parametrize("quantity", ["a", "tau", "f"])
def test_values_at_nodes_are_interpolated_through_the_points(name, quantity):
    values, method = by_interval(solved(name), quantity), scheme(name)
    ends = method.interpolation(np.array([0.0, 1.0]))
    for interval in values:
        expected = np.tensordot(ends, interval[1:-1], axes=1)
        assert_allclose(interval[[0, -1]], expected, rtol=ROUNDING, atol=ROUNDING * np.max(np.abs(values)))


@pytest.mark.parametrize("name", SCHEMES)
def test_node_shared_by_two_intervals_has_one_state(name):
    solution = solved(name)
    for quantity in ("q", "v"):
        values = by_interval(solution, quantity)
        assert_array_equal(values[1:, 0], values[:-1, -1])


@pytest.mark.parametrize("name", SCHEMES)
def test_dynamics_hold_at_the_points_with_the_extracted_torques(name):
    solution, robot = solved(name), hopper()
    force = sample_quantities(solution).generalized_force[solution.collocation]
    n = robot.n_unactuated
    assert_allclose(force[:, :n] / robot.weight, 0.0, atol=RESIDUAL)
    assert_allclose(force[:, n:], solution.tau[solution.collocation], atol=ROUNDING * robot.weight)


@pytest.mark.parametrize("name", SCHEMES)
def test_contacts_do_not_accelerate_at_the_points(name):
    solution = solved(name)
    touching = solution.collocation & solution.active[:, 0]
    acceleration = sample_quantities(solution).acceleration[touching, 0, :3]
    assert_allclose(acceleration / 9.81, 0.0, atol=RESIDUAL)


@pytest.mark.parametrize("name", ["radau:2", "hermite-simpson", "trapezoidal"])
def test_point_at_the_end_of_an_interval_has_the_state_of_the_node(name):
    solution = solved(name)
    for quantity in ("q", "v"):
        values = by_interval(solution, quantity)
        assert_allclose(np.abs(values[:, -2]), np.abs(values[:, -1]), atol=RESIDUAL)
        if scheme(name).c[0] == 0.0:
            assert_allclose(values[:, 1], values[:, 0], atol=ROUNDING)


def test_solution_of_a_fixed_base_has_no_contact():
    t = transcribe(reach(), "legendre:2", 3)
    solution = extract(t, initial_guess(t))
    assert solution.f.shape == (12, 0, 6)
    assert solution.tau.shape == (12, 1)


def test_wrench_of_a_sole_has_force_and_moment():
    t = transcribe(hop("surface"), "legendre:2", 8)
    x = initial_guess(t)
    window = x[t.layout.node_offset[0] :]
    window[t.layout.local_wrench(0, 0)] = np.arange(1.0, 7.0)
    scale = t.scale[t.layout.local_wrench(0, 0)]
    assert_allclose(extract(t, x).f[1, 0], np.arange(1.0, 7.0) * scale)


def test_description_names_the_robot_its_contacts_and_limits():
    meta = solved("legendre:2").meta
    assert (meta["problem"], meta["robot"], meta["transcription"]) == ("hop", "hopper", "legendre:2")
    assert (meta["contact_frames"], meta["contact_kinds"]) == ([FOOT], ["point"])
    assert meta["effort_limit"] == [60.0, 60.0]
    assert meta["velocity_limit"] == [sys.float_info.max] * 6 + [20.0, 20.0]
    assert meta["gravity"] == [0.0, 0.0, -9.81]


def test_model_in_the_solution_is_the_one_that_was_optimised():
    robot, solution = hopper(), solved("legendre:2")
    assert solution.model.nv == robot.nv
    assert_allclose(solution.model.armature, robot.model.armature)
    assert planar_hopper().nv == 6
