"""Newton-Euler and Lagrange against each other, closed forms and energies; bounds of the mass matrix."""

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.lecture_models import HALF_TORSO, THIGH, named, planar_hopper, three_joint_arm
from tests.support.models import JOINT_KINDS, random_state, robot
from trajopt.dynamics import rigid_body
from trajopt.dynamics.base_joint import position_limits
from trajopt.dynamics.model_quantities import generalized_force, mass_matrix_at
from trajopt.errors import InputError, UnsupportedJointError
from trajopt_library.lessons import lagrange
from trajopt_library.lessons.mass_bounds import a_priori_bounds, eigenvalue_range, random_postures
from trajopt_library.lessons.newton_euler import joint_forces, recursive_newton_euler
from trajopt_library.lessons.structure import mass_matrix_rate

# Both sides sum the same numbers of order 1 to 1e3 in another order.
SAME = {"rtol": 1e-10, "atol": 1e-10}
SEEDS = (0, 1)
MODELS = [
    "ur5", "kinova", "panda", "solo12", "talos", "planar:go2", "virtual:solo12", "three_joint_arm",
    "planar_hopper", *(f"joint:{kind}" for kind in JOINT_KINDS),
]  # fmt: skip
FEET = ("FL_FOOT", "HR_FOOT")


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", MODELS)
def test_torques_and_joint_forces_equal_pinocchios(name, seed):
    model = named(name)
    q, v, a = random_state(model, seed)
    forces, data = joint_forces(model, q, v, a), model.createData()
    assert_allclose(forces.tau, pin.rnea(model, data, q, v, a), **SAME)
    expected = np.array([data.f[index].vector for index in range(1, model.njoints)])
    assert_allclose(np.hstack([forces.force, forces.moment]), expected, **SAME)
    assert forces.joints == tuple(model.names)[1:]


@pytest.mark.parametrize("name", MODELS)
def test_constraint_forces_do_no_work_in_any_direction_of_their_joint(name):
    model = named(name)
    q, v, a = random_state(model, 2)
    forces = joint_forces(model, q, v, a)
    for index in range(1, model.njoints):
        joint = model.joints[index]
        data = joint.createData()
        joint.calc(data, q[joint.idx_q : joint.idx_q + joint.nq])
        subspace = np.reshape(np.asarray(data.S), (6, -1), order="F")
        carried = np.concatenate([forces.constraint_force[index - 1], forces.constraint_moment[index - 1]])
        assert_allclose(subspace.T @ carried, 0.0, atol=SAME["atol"])


def test_a_free_flyer_has_no_constraint_force_and_a_revolute_joint_five():
    model = named("solo12")
    forces = joint_forces(model, *random_state(model, 0))
    assert_allclose(forces.constraint_force[0], 0.0, atol=SAME["atol"])
    assert_allclose(forces.constraint_moment[0], 0.0, atol=SAME["atol"])
    axis = 0 if "RX" in model.joints[2].shortname() else 1
    others = [i for i in range(3) if i != axis]
    assert_allclose(forces.constraint_force[1], forces.force[1], **SAME)
    assert_allclose(forces.constraint_moment[1][others], forces.moment[1][others], **SAME)


def test_contact_wrenches_act_as_in_the_equations_of_motion_and_reach_the_joints():
    model = named("solo12")
    q, v, a = random_state(model, 3)
    wrenches = np.random.default_rng(3).uniform(-20, 20, (2, 6))
    forces = joint_forces(model, q, v, a, frames=FEET, wrenches=wrenches)
    ids, data = [model.getFrameId(foot) for foot in FEET], model.createData()
    assert_allclose(forces.tau, generalized_force(model, data, (q, v, a), ids, wrenches), **SAME)
    external = pin.StdVec_Force()
    external.extend(pin.Force.Zero() for _ in range(model.njoints))
    pin.framesForwardKinematics(model, data, q)
    for frame, wrench in zip(ids, wrenches, strict=True):
        joint = model.frames[frame].parentJoint
        at_foot = pin.SE3(np.eye(3), data.oMf[frame].translation)
        external[joint] = external[joint] + data.oMi[joint].actInv(at_foot.act(pin.Force(wrench)))
    pin.rnea(model, data, q, v, a, external)
    expected = np.array([data.f[index].vector for index in range(1, model.njoints)])
    assert_allclose(np.hstack([forces.force, forces.moment]), expected, **SAME)


def test_a_hanging_chain_at_rest_carries_the_weight_below_each_joint():
    model = three_joint_arm()
    q = random_state(model, 0)[0]
    forces, rest = joint_forces(model, q, np.zeros(3), np.zeros(3)), model.createData()
    pin.forwardKinematics(model, rest, q)
    masses = np.array([inertia.mass for inertia in list(model.inertias)[1:]])
    for index in range(3):
        world = rest.oMi[index + 1].rotation @ forces.force[index]
        assert_allclose(world, -masses[index:].sum() * model.gravity.linear, **SAME)


def test_the_lectures_formulas_for_revolute_joints_give_the_same():
    """The lecture's recursion word for word, with the I_i that its balance of moments has lost."""
    model = three_joint_arm()
    q, v, a = random_state(model, 4)
    axes, n = [np.array([0.0, 0, 1]), np.array([0.0, 1, 0]), np.array([0.0, 1, 0])], 3
    rotations = [pin.exp3(axis * angle) for axis, angle in zip(axes, q, strict=True)]  # R_i^(i-1)
    offsets = [model.jointPlacements[i + 1].translation for i in range(n)] + [np.zeros(3)]
    omega = alpha = np.zeros(3)
    gravity, states = model.gravity.linear, []
    end_acceleration = np.zeros(3)
    for i in range(n):
        inertia, to_link = model.inertias[i + 1], rotations[i].T
        omega = to_link @ omega + axes[i] * v[i]
        alpha = to_link @ alpha + axes[i] * a[i] + np.cross(omega, axes[i] * v[i])
        start = to_link @ end_acceleration
        gravity = to_link @ gravity
        to_end, to_centre = offsets[i + 1], inertia.lever
        end_acceleration = start + np.cross(alpha, to_end) + np.cross(omega, np.cross(omega, to_end))
        centre = start + np.cross(alpha, to_centre) + np.cross(omega, np.cross(omega, to_centre))
        states.append((inertia, omega, alpha, centre, gravity))
    force, moment, torque = np.zeros(3), np.zeros(3), np.zeros(n)
    for i in reversed(range(n)):
        inertia, omega, alpha, centre, gravity = states[i]
        outward = rotations[i + 1] if i + 1 < n else np.eye(3)
        next_force, next_moment = outward @ force, outward @ moment
        force = next_force + inertia.mass * centre - inertia.mass * gravity
        spin = inertia.inertia @ alpha + np.cross(omega, inertia.inertia @ omega)
        from_end = inertia.lever - offsets[i + 1]
        moment = next_moment - np.cross(force, inertia.lever) + np.cross(next_force, from_end) + spin
        torque[i] = axes[i] @ moment + model.armature[i] * a[i]
    forces = joint_forces(model, q, v, a)
    assert_allclose(forces.tau, torque, **SAME)
    assert_allclose(forces.force[0], force, **SAME)
    assert_allclose(forces.moment[0], moment, **SAME)


def test_derivatives_of_the_symbolic_function_are_pinocchios():
    model = named("ur5")
    q, v, a = random_state(model, 5)
    function = recursive_newton_euler(model)
    inputs = [function.sx_in(i) for i in range(3)]
    tau = function.call([*inputs, ca.SX(0, 1)])[0]
    slopes = ca.Function("slopes", inputs, [ca.jacobian(tau, symbol) for symbol in inputs])(q, v, a)
    data = model.createData()
    expected = pin.computeRNEADerivatives(model, data, q, v, a)
    for slope, reference in zip(slopes[:2], expected[:2], strict=True):
        assert_allclose(slope.full(), reference, **SAME)
    assert_allclose(slopes[2].full(), pin.crba(model, data, q), **SAME)


def test_a_function_is_built_once_for_the_content_of_a_model():
    model = robot("ur5")[0]
    heavier = model.copy()
    heavier.inertias[2] = pin.Inertia(9.0, np.zeros(3), np.eye(3))
    assert recursive_newton_euler(model) is recursive_newton_euler(model.copy())
    assert recursive_newton_euler(model) is not recursive_newton_euler(heavier)


def test_bad_input_is_refused():
    model = named("solo12")
    q, v, a = random_state(model, 0)
    with pytest.raises(InputError, match=r"q has shape \(3,\)"):
        joint_forces(model, q[:3], v, a)
    with pytest.raises(InputError, match=r"wrenches have shape"):
        joint_forces(model, q, v, a, frames=FEET, wrenches=np.zeros((1, 6)))
    with pytest.raises(InputError, match="no frame 'hoof'"):
        joint_forces(model, q, v, a, frames=["hoof"])
    with pytest.raises(InputError, match="0, 3, 6"):
        recursive_newton_euler(model, FEET, [3, 4])
    helical = pin.Model()
    helical.addJoint(0, pin.JointModelHX(0.1), pin.SE3.Identity(), "screw")
    with pytest.raises(UnsupportedJointError, match="'screw'"):
        recursive_newton_euler(helical)


# Sums of products of order 1 to 1e3, differentiated exactly: rounding only.
SAME_ENERGY = {"rtol": 1e-9, "atol": 1e-10}
ARMS = ["ur5", "kinova", "panda", "three_joint_arm"]
EVERY_BASE = ["planar_hopper", "virtual:solo12", "solo12", "talos_legs", "planar:go2"]
EVERY_JOINT = [f"joint:{kind}" for kind in JOINT_KINDS]
ENERGY_MODELS = [*ARMS, *EVERY_BASE, *EVERY_JOINT]


def value(function: ca.Function, *arguments: np.ndarray) -> np.ndarray:
    return function(*arguments).full().squeeze()


@pytest.mark.long
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", ENERGY_MODELS)
def test_lagranges_equations_equal_newton_euler(name, seed):
    model = named(name)
    q, v, a = random_state(model, seed)
    tau = value(lagrange.equations_of_motion(model), q, v, a)
    assert_allclose(tau, pin.rnea(model, model.createData(), q, v, a), **SAME_ENERGY)
    assert_allclose(tau, joint_forces(model, q, v, a).tau, **SAME_ENERGY)


@pytest.mark.long
@pytest.mark.parametrize("name", ENERGY_MODELS)
def test_energies_of_the_links_are_those_of_the_mass_matrix_and_of_pinocchio(name):
    model = named(name)
    data = model.createData()
    q, v, _ = random_state(model, 2)
    links, rotors = lagrange.kinetic_energies(model)(q, v)
    total = links.full().sum() + float(rotors)
    assert_allclose(total, v @ mass_matrix_at(model, q) @ v / 2, **SAME_ENERGY)
    assert_allclose(total, float(rigid_body.kinetic_energy(model)(q, v)), **SAME_ENERGY)
    assert_allclose(float(rotors), model.armature @ v**2 / 2, **SAME_ENERGY)
    potential = value(lagrange.potential_energies(model), q).sum()
    assert_allclose(potential, pin.computePotentialEnergy(model, data, q), **SAME_ENERGY)


@pytest.mark.long
@pytest.mark.parametrize("name", ENERGY_MODELS)
def test_inertia_matrix_and_gravity_are_pinocchios(name):
    model = named(name)
    data = model.createData()
    q, _, _ = random_state(model, 3)
    inertia = value(lagrange.inertia_matrix(model), q)
    assert_allclose(inertia, value(rigid_body.mass_matrix(model), q), **SAME_ENERGY)
    gravity = value(lagrange.gravity_forces(model), q)
    assert_allclose(gravity, pin.computeGeneralizedGravity(model, data, q), **SAME_ENERGY)


@pytest.mark.long
@pytest.mark.parametrize("name", ENERGY_MODELS)
def test_christoffel_form_gives_the_coriolis_forces_and_a_skew_matrix(name):
    model = named(name)
    data = model.createData()
    q, v, _ = random_state(model, 4)
    coriolis = value(lagrange.coriolis_matrix(model), q, v)
    forces = pin.nonLinearEffects(model, data, q, v) - pin.computeGeneralizedGravity(model, data, q)
    assert_allclose(coriolis @ v, forces, **SAME_ENERGY)
    skew = value(mass_matrix_rate(model), q, v) - 2 * coriolis
    assert_allclose(skew, -skew.T, **SAME_ENERGY)


@pytest.mark.parametrize("name", [name for name in ENERGY_MODELS if name != "joint:SphericalZYX"])
def test_christoffel_form_is_pinocchios_coriolis_matrix(name):
    """All but the spherical ZYX joint's, whose moving axes `pin.computeCoriolisMatrix` 4.1.0 leaves out."""
    model = named(name)
    q, v, _ = random_state(model, 4)
    expected = pin.computeCoriolisMatrix(model, model.createData(), q, v)
    assert_allclose(value(lagrange.coriolis_matrix(model), q, v), expected, **SAME_ENERGY)


@pytest.mark.parametrize("name", ["ur5", "three_joint_arm", "planar_hopper"])
def test_christoffel_form_is_the_lectures_sum_of_symbols(name):
    model = named(name)
    q, v, _ = random_state(model, 5)
    n, symbol = model.nv, ca.SX.sym("q", model.nv)
    inertia = rigid_body.mass_matrix(model)(symbol)
    slopes = ca.Function("slopes", [symbol], [ca.jacobian(ca.vec(inertia), symbol)])
    d = slopes(q).full().reshape((n, n, n), order="F")  # d[k, j, i] = dD_kj / dq_i
    c = (d + d.transpose(0, 2, 1) - d.transpose(2, 1, 0)) / 2  # c[k, j, i], symmetric in j and i
    assert_allclose(c, c.transpose(0, 2, 1), **SAME_ENERGY)
    assert_allclose(value(lagrange.coriolis_matrix(model), q, v), c @ v, **SAME_ENERGY)


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
    assert_allclose(tau, expected, **SAME_ENERGY)
    coriolis = value(lagrange.coriolis_matrix(model), np.array([q1, q2]), np.array([v1, v2]))
    assert_allclose(coriolis, [[h * v2, h * (v1 + v2)], [-h * v1, 0.0]], **SAME_ENERGY)


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
    assert_allclose(value(lagrange.equations_of_motion(model), *state), expected, **SAME_ENERGY)
    assert_allclose(pin.rnea(model, model.createData(), *state), expected, **SAME_ENERGY)


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
    assert_allclose(v @ value(lagrange.equations_of_motion(model), q, v, a), rate, **SAME_ENERGY)


def test_gravity_of_the_model_is_respected():
    model = three_joint_arm().copy()
    model.gravity.linear = np.array([1.0, -2.0, 3.0])
    q, v, a = random_state(model, 9)
    expected = pin.rnea(model, model.createData(), q, v, a)
    assert_allclose(value(lagrange.equations_of_motion(model), q, v, a), expected, **SAME_ENERGY)


def test_lagranges_functions_are_built_once_for_the_content_of_a_model():
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


def test_bad_input_of_mass_bounds_is_refused():
    model = robot("ur5")[0]
    for postures in (np.zeros(6), np.zeros((0, 6)), np.zeros((2, 7))):
        with pytest.raises(InputError, match=r"shape \(n, 6\)"):
            eigenvalue_range(model, postures)
    with pytest.raises(InputError, match="no joints"):
        a_priori_bounds(pin.Model())
    assert random_postures(three_joint_arm(), 0, 0).shape == (0, 3)
