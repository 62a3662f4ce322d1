"""Bounds of the mass matrix over sampled postures and before any posture is known."""

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.lecture_models import named, three_joint_arm
from tests.support.models import robot
from trajopt.dynamics.base_joint import position_limits
from trajopt.dynamics.model_quantities import mass_matrix_at
from trajopt.errors import InputError
from trajopt_library.lessons.mass_bounds import a_priori_bounds, eigenvalue_range, random_postures

ROUNDING = 1e-12
POSTURES = 200
BOUNDED = [
    "ur5", "panda", "kinova", "double_pendulum", "solo12", "anymal_c", "talos", "talos_legs", "planar:go2",
    "three_joint_arm", "planar_hopper", "joint:RevoluteUnaligned", "joint:RUBX", "joint:Spherical",
    "joint:SphericalZYX",
]  # fmt: skip
REVOLUTE = ["ur5", "kinova", "three_joint_arm", "double_pendulum"]


@pytest.mark.parametrize("name", BOUNDED)
def test_eigenvalues_stay_within_the_a_priori_bounds(name):
    model = named(name)
    bounds = a_priori_bounds(model)
    found = eigenvalue_range(model, random_postures(model, POSTURES, 0))
    assert 0 <= bounds.lower <= found.lowest
    assert 0 < found.lowest <= found.highest <= bounds.upper


@pytest.mark.parametrize("name", BOUNDED)
def test_rotors_only_help_the_lower_bound_which_links_alone_keep_positive(name):
    model = named(name).copy()
    model.armature[:] = 0.0
    bounds = a_priori_bounds(model)
    found = eigenvalue_range(model, random_postures(model, POSTURES, 1))
    # massless virtual links and the axes of a ZYX joint, which may align, have no bound from links alone
    assert (bounds.lower > 0) == (name not in ("planar_hopper", "joint:SphericalZYX"))
    assert bounds.lower <= found.lowest
    assert found.highest <= bounds.upper


@pytest.mark.parametrize("name", REVOLUTE)
def test_bound_of_a_revolute_arm_is_within_a_small_factor_of_what_occurs(name):
    """A bound that is far too large would also pass: a trace is at most n times its largest eigenvalue."""
    model = named(name)
    found = eigenvalue_range(model, random_postures(model, POSTURES, 2))
    assert a_priori_bounds(model).upper < model.nv * found.highest


def test_bounds_of_a_pendulum_are_its_moment_of_inertia():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "pivot")
    model.inertias[joint] = pin.Inertia(2.0, np.array([0.0, 0.0, -0.5]), np.diag([0.1, 0.3, 0.2]))
    model.armature[:] = 0.05
    bounds = a_priori_bounds(model)
    assert_allclose([bounds.lower, bounds.upper], 2.0 * 0.5**2 + 0.3 + 0.05, rtol=ROUNDING)


def test_extreme_eigenvalues_are_those_of_the_postures_returned():
    model = named("ur5")
    found = eigenvalue_range(model, random_postures(model, POSTURES, 3))
    assert_allclose(np.linalg.eigvalsh(mass_matrix_at(model, found.lowest_posture))[0], found.lowest)
    assert_allclose(np.linalg.eigvalsh(mass_matrix_at(model, found.highest_posture))[-1], found.highest)


@pytest.mark.parametrize("name", ["solo12", "panda", "talos", "kinova", "joint:Spherical"])
def test_random_postures_are_valid_repeatable_and_within_limits(name):
    model = named(name)
    postures, (lower, upper) = random_postures(model, 50, 4), position_limits(model)
    assert_allclose(postures, random_postures(model, 50, 4), rtol=0, atol=0)
    assert np.abs(postures - random_postures(model, 50, 5)).max() > 0
    for q in postures:
        assert pin.isNormalized(model, q, ROUNDING)
        assert (q >= lower - ROUNDING).all()
        assert (q <= upper + ROUNDING).all()


def test_a_sliding_joint_between_links_is_bounded_by_its_limits_or_refused():
    model = pin.Model()
    turn = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "turn")
    slide = model.addJoint(
        turn, pin.JointModelPX(), pin.SE3.Identity(), "slide",
        np.array([1.0]), np.array([1.0]), np.array([-0.2]), np.array([1.5]),
    )  # fmt: skip
    for joint in (turn, slide):
        model.inertias[joint] = pin.Inertia(1.0, np.zeros(3), np.eye(3))
    upper = a_priori_bounds(model).upper
    found = eigenvalue_range(model, random_postures(model, POSTURES, 6))
    assert 2.0 + 1.4**2 < found.highest <= upper
    model.upperPositionLimit[1] = np.inf
    for bound in (a_priori_bounds, lambda model: random_postures(model, 1, 0)):
        with pytest.raises(InputError, match="'slide' slides without position limits"):
            bound(model)


def test_bad_input_is_refused():
    model = robot("ur5")[0]
    for postures in (np.zeros(6), np.zeros((0, 6)), np.zeros((2, 7))):
        with pytest.raises(InputError, match=r"shape \(n, 6\)"):
            eigenvalue_range(model, postures)
    with pytest.raises(InputError, match="no joints"):
        a_priori_bounds(pin.Model())
    assert random_postures(three_joint_arm(), 0, 0).shape == (0, 3)
