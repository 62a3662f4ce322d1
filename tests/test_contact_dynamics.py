"""Forward and inverse dynamics in contact against Pinocchio's own, finite differences and formulas."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from contact_cases import FEET, INDEPENDENT, Case, body, close, independent, pinocchio_constraints, vanishes
from robots_for_tests import robot

from trajopt.contact import Contact
from trajopt.contact_dynamics import (
    ContactDynamics,
    ContactMotion,
    actuated_force,
    forward_dynamics,
    inverse_dynamics,
)
from trajopt.contact_set import ContactSet, contact_kinematics
from trajopt.errors import InputError
from trajopt.impact import impact
from trajopt.model_quantities import contact_jacobian
from trajopt.robot_building import base_of
from trajopt.robot_data import robot_file

# Two ways to the same numbers, in a well-conditioned problem.
RELATIVE = 1e-9
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
    data, models, datas = pinocchio_constraints(case)
    exact = pin.ProximalSettings(1e-14, 0.0, 1)
    expected = pin.constraintDynamics(case.model, data, case.q, case.v, case.tau, models, datas, exact)
    found = solved(case)
    close(found.acceleration, expected, RELATIVE)
    forces = np.array([entry.contact_force.vector for entry in datas])
    close(case.contacts.stacked(found.wrenches), case.contacts.stacked(forces), RELATIVE)


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


def test_two_points_of_a_body_are_a_hinge_with_one_row_too_many():
    model = body({"left": (0.0, 0.2, 0.5), "right": (0.0, -0.2, 0.5)})
    contacts = ContactSet.of(model, [("left", 3), ("right", 3)])
    turn = np.array([0.0, 0.8, 0.0])
    v = np.concatenate([-np.cross(turn, [0.0, 0.0, 0.5]), turn])
    push = np.array([0.0, 6.0, 0.0, 0.0, 0.0, 0.0])
    found = forward_dynamics(model, pin.neutral(model), v, push, contacts)
    assert (found.rank.rows, found.rank.jacobian, found.rank.delassus) == (6, 5, 5)
    (group,) = found.rank.dependencies
    assert (group.rows, group.contacts, group.excess) == (("left y", "right y"), ("left", "right"), 1)
    assert "1 too many among left y, right y" in str(found.rank)
    vanishes(found.contact_acceleration, ZERO)
    vanishes(found.dynamics_residual, ZERO)
    close(found.wrenches[:, 1], np.array([-3.0, -3.0]), RELATIVE)  # the push, shared


def test_four_corners_of_a_foot_share_the_weight_evenly():
    corners = {f"corner{i}": (x, y, -0.1) for i, (x, y) in enumerate([(1, 1), (1, -1), (-1, 1), (-1, -1)])}
    model = body(corners, mass=8.0)
    contacts = ContactSet.of(model, [(name, 3) for name in corners])
    found = forward_dynamics(model, pin.neutral(model), np.zeros(6), np.zeros(6), contacts)
    assert (found.rank.rows, found.rank.delassus) == (12, 6)
    assert sum(group.excess for group in found.rank.dependencies) == 6
    vanishes(found.acceleration, ZERO)
    close(found.wrenches[:, :3], np.tile([0.0, 0.0, 2.0 * GRAVITY], (4, 1)), RELATIVE)


def test_legs_without_lateral_joints_leave_one_internal_force():
    model = pin.buildModelFromUrdf(
        str(robot_file("solo_description/robots/solo.urdf")), pin.JointModelFreeFlyer()
    )
    contacts = ContactSet.of(model, [(foot, 3) for foot in FEET])
    q = pin.neutral(model)
    q[7:] = [0.7, -1.4, 0.6, -1.3, -0.8, 1.5, -0.7, 1.2]
    found = forward_dynamics(model, q, np.zeros(model.nv), np.zeros(model.nv), contacts)
    assert (found.rank.rows, found.rank.jacobian, found.rank.delassus) == (12, 11, 11)
    (group,) = found.rank.dependencies
    assert group.rows == tuple(f"{foot} y" for foot in FEET)
    vanishes(found.contact_acceleration, ZERO)


def test_dependent_rows_are_named_axis_by_axis():
    case = independent("talos on its soles")
    soles = [
        Contact(
            frame=f"{side}_sole_link", name=f"{side} {copy}", kind="surface", half_length=0.1, half_width=0.05
        )
        for side in ("left", "right")
        for copy in ("a", "b")
    ]
    twice = ContactSet.of(case.model, soles)
    groups = forward_dynamics(case.model, case.q, case.v, case.tau, twice).rank.dependencies
    axes = ("x", "y", "z", "rx", "ry", "rz")
    expected = {(f"{side} a {axis}", f"{side} b {axis}") for side in ("left", "right") for axis in axes}
    assert {group.rows for group in groups} == expected


def test_contacts_given_twice_halve_the_wrenches_and_keep_the_motion():
    case = independent("talos on its soles")
    frames = list(zip(*_frames(case), strict=True))
    twice = ContactSet.of(case.model, frames * 2)
    once = solved(case)
    found = forward_dynamics(case.model, case.q, case.v, case.tau, twice)
    assert (found.rank.rows, found.rank.delassus) == (24, 12)
    assert sum(group.excess for group in found.rank.dependencies) == 12
    close(found.acceleration, once.acceleration, RELATIVE)
    close(found.wrenches, np.tile(once.wrenches / 2, (2, 1)), RELATIVE)
    quick = ContactDynamics(case.model, twice).acceleration(case.q, case.v, case.tau)
    close(quick, once.acceleration, RELATIVE)


def test_the_moment_arm_shares_out_wrenches_and_leaves_the_motion_alone():
    model = body({"sole": (0.0, 0.0, -0.5), "heel": (-0.3, 0.0, -0.5)})
    pitch = np.array([0.0, 0.0, 0.0, 0.0, 5.0, 0.0])
    found = [
        forward_dynamics(
            model,
            pin.neutral(model),
            np.zeros(6),
            pitch,
            ContactSet.of(model, [("sole", 6), ("heel", 3)], moment_arm=arm),
        )
        for arm in (0.1, 10.0)
    ]
    close(found[0].acceleration, found[1].acceleration, RELATIVE)
    totals = []
    for motion in found:
        lever = np.cross([-0.3, 0.0, 0.0], motion.wrenches[1, :3])
        totals.append(motion.wrenches[0, 3:] + lever)
        vanishes(motion.dynamics_residual, ZERO)
    close(totals[0], totals[1], RELATIVE)
    assert abs(found[0].wrenches[0, 4]) < abs(found[1].wrenches[0, 4])  # a short arm makes moments dear


def test_a_contact_that_cannot_move_is_of_rank_zero():
    model, _ = robot("ur5")
    contacts = ContactSet.of(
        model, [("base_link", 3), ("shoulder_link", 3)]
    )  # on the ground; on the first axis
    generator = np.random.default_rng(2)
    q, v, tau = (generator.standard_normal(6) for _ in range(3))
    found = forward_dynamics(model, q, v, tau, contacts)
    assert (found.rank.jacobian, found.rank.delassus) == (0, 0)
    assert {group.rows for group in found.rank.dependencies} == {(row,) for row in contacts.row_names}
    expected = pin.aba(model, model.createData(), q, v, tau)
    close(found.acceleration, expected, RELATIVE)
    vanishes(found.wrenches, 0.0)
    close(ContactDynamics(model, contacts).acceleration(q, v, tau), expected, RELATIVE)


def test_a_singular_wrist_leaves_its_motion_free():
    model, _ = robot("ur5")
    contacts = ContactSet.of(model, [("tool0", 6)])
    q = np.array([0.3, -1.1, 1.4, 0.2, 0.0, 0.7])  # axes of the fourth and the last joint are parallel
    turn = np.array([0.0, 0.0, 0.0, 1.0, 0.0, -1.0])
    tau = actuated_force(model, turn) + pin.nle(model, model.createData(), q, np.zeros(6))
    found = forward_dynamics(model, q, np.zeros(6), tau, contacts)
    assert (found.rank.jacobian, found.rank.delassus) == (5, 5)
    free = np.linalg.svd(contact_jacobian(model, q, [("tool0", 6)]))[2][-1]
    mass = pin.crba(model, model.createData(), q)
    close(found.acceleration, free * (free @ turn) / (free @ mass @ free), RELATIVE)
    near = forward_dynamics(model, q + 1e-4 * np.eye(6)[4], np.zeros(6), tau, contacts)
    assert near.rank.delassus == 6
    vanishes(near.acceleration, 1e-6)  # all six rows hold all six joints


def test_rows_that_contradict_each_other_are_met_in_least_squares_and_say_so():
    half, rate = 0.2, 3.0
    model = body({"left": (0.0, half, 0.0), "right": (0.0, -half, 0.0)})
    contacts = ContactSet.of(model, [("left", 3), ("right", 3)])
    v = np.array([0.0, 0.0, 0.0, 0.0, 0.0, rate])  # both points circle about their middle
    found = forward_dynamics(model, pin.neutral(model), v, np.zeros(6), contacts)
    close(found.contact_acceleration[:, 1], half * rate**2 * np.array([-1.0, 1.0]), RELATIVE)
    vanishes(found.contact_acceleration[:, [0, 2]], ZERO)
    vanishes(found.dynamics_residual, ZERO)
    assert np.linalg.norm(found.wrenches) < 2 * 2.0 * GRAVITY


@pytest.mark.parametrize(
    ("contacts", "arm", "message"),
    [
        ([("nowhere", 3)], None, "frame 'nowhere'"),
        ([("tool0", 2)], None, "dimension 2"),
        ([("tool0", 3)], 0.0, "moment_arm"),
        ([("tool0", 3)], np.nan, "moment_arm"),
    ],
)
def test_contacts_that_are_none_are_refused(contacts, arm, message):
    with pytest.raises(InputError, match=message):
        ContactSet.of(robot("ur5")[0], contacts, moment_arm=arm)


def test_states_of_wrong_shape_or_value_are_refused():
    model, _ = robot("ur5")
    contacts, six = ContactSet.of(model, [("tool0", 3)]), np.zeros(6)
    with pytest.raises(InputError, match="q of shape"):
        forward_dynamics(model, np.zeros(5), six, six, contacts)
    with pytest.raises(InputError, match="tau of shape"):
        forward_dynamics(model, six, six, np.full(6, np.nan), contacts)
    with pytest.raises(InputError, match="wrenches"):
        inverse_dynamics(model, (six, six, six), contacts, np.zeros((2, 6)))
    with pytest.raises(InputError, match="n_unactuated"):
        inverse_dynamics(model, (six, six, six), contacts, np.zeros((1, 6)), n_unactuated=7)
    with pytest.raises(InputError, match="torque of shape"):
        actuated_force(model, np.zeros(5))


def test_a_model_without_mass_is_refused():
    model = pin.Model()
    model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "massless")
    one = np.zeros(1)
    with pytest.raises(InputError, match="mass matrix"):
        forward_dynamics(model, one, one, one, ContactSet.of(model, []))
    assert np.isnan(ContactDynamics(model, ContactSet.of(model, [])).acceleration(one, one, one)).all()
