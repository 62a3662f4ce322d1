"""Robots in a plane, the hopper as its figures show it; heels and toes of soles."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.models import placement
from trajopt import Contact, FlatGround, InputError, Phase, Problem, Robot, Schedule, middle_of, terms
from trajopt.certify.report import AT_POINTS
from trajopt.dynamics import contact_jacobian
from trajopt.dynamics.base_joint import Base
from trajopt.dynamics.model_quantities import generalized_force
from trajopt.robot import EDGES, contact_poses, contact_positions, edge_contacts, robot_file, with_edges
from trajopt.transcription.redundancy import independent_rows
from trajopt_library import robots
from trajopt_library.problems import bipeds
from trajopt_library.robots import hopper

DISTANCE, STANCE, FLIGHT, LANDING = 0.1, 0.3, 0.25, 0.4  # m, s, s, s
GRAVITY = 9.81
# Ten times the solver's tolerance, in parts of the weight.
SOLVED = 1e-5


def go2(base: Base) -> Robot:
    legs = ("FL", "FR", "RL", "RR")
    angles = {"thigh": 0.8, "calf": -1.6}
    return Robot.from_urdf(
        robot_file("go2_description/urdf/go2.urdf"),
        base=base,
        contacts=[Contact(frame=f"{leg}_foot", name=leg) for leg in legs],
        reference={f"{leg}_{joint}_joint": angle for leg in legs for joint, angle in angles.items()},
        locked=[f"{leg}_hip_joint" for leg in legs],
    )


def solo(base: Base) -> Robot:
    bends = {"FL": 1, "FR": 1, "HL": -1, "HR": -1}
    return Robot.from_urdf(
        robot_file("solo_description/robots/solo.urdf"),
        base=base,
        contacts=[Contact(frame=f"{leg}_FOOT", name=leg) for leg in bends],
        reference={
            f"{leg}_{joint}": bend * angle
            for leg, bend in bends.items()
            for joint, angle in (("HFE", 0.8), ("KFE", -1.6))
        },
    )


def hop(robot: Robot) -> Problem:
    """Forward by ``DISTANCE`` and up by a tenth of the robot's length, from rest to rest."""
    end = robot.reference.copy()
    end[0] += DISTANCE
    feet = {c.name: placement(robot.model, end, c.frame).translation.copy() for c in robot.contacts}
    legs, ground = tuple(feet), FlatGround(friction=0.7)
    height = 1 if robot.base == "planar" else 2

    def guess(t: float) -> np.ndarray:
        q, s = robot.reference.copy(), np.clip(t - STANCE, 0.0, FLIGHT)
        q[0] += DISTANCE * s / FLIGHT
        q[height] += GRAVITY * s * (FLIGHT - s) / 2
        return q

    return Problem(
        name="planar-hop",
        robot=robot,
        schedule=Schedule(
            (
                Phase(name="stance", duration=STANCE, contacts=legs),
                Phase(name="flight", duration=FLIGHT),
                Phase(name="landing", duration=LANDING, contacts=legs, footholds=feet),
            )
        ),
        terrain=ground,
        terms=(
            terms.TorqueCost(weight=1.0),
            terms.AccelerationCost(weight=2e-2, joints_only=True),
            terms.VelocityCost(weight=1e-2, joints_only=True),
            terms.PostureCost(weight=1e-1),
            terms.TorqueLimits(),
            terms.PositionLimits(),
            terms.VelocityLimits(),
            terms.FrictionCone(friction=ground.friction),
            terms.SwingClearance(height=0.03, terrain=ground),
            terms.FrameHeight(frame="root_joint", height=1.1 * robot.length, at=middle_of("flight")),
            terms.TerminalState(q=end),
            terms.TerminalRest(q=end),
        ),
        guess=guess,
        default_intervals=24,
    )


@pytest.mark.long
@pytest.mark.parametrize("make", [go2, solo])
def test_a_planar_quadruped_hops_and_passes_its_check(make):
    solution = trajopt.solve(hop(make("planar")), fixed_mesh=True)
    assert solution.converged, solution.statistics.advice
    assert solution.statistics.iterations <= 60
    report = trajopt.check(solution)
    assert report.within(AT_POINTS), str(report)
    assert report.gimbal_margin is None


def in_space(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A motion of the planar base as one of a free-flyer: pitch, nose up, is about the world's -y."""
    half = np.arctan2(q[3], q[2]) / 2
    pose = [q[0], 0.0, q[1], 0.0, -np.sin(half), 0.0, np.cos(half)]
    twist, change = ([x[0], 0.0, x[1], 0.0, -x[2], 0.0] for x in (v, a))
    return tuple(
        np.concatenate([base, x[n:]]) for base, x, n in ((pose, q, 4), (twist, v, 3), (change, a, 3))
    )


def test_a_plan_in_the_plane_obeys_the_free_flyers_dynamics():
    solution, floating = (trajopt.solve(hop(solo("planar")), fixed_mesh=True), solo("freeflyer"))
    model, data = floating.model, floating.model.createData()
    frames = [model.getFrameId(contact.frame) for contact in floating.contacts]
    in_plane = [0, 2, 4, *range(6, model.nv)]
    for k in np.flatnonzero(solution.collocation):
        motion = in_space(solution.q[k], solution.v[k], solution.a[k])
        force = generalized_force(model, data, motion, frames, solution.f[k])
        expected = np.concatenate([np.zeros(3), solution.tau[k]])
        np.testing.assert_allclose(force[in_plane], expected, atol=SOLVED * floating.weight)


ROUNDING = 1e-12


def points(q: np.ndarray) -> dict[str, np.ndarray]:
    """Hip, knee, foot and torso centre (3,) m by hand: angles from the vertical, nose up positive."""
    x, z, cosine, sine, hip, knee = q
    pitch = np.arctan2(sine, cosine)
    thigh = pitch - hip  # Pinocchio's y axis turns nose down
    shank = thigh - knee
    at = np.array([x, 0.0, z])

    def down(angle: float) -> np.ndarray:
        return np.array([np.sin(angle), 0.0, -np.cos(angle)])

    knee_point = at + hopper.THIGH_LENGTH * down(thigh)
    return {
        "hip": at,
        "knee": knee_point,
        "foot": knee_point + hopper.SHANK_LENGTH * down(shank),
        "torso": at - hopper.TORSO_CENTRE * hopper.TORSO_LENGTH * down(pitch),
        "thigh": at + hopper.THIGH_LENGTH / 2 * down(thigh),
        "shank": knee_point + hopper.SHANK_LENGTH / 2 * down(shank),
    }


POSTURE = np.array([0.3, 0.8, np.cos(0.4), np.sin(0.4), -0.7, 1.3])


def test_sizes_base_and_weight():
    robot = robots.load("hopper")
    assert (robot.base, robot.nq, robot.nv, robot.nu, robot.n_unactuated) == ("planar", 6, 5, 2, 3)
    assert robot.mass == pytest.approx(10.0)
    assert [contact.name for contact in robot.contacts] == ["foot"]


def test_frames_lie_where_the_links_angles_put_them():
    model = robots.load("hopper").model
    data = model.createData()
    pin.framesForwardKinematics(model, data, POSTURE)
    for name in ("hip", "knee", "foot"):
        found = data.oMf[model.getFrameId(name)].translation
        np.testing.assert_allclose(found, points(POSTURE)[name], atol=ROUNDING)


def test_the_centre_of_mass_is_that_of_three_boxes():
    model = robots.load("hopper").model
    masses = {"torso": hopper.TORSO_MASS, "thigh": hopper.THIGH_MASS, "shank": hopper.SHANK_MASS}
    at = points(POSTURE)
    expected = sum(mass * at[name] for name, mass in masses.items()) / sum(masses.values())
    found = pin.centerOfMass(model, model.createData(), POSTURE)
    np.testing.assert_allclose(found, expected, atol=ROUNDING)


def test_the_pitch_inertia_of_a_turning_body_is_that_of_its_boxes():
    """All links turn with the torso: the kinetic energy is that of one rigid body about the hip."""
    robot, rate = robots.load("hopper"), 2.0
    v = np.array([0.0, 0.0, rate, 0.0, 0.0])
    at, expected = points(POSTURE), 0.0
    for name, mass, length in (
        ("torso", hopper.TORSO_MASS, hopper.TORSO_LENGTH),
        ("thigh", hopper.THIGH_MASS, hopper.THIGH_LENGTH),
        ("shank", hopper.SHANK_MASS, hopper.SHANK_LENGTH),
    ):
        side = hopper.SLENDERNESS * length
        own = mass * (length**2 + side**2) / 12
        expected += (own + mass * np.sum((at[name] - at["hip"]) ** 2)) * rate**2 / 2
    found = pin.computeKineticEnergy(robot.model, robot.model.createData(), POSTURE, v)
    assert found == pytest.approx(expected, rel=1e-12)


def test_the_reference_stands_with_its_weight_over_the_foot():
    robot = robots.load("hopper")
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.reference)
    foot = data.oMf[robot.model.getFrameId("foot")].translation
    assert foot[2] == pytest.approx(0.0, abs=ROUNDING)
    centre = pin.centerOfMass(robot.model, data, robot.reference)
    assert centre[0] == pytest.approx(foot[0], abs=ROUNDING)


def test_joints_can_hold_the_weight_on_a_bent_leg():
    robot = robots.load("hopper")
    lever = hopper.THIGH_LENGTH
    assert (robot.torque_limit > 2 * robot.weight * lever).all()
    np.testing.assert_array_equal(robot.velocity_limit[3:], hopper.SPEED)


ON_SOLES = ("talos", "g1")
# Linear algebra in double precision on numbers of order one to a hundred.
EDGES_ROUNDING = 1e-9
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
        assert_allclose(local, expected, atol=EDGES_ROUNDING)
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
        assert np.linalg.matrix_rank(every, tol=EDGES_ROUNDING) == 5
        # The motions that these rows allow leave the foot one turn, about the edge.
        free = np.linalg.svd(jacobian)[2][5:]
        sole = bipeds.biped(name).contact("left")
        turns = contact_jacobian(robot.model, q, [(sole.frame, (3, 4, 5))]) @ free.T
        places = contact_positions(robot, q)
        along = places[corners[0].name] - places[corners[1].name]
        assert_allclose(np.cross(turns.T, along), 0.0, atol=EDGES_ROUNDING)
        assert np.linalg.matrix_rank(turns, tol=EDGES_ROUNDING) == 1


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
        assert_allclose(along @ wrenches[3:], 0.0, atol=EDGES_ROUNDING)
        assert np.linalg.matrix_rank(wrenches, tol=EDGES_ROUNDING) == 5


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
        assert_allclose(places[name], place, atol=EDGES_ROUNDING)


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
