"""Structure of the dynamics, and the robot as one body: the lecture's facts, momentum, energy, passivity."""

from collections.abc import Callable
from dataclasses import FrozenInstanceError

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

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
from trajopt.dynamics.model_quantities import contact_jacobian, mass_matrix_at, mass_of
from trajopt.errors import InputError, UnsupportedJointError
from trajopt_library.lessons import structure
from trajopt_library.lessons.newton_euler import joint_forces
from trajopt_library.lessons.whole_body import whole_body_balance

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


# Accelerations of a light leg are of order 1e3 rad/s^2, and forward dynamics has solved for them.
SOLVED = 1e-8
# DOP853 at relative 1e-11 over half a second: its local errors add up.
INTEGRATION = {"rtol": 1e-11, "atol": 1e-12}
ENERGY_DRIFT = 1e-8  # of the energy's scale, or J

FEET = ("FL_FOOT", "HR_FOOT")
DURATION = 0.5  # s, of a motion: legs without torque swing through


def contact_case(name: str, seed: int) -> tuple:
    """Model, motion, contact frames and wrenches on them."""
    model = named(name)
    frames = FEET if "solo" in name else (model.frames[model.nframes - 1].name,)
    wrenches = np.random.default_rng(seed).uniform(-30, 30, (len(frames), 6))
    return model, random_state(model, seed), frames, wrenches


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", FLOATING)
def test_base_rows_are_newton_and_euler_of_the_whole_body(name, seed):
    """Fact 6: momentum's rate less gravity and contacts, transported to the base, is the base rows."""
    model, motion, frames, wrenches = contact_case(name, seed)
    balance = whole_body_balance(model, motion, frames, wrenches, BASE_JOINTS.get(name))
    assert_allclose(balance.momentum.base_rows(balance.missing), balance.base_rows, **SAME)
    if BASE_SIZES[name] == 6:
        assert_allclose(balance.momentum.at_centre_of_mass(balance.base_rows), balance.missing, **SAME)


@pytest.mark.parametrize("name", [*FLOATING, *FIXED])
def test_momentums_rate_is_its_slope_along_the_motion(name):
    model, (q, v, a), _, _ = contact_case(name, 2)
    rate = whole_body_balance(model, (q, v, a)).momentum_rate

    def momentum_at(t: float) -> np.ndarray:
        ahead = pin.integrate(model, q, t * v + t**2 / 2 * a)
        rates = v + t * a
        return link_momentum_matrix(model, ahead, structure.composite_inertia(model, ahead).centre) @ rates

    slope = (momentum_at(DIFFERENCE_STEP) - momentum_at(-DIFFERENCE_STEP)) / (2 * DIFFERENCE_STEP)
    assert_allclose(rate, slope, **DIFFERENCE)


@pytest.mark.parametrize("name", FIXED)
def test_what_a_fixed_bases_motion_lacks_is_what_its_first_joint_transmits(name):
    model, motion, frames, wrenches = contact_case(name, 3)
    balance = whole_body_balance(model, motion, frames, wrenches)
    assert balance.base_rows.shape == (0,)
    first = joint_forces(model, *motion, frames=frames, wrenches=wrenches)
    data = model.createData()
    pin.forwardKinematics(model, data, motion[0])
    at_joint = data.oMi[1].act(pin.Force(np.concatenate([first.force[0], first.moment[0]])))
    at_centre = pin.SE3(np.eye(3), structure.composite_inertia(model, motion[0]).centre).actInv(at_joint)
    assert_allclose(balance.missing, at_centre.vector, **SAME)


@pytest.mark.parametrize("name", ["solo12", "planar:go2"])
def test_torques_accelerate_joints_and_base_but_not_the_momentum(name):
    """Fact 1: without contact, the momentum's rate is gravity's whatever the torques."""
    model = named(name)
    q, v, _ = random_state(model, 8)
    rows, data = BASE_SIZES[name], model.createData()
    rates, bases = [], []
    for seed in SEEDS:
        torque = np.random.default_rng(seed).uniform(-10, 10, model.nv)
        torque[:rows] = 0.0
        acceleration = pin.aba(model, data, q, v, torque)
        balance = whole_body_balance(model, (q, v, acceleration))
        assert_allclose(balance.base_rows, 0.0, atol=SAME["atol"])
        rates.append(balance.momentum.base_rows(balance.momentum_rate - balance.gravity))
        bases.append(acceleration[:rows])
    assert_allclose(rates, 0.0, atol=SOLVED)
    assert np.abs(bases[0] - bases[1]).max() > 1.0  # M_bj couples: the base does turn, at zero momentum


def test_without_couplings_only_contacts_move_the_base():
    """Fact 2: M_b a_b + h_b = J_cb^T f once M_bj a_j is neglected; with it, the same for the momentum."""
    model = named("solo12")
    q, v, _ = random_state(model, 9)
    data, blocks = model.createData(), structure.mass_blocks(model, q)
    jacobian = contact_jacobian(model, q, [(foot, 3) for foot in FEET])
    bias = pin.nonLinearEffects(model, data, q, v)[:6]
    generator = np.random.default_rng(9)
    for torque in generator.uniform(-10, 10, (2, model.nv - 6)):
        force = generator.uniform(-20, 20, 6)
        generalised = np.concatenate([np.zeros(6), torque]) + jacobian.T @ force
        acceleration = pin.aba(model, data, q, v, generalised)
        alone = np.linalg.solve(blocks.base, jacobian[:, :6].T @ force - bias)
        coupled = acceleration[:6] + np.linalg.solve(blocks.base, blocks.coupling @ acceleration[6:])
        assert_allclose(coupled, alone, rtol=SOLVED, atol=SOLVED)
        wrenches = np.hstack([force.reshape(2, 3), np.zeros((2, 3))])
        balance = whole_body_balance(model, (q, v, acceleration), FEET, wrenches)
        assert_allclose(balance.missing, 0.0, atol=SOLVED)


Torque = Callable[[float, np.ndarray], np.ndarray]


def along_a_motion(model: pin.Model, q: np.ndarray, v: np.ndarray, torque: Torque) -> tuple:
    """States (q, v) and the torques' work at the end, of M a + h = torque(t, q, v)."""
    data, nv = model.createData(), model.nv

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        delta, velocity = state[:nv], state[nv : 2 * nv]
        here, force = pin.integrate(model, q, delta), torque(t, velocity)
        chart = pin.dIntegrate(model, q, delta, pin.ARG1)
        acceleration = pin.aba(model, data, here, velocity, force)
        return np.concatenate([np.linalg.solve(chart, velocity), acceleration, [force @ velocity]])

    end = solve_ivp(
        rate, (0, DURATION), np.concatenate([np.zeros(nv), v, [0]]), method="DOP853", **INTEGRATION
    )
    final = end.y[:, -1]
    return pin.integrate(model, q, final[:nv]), final[nv : 2 * nv], final[-1]


def energy_of(model: pin.Model, q: np.ndarray, v: np.ndarray) -> float:
    potential = pin.computePotentialEnergy(model, model.createData(), q)
    return structure.kinetic_energy_parts(model, q, v).quadratic_form + potential


@pytest.mark.parametrize("name", ["three_joint_arm", "planar_hopper", "solo12", "planar:go2", "ur5"])
def test_energy_of_a_passive_fall_is_constant(name):
    model = named(name)
    q, v, _ = random_state(model, 10)
    end_q, end_v, _ = along_a_motion(model, q, v, lambda t, v: np.zeros(model.nv))
    start, end = energy_of(model, q, v), energy_of(model, end_q, end_v)
    exchanged = abs(structure.kinetic_energy_parts(model, end_q, end_v).quadratic_form)
    assert abs(end - start) < ENERGY_DRIFT * max(exchanged, 1.0)
    assert np.linalg.norm(end_v - v) > 0.1  # it did move


@pytest.mark.parametrize("name", ["three_joint_arm", "planar_hopper"])
def test_energy_grows_by_the_work_of_the_torques_and_friction_takes_it(name):
    """Passivity: what torques put in is what the energy gains, because M' - 2 C is skew."""
    model = named(name)
    q, v, _ = random_state(model, 11)
    push = np.random.default_rng(11).uniform(-5, 5, model.nv)
    end_q, end_v, work = along_a_motion(model, q, v, lambda t, v: push * np.sin(9 * t))
    assert_allclose(energy_of(model, end_q, end_v) - energy_of(model, q, v), work, rtol=0, atol=ENERGY_DRIFT)
    end_q, end_v, work = along_a_motion(model, q, v, lambda t, v: -0.5 * v)
    assert work < 0
    assert_allclose(energy_of(model, end_q, end_v) - energy_of(model, q, v), work, rtol=0, atol=ENERGY_DRIFT)


def test_bad_input_of_the_whole_body_is_refused():
    model = named("solo12")
    q, v, a = random_state(model, 0)
    with pytest.raises(InputError, match="a has shape"):
        whole_body_balance(model, (q, v, q))
    with pytest.raises(InputError, match="wrenches have shape"):
        whole_body_balance(model, (q, v, a), FEET, np.zeros((2, 3)))
    with pytest.raises(InputError, match="no frame 'hoof'"):
        whole_body_balance(model, (q, v, a), ["hoof"], np.zeros((1, 6)))
