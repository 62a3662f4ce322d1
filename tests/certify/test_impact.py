"""Rigid impacts against Pinocchio's own, formulas, and the laws of momentum and energy."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.linalg import expm

from tests.support.contact_cases import INDEPENDENT, body, close, independent, pinocchio_constraints, vanishes
from tests.support.models import robot
from trajopt.certify.contact.contact_set import ContactSet, contact_kinematics
from trajopt.certify.contact.friction import cone_margins
from trajopt.certify.contact.impact import impact, momentum_of_links, total_wrench
from trajopt.dynamics.base_joint import base_of
from trajopt.errors import InputError

# Two ways to the same numbers, in a well-conditioned problem; rounding of what vanishes.
RELATIVE = 1e-9
ZERO = 1e-10
# Dampers stop the slowest motion of contacts to exp(-30), about 1e-13.
DECAY = 30.0

cases = pytest.mark.parametrize("name", INDEPENDENT)


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
    vanishes(found.contact_velocity, ZERO)
    vanishes(found.dynamics_residual, ZERO)
    data = case.model.createData()
    pin.forwardKinematics(case.model, data, case.q, found.velocity)
    for frame, size in zip(case.contacts.frames, case.contacts.dimensions, strict=True):
        velocity = pin.getFrameVelocity(case.model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        vanishes(velocity.vector[:size], ZERO)


@cases
def test_energy_falls_by_that_of_the_velocity_jump(name):
    case = independent(name)
    found, mass = impact(case.model, case.q, case.v, case.contacts), mass_matrix(case.model, case.q)
    assert found.energy_before == pytest.approx(case.v @ mass @ case.v / 2, rel=RELATIVE)
    after = found.velocity @ mass @ found.velocity / 2
    assert found.energy_after == pytest.approx(after, rel=RELATIVE, abs=ZERO)
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
        vanishes(root.linear, ZERO)
        vanishes(root.about(point).angular, ZERO)
    else:  # what the root cannot follow is borne by it
        assert np.linalg.norm(root.linear) > ZERO


def test_a_planar_root_bears_what_leaves_its_plane():
    case = independent("planar go2 on two feet")
    root = impact(case.model, case.q, case.v, case.contacts).root_impulse
    data = case.model.createData()
    pin.forwardKinematics(case.model, data, case.q)
    axis = case.model.jointPlacements[1].rotation[:, 2]
    vanishes(np.cross(axis, root.linear), ZERO)
    vanishes(np.array([axis @ root.angular]), ZERO)


def test_angular_momentum_about_a_single_point_is_conserved():
    model, _ = robot("solo12")
    case = independent("solo12 on two feet")
    contact = ContactSet.of(model, [("FL_FOOT", 3)])
    found = impact(model, case.q, case.v, contact)
    data = model.createData()
    pin.framesForwardKinematics(model, data, case.q)
    foot = data.oMf[contact.frames[0]].translation
    vanishes(found.jump.about(foot).angular, ZERO)
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
    vanishes(found.velocity, ZERO)
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
    vanishes(found.contact_velocity, ZERO)
    assert np.abs(found.impulses[2:]).max() > 1e-3  # those of the hind feet, which already rest
    alone = impact(model, case.q, before, ContactSet.of(model, [("FL_FOOT", 3), ("FR_FOOT", 3)]))
    rows = contact_kinematics(model, model.createData(), case.q, alone.velocity, staying)
    assert np.abs(rows.velocity).max() > 1e-3  # without them they would be torn off


def test_a_second_impact_of_the_same_contacts_does_nothing():
    case = independent("talos on its soles")
    once = impact(case.model, case.q, case.v, case.contacts)
    again = impact(case.model, case.q, once.velocity, case.contacts)
    close(again.velocity, once.velocity, RELATIVE)
    vanishes(again.impulses, ZERO * 1e2)
    vanishes(np.array([again.energy_loss]), ZERO)


def test_redundant_contacts_share_the_impulse():
    corners = {f"corner{i}": (x, y, -0.1) for i, (x, y) in enumerate([(1, 1), (1, -1), (-1, 1), (-1, -1)])}
    model = body(corners, mass=8.0)
    contacts = ContactSet.of(model, [(name, 3) for name in corners])
    falling = np.array([0.0, 0.0, -1.5, 0.0, 0.0, 0.0])
    found = impact(model, pin.neutral(model), falling, contacts)
    assert (found.rank.rows, found.rank.delassus, found.rank.redundant) == (12, 6, True)
    close(found.impulses[:, :3], np.tile([0.0, 0.0, 3.0], (4, 1)), RELATIVE)
    vanishes(found.velocity, ZERO)


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


@pytest.mark.parametrize(
    ("forces", "normals", "friction", "message"),
    [
        (np.ones(3), np.ones(3), 0.5, "wrenches"),
        (np.ones((2, 3)), np.ones((3, 3)), 0.5, "shapes"),
        (np.ones((2, 3)), [0.0, 0.0, 2.0], 0.5, "length one"),
        (np.ones((2, 3)), [0.0, 0.0, np.nan], 0.5, "normals of cone_margins"),
        (np.ones((2, 3)), [0.0, 0.0, 1.0], -0.5, "friction"),
    ],
)
def test_cones_of_wrong_input_are_refused(forces, normals, friction, message):
    with pytest.raises(InputError, match=message):
        cone_margins(forces, normals, friction)


def test_velocities_that_are_not_finite_are_refused():
    case = independent("ur5, point at a wall")
    with pytest.raises(InputError, match="v_minus"):
        impact(case.model, case.q, np.full(6, np.inf), case.contacts)
