"""The robot as one body: Newton and Euler, facts 1, 2 and 6 of the lecture, passivity along motions."""

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from tests.support.lecture_models import BASE_JOINTS, BASE_SIZES, FIXED, FLOATING, link_momentum_matrix, named
from tests.support.models import random_state
from trajopt.dynamics.model_quantities import contact_jacobian
from trajopt.errors import InputError
from trajopt_library.lessons import structure
from trajopt_library.lessons.newton_euler import joint_forces
from trajopt_library.lessons.whole_body import whole_body_balance

# Two ways of summing the same numbers of order 1 to 1e3.
SAME = {"rtol": 1e-9, "atol": 1e-10}
# Accelerations of a light leg are of order 1e3 rad/s^2, and forward dynamics has solved for them.
SOLVED = 1e-8
# Central differences of step 1e-5 on entries up to 1e2.
DIFFERENCE_STEP = 1e-5
DIFFERENCE = {"rtol": 1e-6, "atol": 1e-6}
# DOP853 at relative 1e-11 over half a second: its local errors add up.
INTEGRATION = {"rtol": 1e-11, "atol": 1e-12}
ENERGY_DRIFT = 1e-8  # of the energy's scale, or J

SEEDS = (0, 1)
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


def test_bad_input_is_refused():
    model = named("solo12")
    q, v, a = random_state(model, 0)
    with pytest.raises(InputError, match="a has shape"):
        whole_body_balance(model, (q, v, q))
    with pytest.raises(InputError, match="wrenches have shape"):
        whole_body_balance(model, (q, v, a), FEET, np.zeros((2, 3)))
    with pytest.raises(InputError, match="no frame 'hoof'"):
        whole_body_balance(model, (q, v, a), ["hoof"], np.zeros((1, 6)))
