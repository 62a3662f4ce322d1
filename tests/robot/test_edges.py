"""Heel and toe of a sole: where the corners are, rows of five, wrenches without moment about the edge."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from trajopt.dynamics.model_quantities import contact_jacobian
from trajopt.errors import InputError
from trajopt.robot import EDGES, Contact, Robot, contact_poses, contact_positions, edge_contacts, with_edges
from trajopt.transcription.redundancy import independent_rows
from trajopt_library import robots
from trajopt_library.problems import bipeds

ON_SOLES = ("talos", "g1")
# Linear algebra in double precision on numbers of order one to a hundred.
ROUNDING = 1e-9
# Central differences of positions of order one with steps of STEP: of second order, and rounding over it.
STEP, DIFFERENCES = 1e-5, 1e-8
# Singular values of rows of unit order whose points are centimetres apart, above those of dependent ones.
RANKED = 1e-3
# Turns of the whole robot about the vertical, rad: edges along and across the world's axes, and between.
YAWS = (0.0, 0.4, np.pi / 4, np.pi / 2, -2.5)


def turned(robot: Robot, yaw: float) -> np.ndarray:
    """The reference posture (nq,) turned about the vertical, knees bent a little more on one side."""
    q = robot.reference.copy()
    turn = pin.Quaternion(np.array(pin.utils.rotate("z", yaw))) * pin.Quaternion(q[3:7])
    q[3:7] = turn.coeffs()
    q[10] += 0.1
    return q


@pytest.mark.parametrize("name", ON_SOLES)
def test_corners_are_those_of_the_sole_and_toes_are_in_front(name):
    flat = bipeds.biped(name)
    robot = with_edges(flat)
    q = turned(flat, 0.4)
    poses, places = contact_poses(flat, q), contact_positions(robot, q)
    ahead = np.array(pin.utils.rotate("z", 0.4))[:, 0]
    for sole in flat.contacts:
        corners = np.array([places[corner] for edge in EDGES for corner in edge_contacts(sole.name, edge)])
        local = np.array([poses[sole.name].actInv(corner) for corner in corners])
        expected = np.hstack([sole.corners[[1, 2, 0, 3]], np.zeros((4, 1))])
        assert_allclose(local, expected, atol=ROUNDING)
        assert (corners[2:].mean(axis=0) - corners[:2].mean(axis=0)) @ ahead > sole.half_length
    assert {contact.kind for contact in robot.contacts} == {"point"}
    assert robot.length == pytest.approx(flat.length)
    assert robot.mass == pytest.approx(flat.mass)
    assert_allclose(robot.reference, flat.reference)


@pytest.mark.parametrize("yaw", YAWS)
@pytest.mark.parametrize("name", ON_SOLES)
def test_an_edge_keeps_five_independent_rows_and_turns_about_itself_alone(name, yaw):
    """Rows against finite differences of the corners, which numeric Pinocchio places."""
    robot = with_edges(bipeds.biped(name))
    q = turned(robot, yaw)
    for edge in EDGES:
        corners = [robot.contact(corner) for corner in edge_contacts("left", edge)]
        kept = independent_rows(robot, q, (), corners)
        jacobian = contact_jacobian(robot.model, q, [(c.frame, kept[c.name]) for c in corners])
        moved = np.zeros_like(jacobian)
        for column in range(robot.nv):
            step = np.zeros(robot.nv)
            step[column] = STEP
            ends = [contact_positions(robot, pin.integrate(robot.model, q, way * step)) for way in (1, -1)]
            apart = [(ends[0][c.name] - ends[1][c.name])[list(kept[c.name])] for c in corners]
            moved[:, column] = np.concatenate(apart) / (2 * STEP)
        assert_allclose(jacobian, moved, atol=DIFFERENCES)
        assert len(jacobian) == 5
        assert np.linalg.svd(jacobian, compute_uv=False)[-1] > RANKED
        every = contact_jacobian(robot.model, q, [(c.frame, (0, 1, 2)) for c in corners])
        assert np.linalg.matrix_rank(every, tol=ROUNDING) == 5
        # The motions that these rows allow leave the foot one turn, about the edge.
        free = np.linalg.svd(jacobian)[2][5:]
        sole = bipeds.biped(name).contact("left")
        turns = contact_jacobian(robot.model, q, [(sole.frame, (3, 4, 5))]) @ free.T
        places = contact_positions(robot, q)
        along = places[corners[0].name] - places[corners[1].name]
        assert_allclose(np.cross(turns.T, along), 0.0, atol=ROUNDING)
        assert np.linalg.matrix_rank(turns, tol=ROUNDING) == 1


@pytest.mark.parametrize("yaw", YAWS)
def test_wrenches_of_an_edge_are_all_those_without_moment_about_it(yaw):
    robot = with_edges(bipeds.biped("g1"))
    q = turned(robot, yaw)
    places = contact_positions(robot, q)
    for edge in EDGES:
        ends = np.array([places[corner] for corner in edge_contacts("right", edge)])
        along = (ends[0] - ends[1]) / np.linalg.norm(ends[0] - ends[1])
        levers = ends - ends.mean(axis=0)
        wrenches = np.vstack([np.tile(np.eye(3), 2), np.hstack([pin.skew(lever) for lever in levers])])
        assert_allclose(along @ wrenches[3:], 0.0, atol=ROUNDING)
        assert np.linalg.matrix_rank(wrenches, tol=ROUNDING) == 5


@pytest.mark.parametrize("yaw", YAWS)
def test_toes_that_come_down_beside_a_heel_add_one_row(yaw):
    robot = with_edges(bipeds.biped("talos"))
    heel, toe = ([robot.contact(name) for name in edge_contacts("left", edge)] for edge in EDGES)
    kept = independent_rows(robot, turned(robot, yaw), heel, toe)
    assert [sum(len(kept[c.name]) for c in edge) for edge in (heel, toe)] == [5, 1]
    assert [row for c in toe for row in kept[c.name]] == [2]


def test_toes_are_in_front_where_the_axes_of_the_sole_point_back():
    flat = bipeds.biped("g1")
    model = pin.Model(flat.model)
    for sole in flat.contacts:
        frame = model.frames[model.getFrameId(sole.frame)]
        frame.placement = frame.placement * pin.SE3(np.array(pin.utils.rotate("z", np.pi)), np.zeros(3))
    places, usual = (
        contact_positions(with_edges(r), r.reference) for r in (replace(flat, model=model), flat)
    )
    assert places.keys() == usual.keys()
    for name, place in usual.items():
        assert_allclose(places[name], place, atol=ROUNDING)


def test_robots_without_soles_and_soles_across_are_refused():
    with pytest.raises(InputError, match="has no sole; allowed"):
        with_edges(robots.load("solo12"))
    robot = bipeds.biped("g1")
    model = pin.Model(robot.model)
    frame = model.frames[model.getFrameId("left_sole")]
    frame.placement = frame.placement * pin.SE3(np.array(pin.utils.rotate("z", np.pi / 2)), np.zeros(3))
    with pytest.raises(InputError, match="sole 'left' of robot 'g1' lies across"):
        with_edges(replace(robot, model=model))


def test_contacts_that_are_points_stay_as_they_are():
    talos = robots.load("talos")
    robot = with_edges(talos)
    assert robot.contact("hand") is talos.contact("hand")
    assert len(robot.contacts) == 9
    assert isinstance(robot.contact("left_toe_left"), Contact)
