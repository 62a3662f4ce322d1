"""Forward and inverse dynamics in contact against Pinocchio's own, finite differences and formulas."""

import numpy as np
import pinocchio as pin
import pytest

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
from trajopt.certify.contact.contact_dynamics import (
    ContactDynamics,
    ContactMotion,
    actuated_force,
    forward_dynamics,
    inverse_dynamics,
)
from trajopt.certify.contact.contact_set import ContactSet, contact_kinematics
from trajopt.certify.contact.impact import impact
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


@pytest.mark.parametrize(
    ("contacts", "arm", "message"),
    [
        ([("nowhere", 3)], None, "frame 'nowhere'"),
        ([("tool0", 2)], None, "dimension 2"),
        ([("tool0", 3)], 0.0, "moment_arm"),
        ([("tool0", 3)], np.nan, "moment_arm"),
    ],
)
def test_invalid_contacts_are_refused(contacts, arm, message):
    with pytest.raises(InputError, match=message):
        ContactSet.of(robot("ur5")[0], contacts, moment_arm=arm)


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
