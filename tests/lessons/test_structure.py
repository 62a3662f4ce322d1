"""Structure of the dynamics: blocks of M, momentum, Coriolis matrix, energy, gravity."""

from dataclasses import FrozenInstanceError

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.lecture_models import (
    BASE_JOINTS,
    BASE_SIZES,
    FIXED,
    FLOATING,
    VIRTUAL_BASE,
    link_momentum_matrix,
    named,
    planar_hopper,
    three_joint_arm,
)
from tests.support.models import JOINT_KINDS, random_state
from trajopt.dynamics.model_quantities import mass_matrix_at, mass_of
from trajopt.errors import InputError, UnsupportedJointError
from trajopt_library.lessons import structure

# Two ways of summing the same numbers of order 1 to 1e3.
SAME = {"rtol": 1e-9, "atol": 1e-10}
# Central differences of step 1e-5 on entries up to 1e2.
DIFFERENCE_STEP = 1e-5
DIFFERENCE = {"rtol": 1e-6, "atol": 1e-6}

SEEDS = (0, 1)
FREE = ("solo12", "talos")
EVERY_JOINT = tuple(f"joint:{kind}" for kind in JOINT_KINDS)
MODELS = (*FLOATING, *FIXED, *EVERY_JOINT)


@pytest.mark.parametrize("name", BASE_SIZES)
def test_blocks_put_together_are_the_mass_matrix(name):
    model = named(name)
    q, _, _ = random_state(model, 0)
    blocks, rows = structure.mass_blocks(model, q, BASE_JOINTS.get(name)), BASE_SIZES[name]
    assert blocks.base.shape == (rows, rows)
    assert blocks.joints.shape == (model.nv - rows, model.nv - rows)
    matrix = np.block([[blocks.base, blocks.coupling], [blocks.coupling.T, blocks.joints]])
    assert_allclose(matrix, mass_matrix_at(model, q), rtol=0, atol=0)
    with pytest.raises(FrozenInstanceError):
        blocks.base = matrix


@pytest.mark.parametrize("name", FREE)
@pytest.mark.parametrize("seed", SEEDS)
def test_base_block_of_a_free_flyer_is_the_composite_inertia_in_its_axes(name, seed):
    model = named(name)
    q, _, _ = random_state(model, seed)
    data = model.createData()
    pin.crba(model, data, q)
    pin.forwardKinematics(model, data, q)
    composite = structure.composite_inertia(model, q)
    in_base = composite.matrix(data.oMi[1])
    assert_allclose(structure.mass_blocks(model, q).base, in_base, **SAME)
    assert_allclose(data.Ycrb[1].matrix(), in_base, **SAME)
    assert_allclose(composite.centre, pin.centerOfMass(model, data, q), **SAME)
    assert_allclose(composite.mass, mass_of(model), **SAME)
    pin.ccrba(model, data, q, np.zeros(model.nv))
    assert_allclose(composite.rotational, data.Ig.inertia, **SAME)


@pytest.mark.parametrize("name", FLOATING)
def test_base_block_is_the_composite_inertia_in_the_bases_directions(name):
    model = named(name)
    q, _, _ = random_state(model, 1)
    maps = structure.momentum_maps(model, q, BASE_JOINTS.get(name))
    inertia = structure.composite_inertia(model, q).matrix(maps.placement)
    expected = maps.base_jacobian.T @ inertia @ maps.base_jacobian
    assert_allclose(structure.mass_blocks(model, q, BASE_JOINTS.get(name)).base, expected, **SAME)


@pytest.mark.parametrize("name", MODELS)
def test_momentum_matrix_is_the_sum_over_links_about_the_centre_of_mass(name):
    model = named(name)
    q, _, _ = random_state(model, 2)
    maps = structure.momentum_maps(model, q, BASE_JOINTS.get(name))
    expected = link_momentum_matrix(model, q, structure.composite_inertia(model, q).centre)
    assert_allclose(maps.centroidal, expected, **SAME)
    assert_allclose(structure.momentum_matrix(model)(q).full(), expected, **SAME)
    about_base = link_momentum_matrix(model, q, maps.placement.translation)
    to_base = np.kron(np.eye(2), maps.placement.rotation.T)
    assert_allclose(maps.base, to_base @ about_base, **SAME)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", FLOATING)
def test_base_rows_of_the_mass_matrix_are_the_transported_momentum_matrix(name, seed):
    model = named(name)
    q, _, _ = random_state(model, seed)
    maps, rows = structure.momentum_maps(model, q, BASE_JOINTS.get(name)), BASE_SIZES[name]
    mass = mass_matrix_at(model, q)
    assert_allclose(maps.rows_of_mass_matrix, mass[:rows], **SAME)
    if rows == 6:
        assert_allclose(maps.at_centre_of_mass(mass[:rows]), maps.centroidal, **SAME)


def test_a_free_flyers_base_frame_is_its_body_and_virtual_joints_map_through_their_jacobian():
    free, chain = named("solo12"), named("virtual:solo12")
    q, _, _ = random_state(free, 3)
    assert_allclose(structure.momentum_maps(free, q).base_jacobian, np.eye(6), **SAME)
    rotation = pin.Quaternion(q[3:7]).toRotationMatrix()
    yaw, pitch, roll = pin.rpy.matrixToRpy(rotation)[::-1]
    q_chain = np.concatenate([q[:3], [yaw, pitch, roll], q[7:]])
    maps = structure.momentum_maps(chain, q_chain, VIRTUAL_BASE)
    jacobian = maps.base_jacobian
    mass = mass_matrix_at(free, q)
    to_free = np.eye(free.nv)
    to_free[:6, :6] = jacobian
    assert_allclose(mass_matrix_at(chain, q_chain), to_free.T @ mass @ to_free, **SAME)
    assert_allclose(maps.placement.rotation, rotation, **SAME)


@pytest.mark.parametrize("name", MODELS)
def test_mass_matrix_is_symmetric_positive_definite_in_many_postures(name):
    model = named(name)
    for seed in range(20):
        matrix = mass_matrix_at(model, random_state(model, seed)[0])
        assert_allclose(matrix, matrix.T, rtol=0, atol=0)
        np.linalg.cholesky(matrix)


def test_mass_matrix_does_not_depend_on_where_a_free_flyer_is():
    model = named("solo12")
    q, v, _ = random_state(model, 4)
    moved = pin.integrate(model, q, np.concatenate([v[:6], np.zeros(model.nv - 6)]))
    assert_allclose(mass_matrix_at(model, moved), mass_matrix_at(model, q), **SAME)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", MODELS)
def test_coriolis_matrix_makes_the_rate_of_the_mass_matrix_skew(name, seed):
    model = named(name)
    q, v, _ = random_state(model, seed)
    coriolis, data = structure.coriolis_matrix_at(model, q, v), model.createData()
    forces = pin.nonLinearEffects(model, data, q, v) - pin.computeGeneralizedGravity(model, data, q)
    assert_allclose(coriolis @ v, forces, **SAME)
    rate = structure.mass_matrix_rate(model)(q, v).full()
    ahead, behind = (
        mass_matrix_at(model, pin.integrate(model, q, sign * DIFFERENCE_STEP * v)) for sign in (1, -1)
    )
    assert_allclose(rate, (ahead - behind) / (2 * DIFFERENCE_STEP), **DIFFERENCE)
    skew = rate - 2 * coriolis
    assert_allclose(skew, -skew.T, **SAME)


@pytest.mark.parametrize("name", MODELS)
def test_kinetic_energy_is_the_sum_over_links_and_rotors(name):
    model = named(name)
    q, v, _ = random_state(model, 5)
    energy = structure.kinetic_energy_parts(model, q, v)
    parts = energy.translation.sum() + energy.rotation.sum() + energy.armature
    assert_allclose(parts, energy.quadratic_form, **SAME)
    assert (energy.translation >= 0).all()
    assert (energy.rotation >= 0).all()
    rotorless = model.copy()
    rotorless.armature[:] = 0.0
    expected = pin.computeKineticEnergy(rotorless, rotorless.createData(), q, v)
    assert_allclose(energy.translation.sum() + energy.rotation.sum(), expected, **SAME)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", FLOATING)
def test_gravity_is_the_base_columns_of_the_mass_matrix(name, seed):
    model = named(name)
    q, _, _ = random_state(model, seed)
    expected = pin.computeGeneralizedGravity(model, model.createData(), q)
    columns = structure.gravity_from_base_columns(model, q, BASE_JOINTS.get(name))
    assert_allclose(columns, expected, **SAME)


def test_gravity_column_of_a_free_flyer_is_in_its_axes_and_of_virtual_joints_in_the_worlds():
    """The lecture's G = - M [g; 0; 0] holds word for word only where the first rates are world velocities."""
    free, chain = named("solo12"), named("virtual:solo12")
    for model, turned in ((free, True), (chain, False)):
        q, _, _ = random_state(model, 6)
        linear, gravity = mass_matrix_at(model, q)[:, :3], model.gravity.linear
        rotation = structure.momentum_maps(model, q).placement.rotation if turned else np.eye(3)
        expected = pin.computeGeneralizedGravity(model, model.createData(), q)
        assert_allclose(-linear @ rotation.T @ gravity, expected, **SAME)
        assert turned == (np.abs(-linear @ gravity - expected).max() > 1.0)


@pytest.mark.parametrize("name", MODELS)
def test_gravity_from_momentum_holds_on_every_base(name):
    model = named(name)
    q, _, _ = random_state(model, 7)
    expected = pin.computeGeneralizedGravity(model, model.createData(), q)
    assert_allclose(structure.gravity_vector(model, q), expected, **SAME)


def test_gimbal_lock_of_virtual_joints_is_reported_not_inverted():
    model = named("virtual:solo12")
    q, _, _ = random_state(model, 12)
    q[4] = np.pi / 2
    maps = structure.momentum_maps(model, q, VIRTUAL_BASE)
    with pytest.raises(InputError, match="rank 5"):
        maps.at_centre_of_mass(np.zeros(6))


def test_bases_that_cannot_fall_or_do_not_determine_a_wrench_are_refused():
    model = named("ur5")
    q, _, _ = random_state(model, 0)
    with pytest.raises(InputError, match="cannot fall"):
        structure.gravity_from_base_columns(model, q)
    for name in ("ur5", "planar_hopper"):
        q, _, _ = random_state(named(name), 0)
        with pytest.raises(InputError, match="6 independent rates"):
            structure.momentum_maps(named(name), q, BASE_JOINTS.get(name)).at_centre_of_mass(np.zeros(6))
    sideways = planar_hopper().copy()
    sideways.gravity.linear = np.array([0.0, 9.81, 0.0])
    q, _, _ = random_state(sideways, 0)
    with pytest.raises(InputError, match="cannot fall"):
        structure.gravity_from_base_columns(sideways, q, "pitch")


def test_a_joint_that_is_no_base_is_refused():
    model, arm = named("virtual:solo12"), three_joint_arm()
    q, _, _ = random_state(model, 0)
    with pytest.raises(InputError, match=r"'hoof' is unknown; one of .*base_rx"):
        structure.momentum_maps(model, q, "hoof")
    with pytest.raises(InputError, match="not a chain"):
        structure.momentum_maps(model, q, model.names[10])
    with pytest.raises(InputError, match="carry mass"):
        structure.momentum_maps(arm, np.zeros(3), "elbow")
    with pytest.raises(InputError, match="carry mass"):
        structure.momentum_maps(model, q, "FL_HAA")


def test_bad_input_is_refused():
    model = named("solo12")
    q, v, _ = random_state(model, 0)
    with pytest.raises(InputError, match=r"q has shape \(18,\); shape \(19,\)"):
        mass_matrix_at(model, v)
    with pytest.raises(InputError, match="v has shape"):
        structure.kinetic_energy_parts(model, q, q)
    with pytest.raises(InputError, match="v has shape"):
        structure.coriolis_matrix_at(model, q, q)
    helical = pin.Model()
    helical.addJoint(0, pin.JointModelHX(0.1), pin.SE3.Identity(), "screw")
    with pytest.raises(UnsupportedJointError, match="'screw'"):
        structure.coriolis_matrix_at(helical, np.zeros(1), np.zeros(1))
