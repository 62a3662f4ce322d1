"""Friction and sliding contacts, clearance of obstacles, and tracking of references in solutions."""

import math
from dataclasses import replace
from functools import lru_cache

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.goals import integral, objective, sampled, wandering, with_terms
from tests.support.problems import FOOT, REACH, REACH_TIME, hop, hopper, one_joint_arm, reach
from tests.support.refusals import refused
from tests.support.replay_pages import objects_of, placements_of, shown
from tests.support.swings import BALL, FAR, MARGIN, POLE, ROD_CAPSULES, avoided, past, swing
from tests.support.synthetic_motions import with_meta
from trajopt import Contact, InputError, Phase, Problem, Robot, Schedule, Solution, check
from trajopt.certify import ContactSet
from trajopt.certify.contact.contact_dynamics import ContactDynamics
from trajopt.certify.report import AT_POINTS
from trajopt.certify.sliding import SlidingDynamics
from trajopt.collision import CollisionScene
from trajopt.collision.shapes import LinkShape
from trajopt.dynamics import Coordinates
from trajopt.motion.configurations import geodesic_motion
from trajopt.robot import Units
from trajopt.solving.extraction import described_bodies
from trajopt.solving.graded import solve as solve_graded
from trajopt.solving.solving import prepare, solve
from trajopt.terms import AccelerationCost, Clearance, Context, FrictionCone, TorqueCost, TrackingCost
from trajopt.terms.dynamics import require_sliding
from trajopt.terms.friction import APEX, TIGHT
from trajopt.terms.tracking import key_frames
from trajopt.terrain import Surface, smooth_step
from trajopt.view.plotting.motion import PlottedMotion
from trajopt_library import robots

MASS, FRICTION, SPEED, GRAVITY = 2.0, 0.3, 1.5, 9.81
# Far below the block's speed: friction is mu m g then, but for half the square of the ratio.
SLIP = 1e-3
DURATION = 0.3  # s, before it stops at v / (mu g) = 0.51
ROUNDING = 1e-10


def block() -> Robot:
    """A point mass on three slides along the world's axes, none of them driven."""
    model, parent = pin.Model(), 0
    for axis, joint in zip("xyz", (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ), strict=True):
        parent = model.addJoint(parent, joint(), pin.SE3.Identity(), axis)
        model.addJointFrame(parent)
    model.appendBodyToJoint(parent, pin.Inertia.FromSphere(MASS, 0.1), pin.SE3.Identity())
    model.addFrame(pin.Frame("block", parent, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return Robot.from_model(model, name="block", contacts=["block"], passive=("x", "y", "z"))


def slope(angle: float, **options: float) -> Surface:
    normal = np.array([-np.sin(angle), 0.0, np.cos(angle)])
    return Surface(point=np.zeros(3), normal=normal, friction=FRICTION, slip_speed=SLIP, **options)


def sliding_block(surface: Surface, velocity: np.ndarray) -> Problem:
    return Problem(
        name="block",
        robot=block(),
        schedule=Schedule(
            (Phase(name="slide", duration=DURATION, contacts=("block",), surfaces={"block": surface}),)
        ),
        initial_q=np.zeros(3),
        initial_v=velocity,
        terms=(AccelerationCost(weight=1.0),),
        guess=lambda t: t * velocity,
        default_intervals=10,
    )


@pytest.mark.parametrize("angle", [0.0, 0.2])
def test_a_block_is_braked_by_friction_on_a_plane(angle):
    surface = slope(angle)
    up = np.array([np.cos(angle), 0.0, np.sin(angle)])
    solution = trajopt.solve(sliding_block(surface, SPEED * up), fixed_mesh=True)
    assert solution.converged
    assert trajopt.check(solution).within(AT_POINTS)
    braking = GRAVITY * (np.sin(angle) + FRICTION * np.cos(angle))
    expected = SPEED * DURATION - braking * DURATION**2 / 2
    # Friction below mu f_n by half (v_s / v)^2, and the collocation of its change.
    assert_allclose(solution.q[-1], expected * up, atol=1e-5)
    assert solution.f[solution.collocation][0, 0, :3] @ surface.normal == pytest.approx(
        MASS * GRAVITY * np.cos(angle), rel=1e-6
    )


def test_dynamics_of_a_contact_without_friction_are_those_of_a_multiplier_along_the_normal():
    robot = block()
    contacts = ContactSet.of(robot.model, [("block", 3)])
    surface = replace(slope(0.4), friction=0.0)
    q, v, force = np.zeros(3), np.array([0.3, -0.2, 0.1]), np.array([1.0, 2.0, 3.0])
    found = SlidingDynamics(robot.model, contacts, {0: surface}).acceleration(q, v, force)
    free = force / MASS - np.array([0.0, 0.0, GRAVITY])
    expected = free - (surface.normal @ free) * surface.normal
    assert_allclose(found, expected, atol=ROUNDING)


def test_dynamics_without_sliding_contacts_are_those_of_held_ones():
    robot = block()
    contacts = ContactSet.of(robot.model, [("block", 3)])
    state = np.zeros(3), np.array([0.3, -0.2, 0.1]), np.array([1.0, 2.0, 3.0])
    found = SlidingDynamics(robot.model, contacts, {}).acceleration(*state)
    assert_allclose(found, ContactDynamics(robot.model, contacts).acceleration(*state), atol=ROUNDING)


def test_compiled_dynamics_slide_and_hold_as_those_of_python():
    robot, generator = robots.load("go2"), np.random.default_rng(5)
    model = robot.model
    surfaces = {0: slope(0.3), 2: slope(-0.2)}
    dynamics = SlidingDynamics(model, ContactSet.of(model, robot.contacts), surfaces)
    q = np.array([pin.integrate(model, robot.reference, 0.2 * generator.normal(size=18)) for _ in range(20)])
    v, force = generator.normal(size=(2, 20, 18))
    expected = np.array([dynamics.acceleration(*row) for row in zip(q, v, force, strict=True)])
    found = dynamics.compiled.accelerations(q, v, force)
    assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    with pytest.raises(ValueError, match="no point of that number holds its place"):
        dynamics.compiled.slide(0, surfaces[0].normal, 0.5, 0.1)


def test_a_sliding_surface_survives_its_description():
    surface = slope(0.3)
    described = Surface.from_description(surface.describe())
    assert described.slip_speed == surface.slip_speed
    held = replace(surface, slip_speed=None).describe()
    assert "slip_speed" not in held  # files of surfaces that hold are as they were
    assert Surface.from_description(held).slip_speed is None


@pytest.mark.parametrize("slip", [0.0, -1.0, np.nan, "fast", True])
def test_a_slip_speed_that_is_none_is_refused(slip):
    with pytest.raises(InputError, match="slip_speed"):
        Surface(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]), slip_speed=slip)


def test_what_cannot_slide_is_refused():
    surface = slope(0.0)
    with pytest.raises(InputError, match="bilateral"):
        Surface(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]), slip_speed=SLIP, bilateral=True)
    problem = sliding_block(surface, np.zeros(3))
    sole = Contact(frame="block", kind="surface", half_length=0.1, half_width=0.1)
    with pytest.raises(InputError, match="point contacts"):
        replace(problem, robot=replace(problem.robot, contacts=(sole,)))
    with pytest.raises(InputError, match="actuation"):
        require_sliding(problem.robot, problem.schedule, "acceleration", ())
    slide = problem.schedule.phases[0]
    hold = replace(slide, name="hold", surfaces={"block": replace(surface, slip_speed=None)})
    with pytest.raises(InputError, match="hold"):
        replace(problem, schedule=Schedule((slide, hold)))


MU = 0.6
LEVEL = Surface(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]), friction=MU)
# Normal forces over the weight, from none to twice the weight.
NORMAL = np.concatenate([[0.0], np.geomspace(1e-7, 2.0, 60)])
CONE_ROUNDING = 1e-12


@lru_cache
def row() -> ca.Function:
    """The row, and its gradient and Hessian, as functions of the force (3,) over the weight."""
    robot = hopper()
    context = Context(robot, Coordinates(robot.model), (robot.contact(FOOT),), surfaces={FOOT: LEVEL})
    rows = FrictionCone().rows(context, Units(robot))
    f = ca.SX.sym("f", 3)
    inputs = [context.wrenches[FOOT], context.frame(FOOT).rotation, context.parameters]
    given = [f * Units(robot).force, ca.DM.eye(3), context.parameter_values]
    value = ca.Function("rows", inputs, [rows.expression])(*given)[1]
    hessian, gradient = ca.hessian(value, f)
    return ca.Function("row", [f], [value, gradient, hessian])


def value(f: np.ndarray) -> float:
    return float(row()(f)[0])


def tangential_at(normal: float, level: float) -> float | None:
    """The tangential force at which the row has the value ``level``, None where it is below it already."""
    if value([0.0, 0.0, normal]) < level:
        return None
    inside, outside = 0.0, 10.0
    for _ in range(100):
        middle = (inside + outside) / 2
        inside, outside = (middle, outside) if value([middle, 0.0, normal]) >= level else (inside, middle)
    return inside


def test_forces_that_fulfil_the_row_are_within_coulombs_law():
    for normal in NORMAL:
        largest = tangential_at(normal, 0.0)
        assert largest is None or largest <= MU * normal * (1 + CONE_ROUNDING)


@pytest.mark.parametrize("violation", [1e-9, 1e-7, TIGHT])
def test_a_violation_of_the_row_bounds_the_distance_from_coulombs_law(violation):
    """The squared row of the whole cone would allow the root of the violation at zero normal force."""
    for normal in NORMAL:
        largest = tangential_at(normal, -violation)
        assert largest is None or largest - MU * normal <= 2 * violation


def test_only_the_tip_of_the_cone_is_left_out():
    tip = np.sqrt(TIGHT * APEX) / MU
    assert value([0.0, 0.0, 0.99 * tip]) < 0 < value([0.0, 0.0, 1.01 * tip])
    for normal in NORMAL[NORMAL > 0.02]:
        assert_allclose(tangential_at(normal, 0.0), MU * normal, rtol=CONE_ROUNDING)


@pytest.mark.parametrize("f", [[0, 0, 0], [1e-9, 0, 0], [0, 0, 1e-3], [2e-3, -1e-3, 4e-3], [0.1, 0.2, 1.0]])
def test_derivatives_are_finite_and_those_of_the_row(f):
    f, step = np.array(f, dtype=float), 1e-5
    _, gradient, hessian = (np.array(part) for part in row()(f))
    ahead, behind = ([row()(f + s * axis) for axis in step * np.eye(3)] for s in (1, -1))
    slope = [float(a[0] - b[0]) / (2 * step) for a, b in zip(ahead, behind, strict=True)]
    bend = [np.array(a[1] - b[1]).ravel() / (2 * step) for a, b in zip(ahead, behind, strict=True)]
    assert_allclose(gradient.ravel(), slope, atol=1e-6)
    assert_allclose(hessian, np.array(bend).T, atol=1e-2)  # of at most 2 / APEX


def test_file_holds_obstacles_and_the_shapes_of_the_links(tmp_path):
    problem, solution = avoided()
    loaded = Solution.load(solution.save(tmp_path / "swing.npz"))
    (term,) = (term for term in problem.terms if isinstance(term, Clearance))
    assert loaded.meta["collision"] == {
        "capsules": [],
        "obstacles": [BALL.describe(), FAR.describe()],
        "self_pairs": [],
    }
    assert loaded.meta["bodies"]["shapes"] == [shape.describe() for shape in term.shapes]
    assert check(loaded).to_dict() == check(solution).to_dict()


def test_check_finds_a_motion_that_collides():
    _, solution = avoided()
    moved = {**solution.meta["collision"], "obstacles": [replace(BALL, radius=0.2).describe()]}
    report = check(with_meta(solution, collision=moved))
    assert report.failures() == ("obstacle_distance", "clearance_margin")
    assert report.obstacle_distance < -0.03


def test_check_finds_a_motion_that_keeps_less_than_the_margin_and_touches_nothing():
    _, solution = avoided()
    wider = {"obstacles": MARGIN + 0.01, "pairs": []}
    report = check(with_meta(solution, bodies={**solution.meta["bodies"], "margins": wider}))
    assert report.failures() == ("clearance_margin",)
    assert report.clearance_margin == pytest.approx(report.obstacle_distance - MARGIN - 0.01)
    assert report.places["clearance_margin"] == report.places["obstacle_distance"]
    assert 0 < report.obstacle_distance < MARGIN + 0.01


def test_file_without_margins_is_judged_by_contact_alone():
    _, solution = avoided()
    bodies = {key: value for key, value in solution.meta["bodies"].items() if key != "margins"}
    report = check(with_meta(solution, bodies=bodies))
    assert report.clearance_margin is None
    # The margin is one more figure whose worst is looked at: samples in between differ.
    assert report.obstacle_distance == pytest.approx(check(solution).obstacle_distance, abs=1e-6)
    problem = past(swing(), BALL, margin=0.0)
    assert described_bodies(problem)["margins"] is None


def test_motion_at_less_than_the_margin_is_no_success():
    """The links pass beside a ball at half the margin, and can do nothing about it in their plane."""
    thickness = max(shape.radius for shape in ROD_CAPSULES)
    beside = replace(POLE, centre=POLE.centre + np.array([0.0, thickness + POLE.radius + MARGIN / 2, 0.0]))
    draft = solve_graded(past(swing(), beside), draft=True)
    assert draft.converged
    assert not draft.success
    assert draft.statistics.status == "coarse_grid"
    assert "clearance_margin" in draft.statistics.failures
    assert "obstacle_distance" not in draft.statistics.failures
    assert "distance beyond the margin asked for" in draft.statistics.advice


def test_older_file_with_capsules_alone_is_measured_by_them():
    _, solution = avoided()
    capsules = solution.meta["bodies"]["shapes"]
    scene = {**solution.meta["collision"], "capsules": capsules}
    older = with_meta(solution, drop=("bodies",), collision=scene)
    assert check(older).obstacle_distance == pytest.approx(check(solution).obstacle_distance)


NOWHERE = LinkShape.sphere("c", "nose", np.zeros(3), 0.1)
WRONG = {
    "list": [],
    "capsules": {"capsules": None, "obstacles": [], "self_pairs": []},
    "obstacle": {"capsules": [], "obstacles": [{"kind": "cone"}], "self_pairs": []},
    "pair": {"capsules": [], "obstacles": [], "self_pairs": [["a"]]},
    "frame": {"capsules": [NOWHERE.describe()], "obstacles": [], "self_pairs": []},
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_description_in_a_file_is_refused_in_one_line(case):
    _, solution = avoided()
    with refused("collision of meta: "):
        check(with_meta(solution, collision=WRONG[case]))


MARGINS = {
    "list": [],
    "none of obstacles": {"pairs": []},
    "pairs": {"obstacles": 0.0, "pairs": [0.1]},
    "negative": {"obstacles": -0.1, "pairs": []},
    "word": {"obstacles": "wide", "pairs": []},
}


@pytest.mark.parametrize("case", MARGINS)
def test_wrong_margins_in_a_file_are_refused_in_one_line(case):
    _, solution = avoided()
    with refused("margins of bodies of meta"):
        check(with_meta(solution, bodies={**solution.meta["bodies"], "margins": MARGINS[case]}))


def test_replay_draws_obstacles_where_they_are(tmp_path):
    _, solution = avoided()
    page = shown(solution, tmp_path)
    drawn, places = objects_of(page), placements_of(page)
    found = {name.split("obstacles/")[1] for name in drawn if "obstacles/" in name}
    assert found == {"ball/start", "far/start", "far/end", "far/side"}
    (ball,) = (matrix for name, matrix in places.items() if name.endswith("ball/start"))
    assert ball[:3, 3] == pytest.approx(BALL.centre, abs=1e-6)


def test_plots_have_the_distance_from_each_obstacle_by_the_links_shapes():
    problem, solution = avoided()
    (term,) = (term for term in problem.terms if isinstance(term, Clearance))
    scene = CollisionScene(model=solution.model, shapes=term.shapes, obstacles=term.obstacles)
    least = scene.distances(solution.q)
    found = PlottedMotion(solution).clearances
    assert set(found) == {"ball", "far"}
    assert found["ball"] == pytest.approx(least[:, ::2].min(axis=1))
    assert found["far"] == pytest.approx(least[:, 1::2].min(axis=1))
    without = solution.with_description(obstacles=())
    assert PlottedMotion(without).clearances == {}
    assert without.description.capsule_scene(solution.model) is None


# The solver's tolerance of 1e-6 on scaled rows and multipliers, with two orders for conditioning.
SOLVED = 1e-4
# The base quaternion of a free-flyer with the other sign.
AHEAD = np.array([1.0] + [0.0] * 8)
SIGNS = np.array([1.0] * 3 + [-1.0] * 4 + [1.0] * 2)


@pytest.mark.long
@pytest.mark.parametrize("part", ["all", "joints", "base"])
def test_tracking_cost_is_the_mean_square_distance_at_every_point(part):
    robot = hopper()
    problem, reference = (
        replace(hop(), guess=wandering(robot)),
        key_frames(robot, [0.0, 0.3, 1.0], np.array([wandering(robot)(t + 2.0) for t in (0.0, 0.5, 0.7)])),
    )
    solution, x = sampled(problem)
    distance = np.array(
        [_distance(robot, q, reference(t)) for q, t in zip(solution.q, solution.t, strict=True)]
    )
    rows = {"all": slice(0, 8), "joints": slice(6, 8), "base": slice(0, 6)}[part]
    expected = integral(solution, (distance[:, rows] ** 2).mean(axis=1)) / Units(robot).time
    cost = TrackingCost(weight=1.0, reference=reference, part=part)
    assert_allclose(objective(with_terms(problem, cost), x), expected, rtol=1e-9)
    other_sign = TrackingCost(weight=1.0, reference=lambda t: reference(t) * SIGNS, part=part)
    assert_allclose(objective(with_terms(problem, other_sign), x), expected, rtol=1e-9)


def _distance(robot: Robot, q: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Base position over the length, 2 sin(angle / 2) along the turn's axis, joints over their unit (nv,)."""
    turn = pin.log3((pin.XYZQUATToSE3(goal[:7]).inverse() * pin.XYZQUATToSE3(q[:7])).rotation)
    angle = np.linalg.norm(turn)
    chord = turn * 2 * math.sin(angle / 2) / angle
    return np.concatenate(
        [(q[:3] - goal[:3]) / robot.length, chord, (q[7:] - goal[7:]) / [1.0, robot.length]]
    )


def test_whole_turns_do_not_count_in_tracking():
    pendulum = robots.load("double_pendulum")
    schedule = Schedule((Phase(name="swing", duration=1.0),))
    problem = Problem(
        name="turns", robot=pendulum, schedule=schedule,
         initial_v=np.array([9.0, 1.0]), terms=(TorqueCost(weight=1.0),),
        guess=lambda t: pin.integrate(pendulum.model, pendulum.reference, np.array([9.0 * t, t])),
    )  # fmt: skip
    cost = TrackingCost(weight=1.0, reference=problem.guess)
    assert_allclose(objective(with_terms(problem, cost)), 0.0, atol=1e-20)


def test_a_feasible_reference_is_followed_exactly():
    robot = one_joint_arm(gravity=True)
    motion = key_frames(robot, [0.0, REACH_TIME], np.array([[0.0], [REACH]]))

    def smooth(t):
        return motion(REACH_TIME * smooth_step(t / REACH_TIME))

    solution = solve(
        with_terms(reach(gravity=True), TrackingCost(weight=1.0, reference=smooth)), intervals=20
    )
    points = solution.collocation
    followed = np.array([smooth(t) for t in solution.t[points]])
    assert_allclose(solution.q[points], followed, atol=SOLVED)


def test_another_reference_is_the_same_function_with_other_parameters():
    groups = []
    for shift in (0.0, 0.1):
        reference = key_frames(hopper(), [0.0, 1.0], np.tile(hopper().reference + shift * AHEAD, (2, 1)))
        problem = with_terms(hop(), TrackingCost(weight=1.0, reference=reference))
        groups.append(prepare(problem, intervals=6).transcription.groups)
    first, second = groups
    assert [group.point.text for group in first] == [group.point.text for group in second]
    assert any(not np.array_equal(a.parameters, b.parameters) for a, b in zip(first, second, strict=True))


def test_a_solution_is_a_reference_for_its_own_robot_only():
    solution = solve(reach(), intervals=6)
    motion = geodesic_motion(solution, one_joint_arm())
    assert_allclose(motion(0.0), solution.q[0])
    assert_allclose(motion(9.0), solution.q[-1])
    with pytest.raises(InputError, match="joints"):
        geodesic_motion(solution, hopper())
