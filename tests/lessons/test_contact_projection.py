"""Projected dynamics against the KKT system, and torques against least squares."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from tests.support.contact_cases import INDEPENDENT, Case, body, close, independent, vanishes
from trajopt.certify.contact.contact_dynamics import actuated_force, forward_dynamics, rows_with_actuator
from trajopt.certify.contact.contact_set import ContactSet, contact_kinematics
from trajopt.errors import InputError
from trajopt_library.lessons.contact_projection import (
    consistent_projector,
    least_norm_inverse_dynamics,
    null_space_projector,
    projected_forward_dynamics,
    projected_inverse_dynamics,
)

# Two ways to the same numbers; P depends on metres and radians of v, which costs digits.
RELATIVE = 1e-9
ZERO = 1e-9
# The difference falls with the square of the scale, from a few thousand N m at a scale of one.
DEAR, NEARLY = 1e-5, 1e-4

cases = pytest.mark.parametrize("name", INDEPENDENT)


def twice(case: Case) -> Case:
    """The case with every contact given two times."""
    names = [case.model.frames[frame].name for frame in case.contacts.frames]
    frames = list(zip(names, case.contacts.dimensions, strict=True))
    return replace(case, contacts=ContactSet.of(case.model, frames * 2))


def driven(case: Case) -> tuple[Case, np.ndarray]:
    """The case with actuated rows alone, and its acceleration."""
    tau = actuated_force(case.model, case.tau[rows_with_actuator(case.model)])
    found = forward_dynamics(case.model, case.q, case.v, tau, case.contacts)
    return replace(case, tau=tau), found.acceleration


def mass_of_case(case: Case) -> np.ndarray:
    upper = np.triu(pin.crba(case.model, case.model.createData(), case.q))
    return upper + np.triu(upper, 1).T


@cases
@pytest.mark.parametrize("change", [lambda case: case, twice], ids=["independent", "redundant"])
def test_projected_dynamics_are_those_of_the_kkt_system(name, change):
    case = change(independent(name))
    expected = forward_dynamics(case.model, case.q, case.v, case.tau, case.contacts).acceleration
    found = projected_forward_dynamics(case.model, case.q, case.v, case.tau, case.contacts)
    close(found, expected, RELATIVE)
    rows = contact_kinematics(case.model, case.model.createData(), case.q, case.v, case.contacts)
    vanishes(rows.jacobian @ found + rows.drift, ZERO)


@cases
@pytest.mark.parametrize("change", [lambda case: case, twice], ids=["independent", "redundant"])
def test_the_consistent_projector_gives_the_acceleration_of_the_kkt_system(name, change):
    case = change(independent(name))
    data, mass = case.model.createData(), mass_of_case(case)
    rows = contact_kinematics(case.model, data, case.q, case.v, case.contacts)
    projector = consistent_projector(mass, case.contacts, rows.jacobian)
    force = case.tau - pin.nle(case.model, data, case.q, case.v)
    inverse = np.linalg.inv(mass)
    held = inverse @ rows.jacobian.T @ np.linalg.pinv(rows.jacobian @ inverse @ rows.jacobian.T, rcond=1e-10)
    found = projector @ inverse @ force - held @ rows.drift
    close(found, forward_dynamics(case.model, case.q, case.v, case.tau, case.contacts).acceleration, 1e-8)


@cases
def test_projectors_project_onto_motions_that_contacts_allow(name):
    case = independent(name)
    mass = mass_of_case(case)
    jacobian = contact_kinematics(case.model, case.model.createData(), case.q, case.v, case.contacts).jacobian
    orthogonal = null_space_projector(jacobian)
    consistent = consistent_projector(mass, case.contacts, jacobian)
    for projector in (orthogonal, consistent):
        close(projector @ projector, projector, RELATIVE)
        vanishes(jacobian @ projector, ZERO)
        assert np.trace(projector) == pytest.approx(case.model.nv - len(jacobian), abs=ZERO)
    close(orthogonal, orthogonal.T, RELATIVE)
    close(mass @ consistent, (mass @ consistent).T, RELATIVE)


@cases
def test_projected_torques_give_the_motion_and_none_are_less(name):
    case, acceleration = driven(independent(name))
    model, base = case.model, int(rows_with_actuator(case.model)[0])
    found = projected_inverse_dynamics(model, (case.q, case.v, acceleration), case.contacts)
    vanishes(found.residual, ZERO)
    vanishes(found.contact_acceleration, ZERO)
    moved = forward_dynamics(model, case.q, case.v, actuated_force(model, found.torque), case.contacts)
    close(moved.acceleration, acceleration, RELATIVE)
    close(moved.wrenches, found.wrenches, RELATIVE)
    jacobian = contact_kinematics(model, model.createData(), case.q, case.v, case.contacts).jacobian
    free = pin.rnea(model, model.createData(), case.q, case.v, acceleration)
    select = np.eye(model.nv)[:, base:]
    # tau = tau0 + Z y solves the same rows for every y; the least has no part along Z
    both = np.linalg.lstsq(np.hstack([select, jacobian.T]), free, rcond=None)[0]
    assert np.linalg.norm(found.torque) <= np.linalg.norm(both[: model.nv - base]) + ZERO
    internal = select.T @ jacobian.T @ null_space_projector(jacobian[:, :base].T)
    vanishes(internal.T @ found.torque, 1e-7)


@cases
def test_least_norm_torques_are_the_pseudo_inverse_of_the_lecture(name):
    case, acceleration = driven(independent(name))
    model, base = case.model, int(rows_with_actuator(case.model)[0])
    found = least_norm_inverse_dynamics(
        model, (case.q, case.v, acceleration), replace(case.contacts, moment_arm=1.0)
    )
    jacobian = contact_kinematics(model, model.createData(), case.q, case.v, case.contacts).jacobian
    needed = pin.rnea(model, model.createData(), case.q, case.v, acceleration)
    columns = np.hstack([jacobian.T, np.eye(model.nv)[:, base:]])
    expected = np.linalg.pinv(columns) @ needed
    close(case.contacts.stacked(found.wrenches), expected[: len(jacobian)], RELATIVE)
    close(found.torque, expected[len(jacobian) :], RELATIVE)
    vanishes(found.residual, ZERO)


@cases
def test_torques_that_are_dear_tend_to_the_least_ones(name):
    case, acceleration = driven(independent(name))
    motion = (case.q, case.v, acceleration)
    least = projected_inverse_dynamics(case.model, motion, case.contacts)
    dear = least_norm_inverse_dynamics(case.model, motion, case.contacts, torque_scale=DEAR)
    close(dear.torque, least.torque, NEARLY)
    close(dear.wrenches, least.wrenches, NEARLY)


def test_a_robot_on_two_points_cannot_have_every_motion():
    two, four = independent("solo12 on two feet"), independent("solo12 on four feet")
    for case, able in ((two, False), (four, True)):
        # tau of a case acts on the base too: its motion is not one of the actuators
        found = forward_dynamics(case.model, case.q, case.v, case.tau, case.contacts)
        motion = (case.q, case.v, found.acceleration)
        torques = projected_inverse_dynamics(case.model, motion, case.contacts)
        assert torques.fully_actuated is able
        assert bool(np.abs(torques.residual).max() < ZERO) == able


def test_a_motion_against_the_contacts_is_reported():
    case = independent("ur5, point at a wall")
    motion = (case.q, np.zeros(6), np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0]))
    found = projected_inverse_dynamics(case.model, motion, case.contacts)
    data = case.model.createData()
    pin.forwardKinematics(case.model, data, *motion)
    frame = case.contacts.frames[0]
    expected = pin.getFrameClassicalAcceleration(case.model, data, frame, pin.LOCAL_WORLD_ALIGNED)
    close(found.contact_acceleration[0, :3], expected.linear, RELATIVE)
    assert np.linalg.norm(expected.linear) > 0.1


def test_what_is_held_altogether_needs_no_torque():
    case = independent("ur5, flange at a wall")
    found = projected_inverse_dynamics(case.model, (case.q, np.zeros(6), np.zeros(6)), case.contacts)
    vanishes(found.torque, ZERO)
    vanishes(found.residual, ZERO)
    assert found.fully_actuated


def test_rows_without_an_actuator_may_be_named():
    model = body({"a": (0.1, 0.0, 0.0)})
    contacts = ContactSet.of(model, [("a", 3)])
    motion = (pin.neutral(model), np.zeros(6), np.zeros(6))
    driven_turns = projected_inverse_dynamics(model, motion, contacts, actuated_rows=np.arange(3, model.nv))
    assert driven_turns.torque.shape == (3,)
    assert driven_turns.fully_actuated
    assert projected_inverse_dynamics(model, motion, contacts).torque.shape == (0,)


def test_torque_scales_must_be_positive_and_of_the_actuators():
    case = independent("ur5, point at a wall")
    motion = (case.q, case.v, np.zeros(6))
    for scale in (0.0, np.ones(5), np.nan):
        with pytest.raises(InputError, match="torque_scale"):
            least_norm_inverse_dynamics(case.model, motion, case.contacts, torque_scale=scale)
