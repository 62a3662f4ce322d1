"""Bipeds: pushes, swings, postures at limits, walks and runs on flat soles and from heel to toe."""

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.models import placement
from tests.support.refusals import refusals, refused, refused_calls
from tests.support.solved_problems import motion
from trajopt import Solution
from trajopt.certify.report import AT_POINTS
from trajopt.dynamics.manifold import Coordinates
from trajopt.dynamics.model_quantities import contact_jacobian
from trajopt.motion.energy_use import cost_of_transport
from trajopt.reduced.footsteps import feet_of
from trajopt.robot import EDGES, edge_contacts
from trajopt.robot.kinematics import contact_poses, contact_positions, inverse_kinematics
from trajopt.robot.legs import biped_legs
from trajopt.robot.units import Units
from trajopt.schedule import Phase, Schedule
from trajopt.terms import Context, NodePlace, SwingClearance, SwingOver, swing_arcs
from trajopt.terrain.flat import FlatGround
from trajopt.transcription.mesh import equal_fractions
from trajopt_library import problems, robots
from trajopt_library.problems import biped_balance, bipeds, common, pushing

# Linear algebra in double precision on numbers of order one to a hundred.
ROUNDING = 1e-9
# Inverse kinematics stops at errors of 1e-10, or where descent has stalled: the gradient's rounding there.
STATIONARY = 1e-6
# A solver at 1e-6 in natural units, of about a metre.
SOLVED = 1e-4
# Rest as a solver at 1e-6 leaves it after the contacts' drift of the scheme on few intervals, m/s, rad/s.
AT_REST = 1e-2
# Iterations within which every example is to solve from its own guess.
MOST_ITERATIONS = 60
ON_SOLES = ("talos", "g1")


@pytest.mark.parametrize("name", bipeds.ROBOTS)
def test_legs_carry_the_whole_mass_and_every_joint_moves_a_foot(name):
    whole, legs = robots.load(name), bipeds.biped(name)
    assert legs.mass == pytest.approx(whole.mass)
    assert {contact.name for contact in legs.contacts} == set(biped_legs(whole))
    jacobian = contact_jacobian(legs.model, legs.reference, [(c.frame, range(6)) for c in legs.contacts])
    assert (np.abs(jacobian).max(axis=0) > ROUNDING).all()
    feet = contact_positions(legs, legs.reference)
    for foot, place in feet.items():
        assert_allclose(place, contact_positions(whole, whole.reference)[foot], atol=ROUNDING)
    heights = [place[2] for place in feet.values()]
    assert legs.length == pytest.approx(legs.reference[2] - np.mean(heights))


@pytest.mark.parametrize("family", ["biped-gait", "biped-run", "biped-squat", "biped-step-up", "biped-walk"])
def test_robots_that_are_no_bipeds_are_refused(family):
    with refused("allowed"):
        problems.load(family, robot="solo12")


# Pushes


@pytest.mark.parametrize("name", bipeds.ROBOTS)
def test_push_is_the_impact_of_a_free_robot_on_its_standing_feet(name):
    """Against Pinocchio's impact: an impulse on the free robot, then feet that stop without rebound."""
    robot, impulse = bipeds.biped(name), np.array([2.0, -1.0, 0.5])
    velocity = biped_balance.pushed(robot, impulse)
    model, data, q = robot.model, robot.model.createData(), robot.reference
    feet = contact_jacobian(model, q, [(contact.frame, contact.rows) for contact in robot.contacts])
    assert_allclose(feet @ velocity, 0.0, atol=ROUNDING)
    # Of the free-flyer in its own axes, at its origin: level in the reference, so the world's.
    generalized = np.zeros(model.nv)
    generalized[:3] = pin.Quaternion(q[3:7]).toRotationMatrix().T @ impulse
    free = np.linalg.solve(pin.crba(model, data, q), generalized)
    assert_allclose(velocity, pin.impulseDynamics(model, data, q, free, feet, 0.0, 0.0), atol=ROUNDING)


@pytest.mark.parametrize("name", bipeds.ROBOTS)
def test_what_momentum_a_push_does_not_explain_enters_through_the_feet(name):
    robot, impulse = bipeds.biped(name), np.array([3.0, 1.0, 0.0])
    velocity = biped_balance.pushed(robot, impulse)
    model, data, q = robot.model, robot.model.createData(), robot.reference
    momentum = pin.computeCentroidalMomentum(model, data, q, velocity)
    com = data.com[0].copy()
    feet = contact_jacobian(model, q, [(contact.frame, contact.rows) for contact in robot.contacts])
    torque = pin.crba(model, data, q) @ velocity
    torque[:3] -= pin.Quaternion(q[3:7]).toRotationMatrix().T @ impulse
    found = np.linalg.lstsq(feet.T, torque, rcond=None)[0]
    linear, angular = impulse.copy(), np.cross(q[:3] - com, impulse)
    for place, rows in zip(
        contact_positions(robot, q).values(), np.split(found, len(robot.contacts)), strict=True
    ):
        linear += rows[:3]
        angular += np.cross(place - com, rows[:3]) + (rows[3:] if len(rows) > 3 else 0.0)
    assert_allclose(momentum.linear, linear, atol=ROUNDING * robot.mass)
    assert_allclose(momentum.angular, angular, atol=ROUNDING * robot.mass)


def test_no_push_moves_nothing_and_a_push_backwards_mirrors_one_forwards():
    robot = bipeds.biped("bolt")
    assert not biped_balance.pushed(robot, np.zeros(3)).any()
    forward, backward = (biped_balance.pushed(robot, np.array([x, 0.0, 0.0])) for x in (1.0, -1.0))
    assert_allclose(forward, -backward, atol=ROUNDING)


def test_soles_stand_and_points_step_after_a_push():
    assert [phase.name for phase in problems.load("biped-balance", robot="g1").schedule.phases] == ["stand"]
    stepping = problems.load("biped-balance", robot="bolt")
    assert [len(phase.contacts) for phase in stepping.schedule.phases] == [2, 1, 2, 1, 2]
    start = contact_positions(stepping.robot, stepping.initial_q)
    com = pin.centerOfMass(stepping.robot.model, stepping.robot.model.createData(), stepping.initial_q)
    left, right = biped_legs(stepping.robot)
    moved = [
        stepping.schedule.phases[2].footholds[right] - start[right],
        stepping.schedule.phases[4].footholds[left] - start[left],
    ]
    assert_allclose(moved[0], moved[1], atol=ROUNDING)
    assert moved[0][0] > 0  # with the push, which is forward
    assert moved[0][0] < com[2]


# A step up


@pytest.mark.parametrize("name", bipeds.ROBOTS)
def test_step_up_moves_one_foot_after_the_other_onto_the_box(name):
    problem = problems.load("biped-step-up", robot=name)
    left, right = biped_legs(problem.robot)
    assert [phase.contacts for phase in problem.schedule.phases] == [
        (left, right), (left,), (left, right), (right,), (left, right),
    ]  # fmt: skip
    end = contact_positions(problem.robot, problem.guess(problem.schedule.duration))
    for place in end.values():
        assert problem.terrain.height(place[0], place[1]) == pytest.approx(problem.parameters["height"])


test_walks_without_soles_and_steps_shorter_than_one_are_refused = refused_calls(
    (lambda: problems.load("biped-walk", robot="bolt"), "soles"),
    (lambda: problems.load("biped-step-up", robot="talos", forward=0.1), "more than a sole"),
)


@pytest.mark.parametrize("name", bipeds.ROBOTS)
def test_guess_of_a_step_up_has_the_whole_foot_before_the_edge_until_it_is_up(name):
    problem = problems.load("biped-step-up", robot=name)
    robot, (term,) = problem.robot, (term for term in problem.terms if isinstance(term, SwingOver))
    assert len(term.swings) == 2
    for swing in term.swings:
        contact, edge = robot.contact(swing.contact), swing.ground.rise
        for s in np.linspace(0.0, swing.risen, 20):
            q = problem.guess(swing.begin + s * (swing.end - swing.begin))
            pose = contact_poses(robot, q)[contact.name]
            points = pose.translation + contact.corners @ pose.rotation[:, :2].T
            assert edge.distance(points).min() > -ROUNDING
        # From there the guess passes the edge at once: the row is not put off.
        later = problem.guess(swing.begin + (swing.risen + 0.05) * (swing.end - swing.begin))
        pose = contact_poses(robot, later)[contact.name]
        assert edge.distance(pose.translation + contact.corners @ pose.rotation[:, :2].T).min() < 0


# Soles in the air


@pytest.mark.parametrize("name", ON_SOLES)
def test_all_corners_of_a_swinging_sole_stay_above_the_ground(name):
    """The rows of both swing terms are the heights of the corners, here of a sole that is turned."""
    robot = bipeds.biped(name)
    left, right = biped_legs(robot)
    phase = Phase(name="swing", duration=0.5, contacts=(left,))
    place = NodePlace(phase=phase, index=1, fractions=equal_fractions(4), last=False)
    ground, contact = FlatGround(), robot.contact(right)
    arc = swing_arcs(Schedule((phase,)), (right,), height=0.04, terrain=ground)[0]
    pose = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.4, 0.2), np.array([0.1, 0.0, 0.2]))
    points = pose.translation + contact.corners @ pose.rotation[:, :2].T
    assert np.ptp(points[:, 2]) > contact.half_length * np.sin(0.4)
    for term in (SwingClearance(height=0.04, terrain=ground), arc):
        context = Context(robot, Coordinates(robot.model), node=True)
        rows = term.rows(context, Units(robot), place)
        assert_allclose(rows.lower, 0.04 * 16 * 0.25**2 * 0.75**2)
        frame = context.frame(contact.frame)
        inputs = [frame.position, frame.rotation, context.parameters]
        heights = ca.Function("rows", inputs, [rows.expression])(
            pose.translation, pose.rotation, context.parameter_values
        )
        assert_allclose(np.array(heights).ravel(), points[:, 2], atol=ROUNDING)


# Postures at joint limits


def test_inverse_kinematics_ends_at_a_bounded_optimum_where_ankles_end():
    """At a base too low for flat feet no direction that the limits allow makes the error smaller."""
    robot = bipeds.biped("g1")
    low = common.displaced(robot, (0.0, 0.0, -0.25 * robot.length))
    feet = {robot.contact(name).frame: pose for name, pose in contact_poses(robot, robot.reference).items()}
    found = inverse_kinematics(robot, low, feet)
    assert found.error > pushing.REACHED

    def squared(q: np.ndarray) -> float:
        errors = [pin.log6(placement(robot.model, q, f).actInv(to)).vector for f, to in feet.items()]
        return float(np.sum(np.square(errors)))

    at_limit = 0
    for joint in robot.model.joints:
        if joint.nv != 1:
            continue
        step = np.zeros(robot.nv)
        step[joint.idx_v] = 1e-5
        up, down = (squared(pin.integrate(robot.model, found.q, sign * step)) for sign in (1, -1))
        slope, value = (up - down) / 2e-5, found.q[joint.idx_q]
        if value <= robot.position_lower[joint.idx_q]:
            at_limit += 1
            assert slope > -STATIONARY
        elif value >= robot.position_upper[joint.idx_q]:
            at_limit += 1
            assert slope < STATIONARY
        else:
            assert abs(slope) < STATIONARY
    assert at_limit > 0


@pytest.mark.parametrize("name", bipeds.ROBOTS)
def test_leaps_sink_to_where_feet_still_stand_flat(name):
    robot = bipeds.biped(name)
    assert pushing.raised(robot, -pushing.sink_of(robot)).error < pushing.REACHED
    assert 0 < pushing.sink_of(robot) <= pushing.SINK_PART * robot.length


# Solved


@pytest.mark.slow
@pytest.mark.parametrize(
    ("family", "name", "intervals"), [("biped-squat", "g1", 12), ("biped-balance", "bolt", 30)]
)
def test_motion_solves_from_its_own_guess_and_ends_at_rest(family, name, intervals):
    problem = problems.load(family, robot=name)
    solution = trajopt.solve(problem, intervals=intervals)
    assert solution.converged, solution.statistics.advice
    assert solution.statistics.iterations <= MOST_ITERATIONS
    assert np.abs(solution.v[-1]).max() < AT_REST
    if family == "biped-squat":
        lowest = problem.robot.reference[2] - solution.q[:, 2].min()
        assert lowest > problem.parameters["depth"] - SOLVED


ON_FOOTHOLD = 1e-3


def test_phases_alternate_single_and_double_support_and_land_where_planned() -> None:
    problem = problems.load("biped-walk", steps=3, length=0.2)
    phases = problem.schedule.phases
    assert [phase.name for phase in phases] == [
        "shift", "step_1", "double_1", "step_2", "double_2", "step_3", "settle",
    ]  # fmt: skip
    assert [len(phase.contacts) for phase in phases] == [2, 1, 2, 1, 2, 1, 2]
    start = feet_of(problem.robot, problem.initial_q)
    end = feet_of(problem.robot, problem.guess(problem.schedule.duration))
    for name, foot in end.items():
        assert_allclose(foot.position - start[name].position, [0.4, 0.0, 0.0], atol=ON_FOOTHOLD)


def test_unphysical_parameters_are_refused() -> None:
    for values in (
        {"steps": 1},
        {"steps": 2.5},
        {"length": 2.0},
        {"double_support": 0.0},
        {"torque_share": 0.0},
    ):
        with refused("allowed"):
            problems.load("biped-walk", **values)


@pytest.mark.slow
@pytest.mark.parametrize("values", [{}, {"steps": 3, "length": -0.15, "turn": 0.15}])
def test_walk_solves_from_its_own_guess_passes_the_check_and_ends_at_rest(values: dict[str, float]) -> None:
    problem = problems.load("biped-walk", **values)
    solution = trajopt.solve(problem, fixed_mesh=True)
    assert solution.converged, solution.statistics.advice
    assert solution.statistics.iterations <= MOST_ITERATIONS
    assert not trajopt.check(solution).failures(AT_POINTS)
    assert np.abs(solution.v[-1]).max() < AT_REST
    planned = feet_of(problem.robot, problem.guess(problem.schedule.duration))
    for name, foot in feet_of(problem.robot, solution.q[-1]).items():
        assert_allclose(foot.position, planned[name].position, atol=ON_FOOTHOLD)


ROLLING = {"feet": "heel-toe"}
# Corners have friction pyramids along the world's axes, soles along their own; small costs differ, too.
SAME_MODEL = 2e-2
# Pitch of a foot that clearly stands on an edge, rad.
TILTED = 0.05
# What a check allows of a sole, rad.
FLAT = 1e-2
# Moments of forces in file's digits, over the weight times a metre.
HEEL_TOE_ROUNDING = 1e-12


def pitches(solution: Solution, frame: str) -> np.ndarray:
    """Pitch (K,) of a sole at all samples, toe down, rad."""
    model, data = solution.model, solution.model.createData()
    angles = []
    for q in solution.q:
        pin.framesForwardKinematics(model, data, q)
        angles.append(-np.arcsin(data.oMf[model.getFrameId(frame)].rotation[2, 0]))
    return np.array(angles)


def stands(solution: Solution, sole: str, edge: str) -> np.ndarray:
    """Samples (K,) at which an edge of a sole is active."""
    frames = list(solution.contact_frames)
    return np.array(solution.active[:, [frames.index(name) for name in edge_contacts(sole, edge)]].all(1))


def certified(name: str, **values: object) -> Solution:
    solution = motion(name, **values)
    assert solution.converged, solution.statistics.advice
    assert solution.statistics.rounds[0].iterations <= MOST_ITERATIONS
    assert not trajopt.check(solution).failures()
    return solution


@pytest.mark.slow
@pytest.mark.parametrize("robot", ON_SOLES)
def test_a_walk_strikes_with_the_heel_pushes_off_with_the_toe_and_costs_less(robot, tmp_path):
    rolling = certified("biped-gait", robot=robot, **ROLLING)
    # In this half of the cycle the left foot lands, and the right one leaves the ground.
    pitch = {foot: pitches(rolling, bipeds.biped(robot).contact(foot).frame) for foot in ("left", "right")}
    heel, toe = (stands(rolling, "left", edge) for edge in EDGES)
    assert pitch["left"][np.flatnonzero(heel & ~toe)[0]] < -TILTED
    assert np.abs(pitch["left"][heel & toe]).max() < FLAT
    assert pitch["right"][np.flatnonzero(stands(rolling, "right", "toe"))[-1]] > TILTED
    flat = certified("biped-gait", robot=robot)
    assert cost_of_transport(rolling) < 0.9 * cost_of_transport(flat)
    rolling.save(tmp_path / "rolling.npz")
    again = Solution.load(tmp_path / "rolling.npz")
    assert not trajopt.check(again).failures()


@pytest.mark.slow
@pytest.mark.parametrize("robot", ON_SOLES)
def test_a_walk_that_turns_rolls_over_feet_with_any_heading(robot):
    solution = certified("biped-walk", robot=robot, steps=3, turn=0.2, **ROLLING)
    model, data = solution.model, solution.model.createData()
    frames, moments = list(solution.contact_frames), []
    for k, q in enumerate(solution.q):
        pin.framesForwardKinematics(model, data, q)
        for foot in ("left", "right"):
            for edge in EDGES:
                ends = edge_contacts(foot, edge)
                places = np.array([data.oMf[model.getFrameId(name)].translation for name in ends])
                forces = solution.f[k, [frames.index(name) for name in ends], :3]
                along = places[0] - places[1]
                moment = np.cross(places - places.mean(axis=0), forces).sum(axis=0)
                moments.append(moment @ along / np.linalg.norm(along))
    weight = pin.computeTotalMass(model) * 9.81
    assert np.abs(moments).max() < HEEL_TOE_ROUNDING * weight


@pytest.mark.slow
@pytest.mark.parametrize("robot", ON_SOLES)
def test_a_run_rolls_over_heel_and_toe(robot):
    certified("biped-run", robot=robot, **ROLLING)


@pytest.mark.slow
def test_corners_without_time_on_heel_or_toe_walk_like_soles():
    corners = certified("biped-gait", heel=0.0, toe=0.0, **ROLLING)
    soles = certified("biped-gait")
    assert cost_of_transport(corners) == pytest.approx(cost_of_transport(soles), rel=SAME_MODEL)


@pytest.mark.parametrize("family", ["biped-gait", "biped-run", "biped-walk"])
def test_flat_feet_are_the_default_and_have_no_corners(family):
    problem = problems.load(family)
    assert problem.robot is bipeds.biped("talos")
    assert {contact.kind for contact in problem.robot.contacts} == {"surface"}
    assert not any("heel" in frame.name for frame in problem.robot.model.frames)
    assert problems.load(family, **ROLLING).robot.model.nframes == problem.robot.model.nframes + 8


test_wrong_use_gives_one_clear_line = refusals(
    lambda family, values: problems.load(family, **values),
    ("biped-gait", {"robot": "bolt", **ROLLING}, "robot 'bolt' stands on points"),
    ("biped-gait", {"heel": 0.2}, "parameter heel is given, but feet is flat"),
    ("biped-walk", {"toe": 0.2}, "parameter toe is given, but feet is flat"),
    ("biped-run", {"heel": 0.5, "toe": 0.5, **ROLLING}, "flat in between"),
    ("biped-walk", {"heel": 0.5, "toe": 0.6, **ROLLING}, "flat in between"),
    ("biped-gait", {"toe": 0.999, **ROLLING}, "allowed: 0 to 0.9"),
    ("biped-gait", {"feet": "toes"}, "allowed: flat, heel-toe"),
    ("biped-gait", {"toe": 0.1667, **ROLLING}, "off phase 'double_1'|off phase 'single_1'"),
)
