"""Contacts whose rows depend on each other, and projected dynamics against the KKT system."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from tests.support.contact_cases import FEET, INDEPENDENT, Case, body, close, independent, vanishes
from tests.support.models import robot
from trajopt import Contact, InputError
from trajopt.certify import ContactSet, actuated_force, forward_dynamics
from trajopt.certify.contact.contact_dynamics import ContactDynamics, rows_with_actuator
from trajopt.certify.contact.contact_set import contact_kinematics
from trajopt.dynamics import contact_jacobian
from trajopt.robot import robot_file
from trajopt_library.lessons.contact_projection import (
    consistent_projector,
    least_norm_inverse_dynamics,
    null_space_projector,
    projected_forward_dynamics,
    projected_inverse_dynamics,
)

# Two ways to the same numbers, in a well-conditioned problem.
RELATIVE = 1e-9
# Rounding of rows that vanish, with numbers up to a few hundred.
ZERO = 1e-9
GRAVITY = 9.81
SIDES = ("left", "right")


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
    case, still = feet_without_lateral_joints(), np.zeros(14)
    found = forward_dynamics(case.model, case.q, still, still, case.contacts)
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
    twice = ContactSet.of(case.model, [("left_sole_link", 6), ("right_sole_link", 6)] * 2)
    once = forward_dynamics(case.model, case.q, case.v, case.tau, case.contacts)
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


def feet_without_lateral_joints() -> Case:
    model = pin.buildModelFromUrdf(
        str(robot_file("solo_description/robots/solo.urdf")), pin.JointModelFreeFlyer()
    )
    q = pin.neutral(model)
    q[7:] = [0.7, -1.4, 0.6, -1.3, -0.8, 1.5, -0.7, 1.2]
    generator = np.random.default_rng(4)
    v, tau = generator.standard_normal(model.nv), generator.standard_normal(model.nv)
    return Case(model, ContactSet.of(model, [(foot, 3) for foot in FEET]), q, v, tau)


def soles_twice() -> Case:
    case = independent("talos on its soles")
    return replace(case, contacts=ContactSet.of(case.model, [(f"{side}_sole_link", 6) for side in SIDES * 2]))


def links_that_cannot_move() -> Case:
    case = independent("ur5, point at a wall")
    return replace(case, contacts=ContactSet.of(case.model, [("base_link", 3), ("shoulder_link", 3)]))


def hinge_at_rest() -> Case:
    """Of which the pivots vanish exactly."""
    model = body({"left": (0.0, 0.2, 0.5), "right": (0.0, -0.2, 0.5)})
    contacts = ContactSet.of(model, [("left", 3), ("right", 3)])
    return Case(model, contacts, pin.neutral(model), np.zeros(6), np.arange(1.0, 7.0))


# Those of feet that move contradict each other.
DEPENDENT = [soles_twice, feet_without_lateral_joints, links_that_cannot_move, hinge_at_rest]


@pytest.mark.parametrize("build", DEPENDENT)
def test_compiled_dynamics_hold_dependent_rows_as_well_as_can_be_and_name_them(build):
    case = build()
    found = forward_dynamics(case.model, case.q, case.v, case.tau, case.contacts)
    compiled = ContactDynamics(case.model, case.contacts).compiled
    close(compiled.accelerations(case.q[None], case.v[None], case.tau[None])[0], found.acceleration, RELATIVE)
    assert len(compiled.redundant) == found.rank.rows - found.rank.delassus > 0
    dependent = {row for group in found.rank.dependencies for row in group.rows}
    assert {case.contacts.row_names[row] for row in compiled.redundant} <= dependent


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
