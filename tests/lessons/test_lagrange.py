"""Lagrange's equations of the links' energies against Newton-Euler, closed forms and the energy balance."""

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.lecture_models import HALF_TORSO, THIGH, named, planar_hopper, three_joint_arm
from tests.support.models import JOINT_KINDS, random_state, robot
from trajopt.dynamics import rigid_body
from trajopt.dynamics.model_quantities import mass_matrix_at
from trajopt.errors import UnsupportedJointError
from trajopt_library.lessons import lagrange
from trajopt_library.lessons.newton_euler import joint_forces
from trajopt_library.lessons.structure import mass_matrix_rate

# Sums of products of order 1 to 1e3, differentiated exactly: rounding only.
SAME = {"rtol": 1e-9, "atol": 1e-10}
SEEDS = (0, 1)
ARMS = ["ur5", "kinova", "panda", "three_joint_arm"]
EVERY_BASE = ["planar_hopper", "virtual:solo12", "solo12", "talos_legs", "planar:go2"]
EVERY_JOINT = [f"joint:{kind}" for kind in JOINT_KINDS]
MODELS = [*ARMS, *EVERY_BASE, *EVERY_JOINT]


def value(function: ca.Function, *arguments: np.ndarray) -> np.ndarray:
    return function(*arguments).full().squeeze()


@pytest.mark.long
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", MODELS)
def test_lagranges_equations_equal_newton_euler(name, seed):
    model = named(name)
    q, v, a = random_state(model, seed)
    tau = value(lagrange.equations_of_motion(model), q, v, a)
    assert_allclose(tau, pin.rnea(model, model.createData(), q, v, a), **SAME)
    assert_allclose(tau, joint_forces(model, q, v, a).tau, **SAME)


@pytest.mark.long
@pytest.mark.parametrize("name", MODELS)
def test_energies_of_the_links_are_those_of_the_mass_matrix_and_of_pinocchio(name):
    model = named(name)
    data = model.createData()
    q, v, _ = random_state(model, 2)
    links, rotors = lagrange.kinetic_energies(model)(q, v)
    total = links.full().sum() + float(rotors)
    assert_allclose(total, v @ mass_matrix_at(model, q) @ v / 2, **SAME)
    assert_allclose(total, float(rigid_body.kinetic_energy(model)(q, v)), **SAME)
    assert_allclose(float(rotors), model.armature @ v**2 / 2, **SAME)
    potential = value(lagrange.potential_energies(model), q).sum()
    assert_allclose(potential, pin.computePotentialEnergy(model, data, q), **SAME)


@pytest.mark.long
@pytest.mark.parametrize("name", MODELS)
def test_inertia_matrix_and_gravity_are_pinocchios(name):
    model = named(name)
    data = model.createData()
    q, _, _ = random_state(model, 3)
    inertia = value(lagrange.inertia_matrix(model), q)
    assert_allclose(inertia, value(rigid_body.mass_matrix(model), q), **SAME)
    gravity = value(lagrange.gravity_forces(model), q)
    assert_allclose(gravity, pin.computeGeneralizedGravity(model, data, q), **SAME)


@pytest.mark.long
@pytest.mark.parametrize("name", MODELS)
def test_christoffel_form_gives_the_coriolis_forces_and_a_skew_matrix(name):
    model = named(name)
    data = model.createData()
    q, v, _ = random_state(model, 4)
    coriolis = value(lagrange.coriolis_matrix(model), q, v)
    forces = pin.nonLinearEffects(model, data, q, v) - pin.computeGeneralizedGravity(model, data, q)
    assert_allclose(coriolis @ v, forces, **SAME)
    skew = value(mass_matrix_rate(model), q, v) - 2 * coriolis
    assert_allclose(skew, -skew.T, **SAME)


@pytest.mark.parametrize("name", [name for name in MODELS if name != "joint:SphericalZYX"])
def test_christoffel_form_is_pinocchios_coriolis_matrix(name):
    """All but the spherical ZYX joint's, whose moving axes `pin.computeCoriolisMatrix` 4.1.0 leaves out."""
    model = named(name)
    q, v, _ = random_state(model, 4)
    expected = pin.computeCoriolisMatrix(model, model.createData(), q, v)
    assert_allclose(value(lagrange.coriolis_matrix(model), q, v), expected, **SAME)


@pytest.mark.parametrize("name", ["ur5", "three_joint_arm", "planar_hopper"])
def test_christoffel_form_is_the_lectures_sum_of_symbols(name):
    model = named(name)
    q, v, _ = random_state(model, 5)
    n, symbol = model.nv, ca.SX.sym("q", model.nv)
    inertia = rigid_body.mass_matrix(model)(symbol)
    slopes = ca.Function("slopes", [symbol], [ca.jacobian(ca.vec(inertia), symbol)])
    d = slopes(q).full().reshape((n, n, n), order="F")  # d[k, j, i] = dD_kj / dq_i
    c = (d + d.transpose(0, 2, 1) - d.transpose(2, 1, 0)) / 2  # c[k, j, i], symmetric in j and i
    assert_allclose(c, c.transpose(0, 2, 1), **SAME)
    assert_allclose(value(lagrange.coriolis_matrix(model), q, v), c @ v, **SAME)


def test_two_link_arm_is_the_textbooks():
    """Spong, Hutchinson, Vidyasagar (2006), section 7.4: the planar elbow manipulator."""
    m1, m2, l1, lc1, lc2, i1, i2, g = 2.0, 1.5, 0.6, 0.3, 0.25, 0.05, 0.03, 9.81
    model = pin.Model()
    upright = pin.SE3(pin.exp3(np.array([np.pi / 2, 0.0, 0.0])), np.zeros(3))  # z to -y: x-z is the plane
    first = model.addJoint(0, pin.JointModelRZ(), upright, "first")
    place = pin.SE3(np.eye(3), np.array([l1, 0.0, 0.0]))
    second = model.addJoint(first, pin.JointModelRZ(), place, "second")
    model.inertias[first] = pin.Inertia(m1, np.array([lc1, 0.0, 0.0]), np.diag([0.02, 0.04, i1]))
    model.inertias[second] = pin.Inertia(m2, np.array([lc2, 0.0, 0.0]), np.diag([0.01, 0.02, i2]))
    (q1, q2), (v1, v2), (a1, a2) = (state[:2] for state in random_state(model, 6))
    d12 = m2 * (lc2**2 + l1 * lc2 * np.cos(q2)) + i2
    d11 = m1 * lc1**2 + m2 * (l1**2 + lc2**2 + 2 * l1 * lc2 * np.cos(q2)) + i1 + i2
    d22, h = m2 * lc2**2 + i2, -m2 * l1 * lc2 * np.sin(q2)
    g1 = (m1 * lc1 + m2 * l1) * g * np.cos(q1) + m2 * lc2 * g * np.cos(q1 + q2)
    expected = [
        d11 * a1 + d12 * a2 + 2 * h * v1 * v2 + h * v2**2 + g1,
        d12 * a1 + d22 * a2 - h * v1**2 + m2 * lc2 * g * np.cos(q1 + q2),
    ]
    tau = value(
        lagrange.equations_of_motion(model), *(np.array(pair) for pair in ((q1, q2), (v1, v2), (a1, a2)))
    )
    assert_allclose(tau, expected, **SAME)
    coriolis = value(lagrange.coriolis_matrix(model), np.array([q1, q2]), np.array([v1, v2]))
    assert_allclose(coriolis, [[h * v2, h * (v1 + v2)], [-h * v1, 0.0]], **SAME)


def test_planar_hopper_is_the_derivation_from_its_points():
    """The lecture's hopper, its links' positions written by hand in x, z and absolute angles."""
    model = planar_hopper()
    q, v, a = (ca.SX.sym(name, 5) for name in "qva")
    angles = ca.vertcat(q[2], q[2] + q[3], q[2] + q[3] + q[4])

    def below(angle: ca.SX, distance: float) -> ca.SX:
        """A point below, turned by a pitch about y (nose down)."""
        return -distance * ca.vertcat(ca.sin(angle), ca.cos(angle))

    offset = model.inertias[3].lever
    hip = q[:2] + below(angles[0], HALF_TORSO)
    knee = hip + below(angles[1], THIGH)
    torso = q[:2] + offset[0] * ca.vertcat(ca.cos(angles[0]), -ca.sin(angles[0]))
    centres = [torso, hip + below(angles[1], THIGH / 2), knee + below(angles[2], -model.inertias[5].lever[2])]
    kinetic, potential = ca.dot(v[3:], model.armature[3:] * v[3:]) / 2, 0
    for k, centre in enumerate(centres):
        inertia = model.inertias[3 + k]
        speed, turn = ca.jtimes(centre, q, v), ca.jtimes(angles[k], q, v)
        kinetic += (inertia.mass * ca.sumsqr(speed) + inertia.inertia[1, 1] * turn**2) / 2
        potential += inertia.mass * 9.81 * centre[1]
    momentum = ca.gradient(kinetic, v)
    tau = ca.jtimes(momentum, q, v) + ca.jtimes(momentum, v, a) - ca.gradient(kinetic - potential, q)
    state = random_state(model, 7)
    expected = ca.Function("hopper", [q, v, a], [tau])(*state).full().ravel()
    assert_allclose(value(lagrange.equations_of_motion(model), *state), expected, **SAME)
    assert_allclose(pin.rnea(model, model.createData(), *state), expected, **SAME)


@pytest.mark.parametrize("name", ["three_joint_arm", "solo12", "planar:go2"])
def test_power_of_the_generalised_forces_is_the_rate_of_the_energy(name):
    model = named(name)
    q, v, a = random_state(model, 8)
    t = ca.SX.sym("t")
    moved = rigid_body.integrate(model)(q, t * v + t**2 / 2 * a)
    # v' = a at t = 0 in exponential coordinates; the energy's rate takes only first derivatives there
    links, rotors = lagrange.kinetic_energies(model)(moved, v + t * a)
    energy = ca.sum1(links) + rotors + ca.sum1(lagrange.potential_energies(model)(moved))
    rate = float(ca.Function("rate", [t], [ca.jacobian(energy, t)])(0.0))
    assert_allclose(v @ value(lagrange.equations_of_motion(model), q, v, a), rate, **SAME)


def test_gravity_of_the_model_is_respected():
    model = three_joint_arm().copy()
    model.gravity.linear = np.array([1.0, -2.0, 3.0])
    q, v, a = random_state(model, 9)
    expected = pin.rnea(model, model.createData(), q, v, a)
    assert_allclose(value(lagrange.equations_of_motion(model), q, v, a), expected, **SAME)


def test_a_function_is_built_once_for_the_content_of_a_model():
    model = robot("ur5")[0]
    lighter = model.copy()
    lighter.armature[0] = 0.0
    assert lagrange.equations_of_motion(model) is lagrange.equations_of_motion(model.copy())
    assert lagrange.equations_of_motion(model) is not lagrange.equations_of_motion(lighter)


def test_unsupported_joint_is_named():
    model = pin.Model()
    model.addJoint(0, pin.JointModelHX(0.1), pin.SE3.Identity(), "screw")
    for derive in (lagrange.equations_of_motion, lagrange.coriolis_matrix, lagrange.kinetic_energies):
        with pytest.raises(UnsupportedJointError, match="'screw' is of kind HX"):
            derive(model)
