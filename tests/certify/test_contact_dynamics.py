"""Dynamics in contact and rigid impacts against Pinocchio's own, finite differences, formulas and laws."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.linalg import expm

from tests.support.contact_cases import (
    INDEPENDENT,
    Case,
    body,
    close,
    independent,
    pinocchio_constraints,
    vanishes,
)
from tests.support.models import robot
from tests.support.refusals import refusals
from trajopt.certify.contact.contact_dynamics import (
    ContactDynamics,
    ContactMotion,
    actuated_force,
    forward_dynamics,
    inverse_dynamics,
)
from trajopt.certify.contact.contact_set import ContactSet, contact_kinematics
from trajopt.certify.contact.friction import cone_margins
from trajopt.certify.contact.impact import impact, momentum_of_links, total_wrench
from trajopt.dynamics.base_joint import base_of
from trajopt.dynamics.model_quantities import contact_jacobian
from trajopt.errors import InputError

# Two ways to the same numbers, in a well-conditioned problem.
RELATIVE = 1e-9
# The same for compiled dynamics where contacts are independent.
COMPILED = 1e-10
# Rounding of rows that vanish, with numbers up to a few hundred.
ZERO = 1e-9
# Central differences with a step of 1e-5 s: error of order 1e-10 times third derivatives, and rounding.
STEP, DIFFERENCE = 1e-5, 1e-7
GRAVITY, UP = 9.81, np.array([0.0, 0.0, 1.0])

cases = pytest.mark.parametrize("name", INDEPENDENT)


def solved(case: Case) -> ContactMotion:
    return forward_dynamics(case.model, case.q, case.v, case.tau, case.contacts)


def holding(case: Case) -> Case:
    """The case with a velocity that keeps its contacts in place."""
    v = impact(case.model, case.q, case.v, case.contacts).velocity
    return Case(case.model, case.contacts, case.q, v, case.tau)


def held_by_pinocchio(case: Case) -> tuple[np.ndarray, list]:
    """Acceleration by Pinocchio's `constraintDynamics`, and the data of its contacts."""
    data, models, datas = pinocchio_constraints(case)
    exact = pin.ProximalSettings(1e-14, 0.0, 1)
    return pin.constraintDynamics(case.model, data, case.q, case.v, case.tau, models, datas, exact), datas


def velocity_of_contacts(case: Case, time: float) -> np.ndarray:
    """Velocities of the contact frames at a time of the motion of constant v through q."""
    data = case.model.createData()
    pin.forwardKinematics(case.model, data, pin.integrate(case.model, case.q, time * case.v), case.v)
    found = [
        pin.getFrameVelocity(case.model, data, frame, pin.LOCAL_WORLD_ALIGNED).vector
        for frame in case.contacts.frames
    ]
    return case.contacts.stacked(np.array(found))


@cases
def test_jacobian_velocity_and_drift_are_those_of_the_frames(name):
    case = independent(name)
    model, contacts = case.model, case.contacts
    rows = contact_kinematics(model, model.createData(), case.q, case.v, contacts)
    frames = list(zip(*_frames(case), strict=True))
    close(rows.jacobian, contact_jacobian(model, case.q, frames), ZERO)
    close(rows.velocity, velocity_of_contacts(case, 0.0), RELATIVE)
    rate = (velocity_of_contacts(case, STEP) - velocity_of_contacts(case, -STEP)) / (2 * STEP)
    close(rows.drift, rate, DIFFERENCE)


def _frames(case: Case) -> tuple[list[str], tuple[int, ...]]:
    return [case.model.frames[frame].name for frame in case.contacts.frames], case.contacts.dimensions


@cases
def test_forward_dynamics_is_that_of_pinocchio_for_given_rows(name):
    case, data = independent(name), independent(name).model.createData()
    rows = contact_kinematics(case.model, data, case.q, case.v, case.contacts)
    expected = pin.forwardDynamics(case.model, data, case.q, case.v, case.tau, rows.jacobian, rows.drift)
    found = solved(case)
    close(found.acceleration, expected, RELATIVE)
    close(case.contacts.stacked(found.wrenches), data.lambda_c, RELATIVE)


@cases
def test_forward_dynamics_is_that_of_pinocchio_for_contacts_that_hold(name):
    # Pinocchio holds the spatial acceleration of 6-D contacts: the classical one where they do not move.
    case = holding(independent(name))
    expected, datas = held_by_pinocchio(case)
    found = solved(case)
    close(found.acceleration, expected, RELATIVE)
    forces = np.array([entry.contact_force.vector for entry in datas])
    close(case.contacts.stacked(found.wrenches), case.contacts.stacked(forces), RELATIVE)


@cases
def test_compiled_accelerations_are_those_of_pinocchios_constraint_dynamics(name):
    case = holding(independent(name))
    expected, _ = held_by_pinocchio(case)
    compiled = ContactDynamics(case.model, case.contacts).compiled
    found = compiled.accelerations(case.q[None], case.v[None], case.tau[None])
    close(found[0], expected, COMPILED)
    assert compiled.redundant == []


@cases
def test_both_rows_of_the_kkt_system_are_met(name):
    found = solved(independent(name))
    vanishes(found.dynamics_residual, ZERO)
    vanishes(found.contact_acceleration, ZERO)
    assert not found.rank.redundant
    assert found.rank.jacobian == found.rank.delassus == found.rank.rows
    assert found.rank.dependencies == ()
    assert "independent" in str(found.rank)


@cases
def test_the_quick_acceleration_is_the_reported_one(name):
    case = independent(name)
    quick = ContactDynamics(case.model, case.contacts).acceleration(case.q, case.v, case.tau)
    close(quick, solved(case).acceleration, RELATIVE)


@cases
def test_inverse_dynamics_returns_the_torques_of_the_motion(name):
    case = independent(name)
    base = {"freeflyer": 6, "planar": 3, "fixed": 0}[base_of(case.model)]
    torque = case.tau[base:]
    given = Case(case.model, case.contacts, case.q, case.v, actuated_force(case.model, torque))
    found = solved(given)
    motion = (case.q, case.v, found.acceleration)
    back = inverse_dynamics(case.model, motion, case.contacts, found.wrenches)
    close(back.torque, torque, RELATIVE)
    assert back.base_residual.shape == (base,)
    vanishes(back.base_residual, ZERO)


def test_without_contacts_the_dynamics_are_those_of_the_free_model():
    model, _ = robot("solo12")
    generator = np.random.default_rng(5)
    q = pin.integrate(model, pin.neutral(model), generator.standard_normal(model.nv))
    v, tau = generator.standard_normal(model.nv), generator.standard_normal(model.nv)
    none = ContactSet.of(model, [])
    expected = pin.aba(model, model.createData(), q, v, tau)
    found = forward_dynamics(model, q, v, tau, none)
    close(found.acceleration, expected, RELATIVE)
    close(ContactDynamics(model, none).acceleration(q, v, tau), expected, RELATIVE)
    assert found.wrenches.shape == (0, 6)
    assert not found.rank.redundant


def test_a_body_pinned_at_a_point_is_a_physical_pendulum():
    mass, inertia, length, angle, rate = 2.0, 0.3, 0.7, 0.4, 1.7
    model = body({"pin": (0.0, 0.0, length)}, mass, inertia)
    turn = pin.SE3(pin.exp3(np.array([0.0, -angle, 0.0])), np.zeros(3))
    q, omega = pin.SE3ToXYZQUAT(turn), np.array([0.0, -rate, 0.0])
    v = np.concatenate([-np.cross(omega, [0.0, 0.0, length]), omega])
    found = forward_dynamics(model, q, v, np.zeros(6), ContactSet.of(model, [("pin", 3)]))
    about_pin = inertia + mass * length**2
    angular = -mass * GRAVITY * length * np.sin(angle) / about_pin
    assert found.acceleration[4] == pytest.approx(-angular, rel=RELATIVE)
    along = np.array([-np.sin(angle), 0.0, np.cos(angle)])  # from the centre of mass to the pin
    across = np.array([np.cos(angle), 0.0, np.sin(angle)])
    centre = length * (angular * across + rate**2 * along)
    close(found.wrenches[0, :3], mass * (centre + UP * GRAVITY), RELATIVE)
    vanishes(found.wrenches[0, 3:], 0.0)


def test_a_held_mass_is_carried_by_its_wall():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "slide")
    inertia = pin.Inertia(3.0, np.zeros(3), 0.1 * np.eye(3))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.addJointFrame(joint, 0)
    tau = np.array([4.0, -5.0, 6.0])
    found = forward_dynamics(model, np.zeros(3), np.ones(3), tau, ContactSet.of(model, [("slide", 3)]))
    vanishes(found.acceleration, ZERO)
    close(found.wrenches[0, :3], -tau + [0.0, 0.0, 3.0 * GRAVITY], RELATIVE)


def test_a_model_of_one_joint_is_no_special_case():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "pivot")
    bob = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.8]))
    model.appendBodyToJoint(joint, pin.Inertia(2.0, np.zeros(3), np.zeros((3, 3))), bob)
    model.addFrame(pin.Frame("bob", joint, 0, bob, pin.OP_FRAME))
    contacts, angle = ContactSet.of(model, [("bob", 3)]), np.array([0.3])
    rows = contact_kinematics(model, model.createData(), angle, np.zeros(1), contacts)
    close(rows.jacobian, contact_jacobian(model, angle, [("bob", 3)]), ZERO)
    found = forward_dynamics(model, angle, np.zeros(1), np.zeros(1), contacts)
    vanishes(found.acceleration, ZERO)
    # the wall bears what would turn the pendulum, the pivot what pulls along the rod
    across = np.array([-np.cos(0.3), 0.0, np.sin(0.3)])
    close(found.wrenches[0, :3], across * 2.0 * GRAVITY * np.sin(0.3), RELATIVE)


test_invalid_contacts_are_refused = refusals(
    lambda contacts, arm: ContactSet.of(robot("ur5")[0], contacts, moment_arm=arm),
    ([("nowhere", 3)], None, "frame 'nowhere'"),
    ([("tool0", 2)], None, "dimension 2"),
    ([("tool0", 3)], 0.0, "moment_arm"),
    ([("tool0", 3)], np.nan, "moment_arm"),
)


def test_states_of_wrong_shape_or_value_are_refused():
    model, _ = robot("ur5")
    contacts, six = ContactSet.of(model, [("tool0", 3)]), np.zeros(6)
    with pytest.raises(InputError, match="q of shape"):
        forward_dynamics(model, np.zeros(5), six, six, contacts)
    with pytest.raises(InputError, match=r"^tau of forward_dynamics is .* finite numbers"):
        forward_dynamics(model, six, six, np.full(6, np.nan), contacts)
    with pytest.raises(InputError, match="wrenches"):
        inverse_dynamics(model, (six, six, six), contacts, np.zeros((2, 6)))
    with pytest.raises(InputError, match="actuated_rows"):
        inverse_dynamics(model, (six, six, six), contacts, np.zeros((1, 6)), actuated_rows=np.array([7]))
    with pytest.raises(InputError, match="torque of shape"):
        actuated_force(model, np.zeros(5))


def test_a_model_without_mass_is_refused():
    model = pin.Model()
    model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "massless")
    one = np.zeros(1)
    with pytest.raises(InputError, match="mass matrix"):
        forward_dynamics(model, one, one, one, ContactSet.of(model, []))
    assert np.isnan(ContactDynamics(model, ContactSet.of(model, [])).acceleration(one, one, one)).all()


IMPACT_ZERO = 1e-10
# Dampers stop the slowest motion of contacts to exp(-30), about 1e-13.
DECAY = 30.0


def mass_matrix(model: pin.Model, q: np.ndarray) -> np.ndarray:
    upper = np.triu(pin.crba(model, model.createData(), q))
    return upper + np.triu(upper, 1).T


@cases
def test_impacts_are_those_of_pinocchio(name):
    case = independent(name)
    data, models, datas = pinocchio_constraints(case)
    exact = pin.ProximalSettings(1e-14, 0.0, 1)
    expected = pin.impulseDynamics(case.model, data, case.q, case.v, models, datas, 0.0, exact)
    found = impact(case.model, case.q, case.v, case.contacts)
    close(found.velocity, expected, RELATIVE)
    impulses = np.array([entry.contact_force.vector for entry in datas])
    close(case.contacts.stacked(found.impulses), case.contacts.stacked(impulses), RELATIVE)


@cases
def test_impacts_are_those_of_pinocchio_for_given_rows(name):
    case = independent(name)
    data = case.model.createData()
    rows = contact_kinematics(case.model, data, case.q, case.v, case.contacts)
    expected = pin.impulseDynamics(case.model, data, case.q, case.v, rows.jacobian)
    found = impact(case.model, case.q, case.v, case.contacts)
    close(found.velocity, expected, RELATIVE)
    close(case.contacts.stacked(found.impulses), data.impulse_c, RELATIVE)


@cases
def test_contacts_rest_and_the_law_of_momentum_holds(name):
    case = independent(name)
    found = impact(case.model, case.q, case.v, case.contacts)
    vanishes(found.contact_velocity, IMPACT_ZERO)
    vanishes(found.dynamics_residual, IMPACT_ZERO)
    data = case.model.createData()
    pin.forwardKinematics(case.model, data, case.q, found.velocity)
    for frame, size in zip(case.contacts.frames, case.contacts.dimensions, strict=True):
        velocity = pin.getFrameVelocity(case.model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        vanishes(velocity.vector[:size], IMPACT_ZERO)


@cases
def test_energy_falls_by_that_of_the_velocity_jump(name):
    case = independent(name)
    found, mass = impact(case.model, case.q, case.v, case.contacts), mass_matrix(case.model, case.q)
    assert found.energy_before == pytest.approx(case.v @ mass @ case.v / 2, rel=RELATIVE)
    after = found.velocity @ mass @ found.velocity / 2
    assert found.energy_after == pytest.approx(after, rel=RELATIVE, abs=IMPACT_ZERO)
    assert found.energy_loss == pytest.approx(found.energy_before - found.energy_after, rel=RELATIVE)
    assert found.energy_loss > 0


def test_energies_are_those_of_the_links_and_their_rotors():
    case = independent("talos on its soles")
    bare = pin.Model(case.model)
    bare.armature[:] = 0.0
    links = pin.computeKineticEnergy(bare, bare.createData(), case.q, case.v)
    rotors = case.model.armature @ case.v**2 / 2
    found = impact(case.model, case.q, case.v, case.contacts)
    assert found.energy_before == pytest.approx(links + rotors, rel=RELATIVE)


@cases
def test_the_momentum_jump_is_the_impulse_of_contacts_and_root(name):
    case = independent(name)
    found = impact(case.model, case.q, case.v, case.contacts)
    before, after = (momentum_of_links(case.model, case.q, v) for v in (case.v, found.velocity))
    close(found.jump.linear, after.linear - before.linear, RELATIVE)
    point = np.array([0.3, -1.2, 0.5])
    about = total_wrench(case.model, case.q, case.contacts, found.impulses, point)
    close(found.impulse.about(point).angular, about.angular, RELATIVE)
    root = found.root_impulse
    if base_of(case.model) == "freeflyer":
        vanishes(root.linear, IMPACT_ZERO)
        vanishes(root.about(point).angular, IMPACT_ZERO)
    else:  # what the root cannot follow is borne by it
        assert np.linalg.norm(root.linear) > IMPACT_ZERO


def test_a_planar_root_bears_what_leaves_its_plane():
    case = independent("planar go2 on two feet")
    root = impact(case.model, case.q, case.v, case.contacts).root_impulse
    data = case.model.createData()
    pin.forwardKinematics(case.model, data, case.q)
    axis = case.model.jointPlacements[1].rotation[:, 2]
    vanishes(np.cross(axis, root.linear), IMPACT_ZERO)
    vanishes(np.array([axis @ root.angular]), IMPACT_ZERO)


def test_angular_momentum_about_a_single_point_is_conserved():
    model, _ = robot("solo12")
    case = independent("solo12 on two feet")
    contact = ContactSet.of(model, [("FL_FOOT", 3)])
    found = impact(model, case.q, case.v, contact)
    data = model.createData()
    pin.framesForwardKinematics(model, data, case.q)
    foot = data.oMf[contact.frames[0]].translation
    vanishes(found.jump.about(foot).angular, IMPACT_ZERO)
    assert np.linalg.norm(found.jump.linear) > 0.1


def test_a_level_rod_that_lands_on_one_end_turns_about_it():
    mass, length, speed = 2.0, 1.2, 3.0
    model = body({"end": (length / 2, 0.0, 0.0)}, mass, np.array([1e-3, 1.0, 1.0]) * mass * length**2 / 12)
    falling = np.array([0.0, 0.0, -speed, 0.0, 0.0, 0.0])
    found = impact(model, pin.neutral(model), falling, ContactSet.of(model, [("end", 3)]))
    expected = np.array([0.0, 0.0, -0.75 * speed, 0.0, 1.5 * speed / length, 0.0])
    close(found.velocity, expected * [1, 1, 1, 1, -1, 1], RELATIVE)
    close(found.impulses[0], np.array([0.0, 0.0, mass * speed / 4, 0.0, 0.0, 0.0]), RELATIVE)
    assert found.energy_loss == pytest.approx(mass * speed**2 / 8, rel=RELATIVE)


def test_a_point_mass_loses_all_and_a_pendulum_at_a_wall_too():
    model = body({"centre": (0.0, 0.0, 0.0)}, mass=1.5)
    v = np.array([1.0, -2.0, 3.0, 0.0, 0.0, 0.0])
    found = impact(model, pin.neutral(model), v, ContactSet.of(model, [("centre", 3)]))
    vanishes(found.velocity, IMPACT_ZERO)
    close(found.impulses[0, :3], -1.5 * v[:3], RELATIVE)
    pendulum = pin.Model()
    joint = pendulum.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "pivot")
    bob = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.8]))
    pendulum.appendBodyToJoint(joint, pin.Inertia(2.0, np.zeros(3), np.zeros((3, 3))), bob)
    pendulum.addFrame(pin.Frame("bob", joint, 0, bob, pin.OP_FRAME))
    one = ContactSet.of(pendulum, [("bob", 3)])
    stopped = impact(pendulum, np.zeros(1), np.array([1.7]), one)
    close(stopped.impulses[0, :3], np.array([2.0 * 0.8 * 1.7, 0.0, 0.0]), RELATIVE)
    # only the row across the rod can move; the others are borne by the pivot
    assert stopped.rank.delassus == 1
    assert {group.rows for group in stopped.rank.dependencies} == {("bob y",), ("bob z",)}


def test_contacts_that_stay_take_part():
    case = independent("solo12 on four feet")
    model = case.model
    staying = ContactSet.of(model, [("HL_FOOT", 3), ("HR_FOOT", 3)])
    before = impact(model, case.q, case.v, staying).velocity
    found = impact(model, case.q, before, case.contacts)
    vanishes(found.contact_velocity, IMPACT_ZERO)
    assert np.abs(found.impulses[2:]).max() > 1e-3  # those of the hind feet, which already rest
    alone = impact(model, case.q, before, ContactSet.of(model, [("FL_FOOT", 3), ("FR_FOOT", 3)]))
    rows = contact_kinematics(model, model.createData(), case.q, alone.velocity, staying)
    assert np.abs(rows.velocity).max() > 1e-3  # without them they would be torn off


def test_a_second_impact_of_the_same_contacts_does_nothing():
    case = independent("talos on its soles")
    once = impact(case.model, case.q, case.v, case.contacts)
    again = impact(case.model, case.q, once.velocity, case.contacts)
    close(again.velocity, once.velocity, RELATIVE)
    vanishes(again.impulses, IMPACT_ZERO * 1e2)
    vanishes(np.array([again.energy_loss]), IMPACT_ZERO)


def test_redundant_contacts_share_the_impulse():
    corners = {f"corner{i}": (x, y, -0.1) for i, (x, y) in enumerate([(1, 1), (1, -1), (-1, 1), (-1, -1)])}
    model = body(corners, mass=8.0)
    contacts = ContactSet.of(model, [(name, 3) for name in corners])
    falling = np.array([0.0, 0.0, -1.5, 0.0, 0.0, 0.0])
    found = impact(model, pin.neutral(model), falling, contacts)
    assert (found.rank.rows, found.rank.delassus, found.rank.redundant) == (12, 6, True)
    close(found.impulses[:, :3], np.tile([0.0, 0.0, 3.0], (4, 1)), RELATIVE)
    vanishes(found.velocity, IMPACT_ZERO)


@cases
def test_the_impact_is_the_limit_of_ever_stiffer_dampers(name):
    case = independent(name)
    jacobian = contact_kinematics(case.model, case.model.createData(), case.q, case.v, case.contacts).jacobian
    response = np.linalg.solve(mass_matrix(case.model, case.q), jacobian.T @ jacobian)
    slowest = np.sort(np.linalg.eigvals(response).real)[-len(jacobian)]
    found = impact(case.model, case.q, case.v, case.contacts)
    close(expm(-DECAY / slowest * response) @ case.v, found.velocity, RELATIVE)


def test_without_contacts_nothing_happens():
    case = independent("ur5, point at a wall")
    found = impact(case.model, case.q, case.v, ContactSet.of(case.model, []))
    np.testing.assert_array_equal(found.velocity, case.v)
    assert found.energy_loss == 0.0
    assert found.impulses.shape == (0, 6)


def test_cone_margins_are_distances_to_coulombs_limit():
    wall = np.array([-1.0, 0.0, 0.0])
    forces = np.array([[-2.0, 0.6, 0.8], [-2.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    np.testing.assert_allclose(cone_margins(forces, wall, 0.5), [0.0, 1.0, -1.0], atol=1e-15)
    np.testing.assert_allclose(cone_margins(forces, wall, 0.0), [-1.0, 0.0, -1.0], atol=1e-15)
    wrenches = np.hstack([forces, np.full((3, 3), 9.0)])
    normals = np.array([wall, wall, -wall])
    np.testing.assert_allclose(cone_margins(wrenches, normals, [0.5, 0.5, 2.0]), [0.0, 1.0, 2.0], atol=1e-15)
    assert cone_margins(np.zeros((0, 3)), wall, 0.5).shape == (0,)


test_cones_of_wrong_input_are_refused = refusals(
    lambda forces, normals, friction: cone_margins(forces, normals, friction),
    (np.ones(3), np.ones(3), 0.5, "wrenches"),
    (np.ones((2, 3)), np.ones((3, 3)), 0.5, "shapes"),
    (np.ones((2, 3)), [0.0, 0.0, 2.0], 0.5, "length one"),
    (np.ones((2, 3)), [0.0, 0.0, np.nan], 0.5, "normals of cone_margins"),
    (np.ones((2, 3)), [0.0, 0.0, 1.0], -0.5, "friction"),
)


def test_velocities_that_are_not_finite_are_refused():
    case = independent("ur5, point at a wall")
    with pytest.raises(InputError, match="v_minus"):
        impact(case.model, case.q, np.full(6, np.inf), case.contacts)
