"""Contacts with a radius: centres, footholds, and balls that roll against Pinocchio and closed forms."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.balls import RADIUS, WAVES, ball_hopper, ground_slope, landing_on, raised
from tests.support.contact_cases import body, close, independent
from tests.support.ground import HILLS, STAIRS
from tests.support.problems import FOOT, hop, hopper, phases
from tests.support.refusals import refusals, refused_calls
from tests.support.synthetic_motions import with_meta
from trajopt.certify.check import check
from trajopt.certify.contact.contact_dynamics import ContactDynamics, forward_dynamics
from trajopt.certify.contact.contact_set import ContactSet, contact_kinematics
from trajopt.certify.contact.impact import impact
from trajopt.dynamics.model_quantities import contact_jacobian
from trajopt.errors import InputError, SolutionFileError
from trajopt.motion.solution import Solution
from trajopt.problem.problem import Problem
from trajopt.reduced.single_rigid_body import body_problem
from trajopt.reduced.two_stage import base_rows_problem
from trajopt.reduced.wrench_distribution import redistribute_wrenches
from trajopt.robot.contact import Contact
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.robot import Robot
from trajopt.schedule.placing import footholds_at, placed_on
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.simulation.simulate import simulate
from trajopt.solving.diagnosis.diagnose import diagnose
from trajopt.solving.solving import prepare, solve
from trajopt.terms import FramePose, FrictionCone, SwingClearance, TerminalRest, TerminalState, effort_costs
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.patch import Patch
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.surface import Surface

SOLVED, ROUNDING = 1e-6, 1e-9
UP = np.array([0.0, 0.0, 1.0])
# A plane whose normal is not an axis of the world.
SLOPE = Surface(point=np.zeros(3), normal=np.array([-0.2, 0.1, 1.0]))


def rolling(problem: Problem) -> Problem:
    """The same task, feet rolling."""
    return replace(problem, robot=problem.robot.with_rolling_contacts())


def solved(problem: Problem) -> Solution:
    solution = trajopt.solve(problem)
    assert solution.converged, solution.statistics.advice
    return solution


@lru_cache
def walk(robot: str = "go2:rolling") -> Solution:
    return solved(trajopt.load("quadruped-walk", robot=robot))


def centres(solution: Solution, contact: int, rows: np.ndarray) -> list[tuple[np.ndarray, ...]]:
    """Place, twist and classical acceleration of a contact's frame at samples, by numeric Pinocchio."""
    model, data = solution.model, solution.model.createData()
    frame, axes, found = model.getFrameId(solution.contact_frames[contact]), pin.LOCAL_WORLD_ALIGNED, []
    for k in rows:
        pin.forwardKinematics(model, data, solution.q[k], solution.v[k], solution.a[k])
        place = pin.updateFramePlacement(model, data, frame).translation.copy()
        twist = pin.getFrameVelocity(model, data, frame, axes).vector
        found.append((place, twist, pin.getFrameClassicalAcceleration(model, data, frame, axes).vector))
    return found


@pytest.mark.long
def test_material_point_that_touches_has_no_velocity_and_the_centre_no_acceleration_but_that_of_rolling():
    solution = walk()
    for contact, radius in enumerate(solution.meta["contact_radius"]):
        rows = np.flatnonzero(solution.active[:, contact] & solution.collocation)
        turned = 0.0
        for _, twist, acceleration in centres(solution, contact, rows):
            assert_allclose(twist[:3] + np.cross(twist[3:], -radius * UP), 0.0, atol=1e-4)
            assert_allclose(acceleration[:3], np.cross(acceleration[3:], radius * UP), atol=1e-4)
            turned = max(turned, float(np.abs(twist[3:]).max()))
        assert turned > 0.5  # rad/s: it would not hold without rolling


def test_base_rows_hold_with_forces_where_balls_touch():
    solution, model = walk(), walk().model
    data, gravity = model.createData(), 9.81
    for k in np.flatnonzero(solution.collocation)[::7]:
        force = pin.rnea(model, data, solution.q[k], solution.v[k], solution.a[k])
        pin.computeJointJacobians(model, data, solution.q[k])
        pin.updateFramePlacements(model, data)
        for contact, radius in enumerate(solution.meta["contact_radius"]):
            frame = model.getFrameId(solution.contact_frames[contact])
            jacobian = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            touching = jacobian[:3] - pin.skew(-radius * UP) @ jacobian[3:]  # of the point r below the centre
            force -= touching.T @ solution.f[k, contact, :3]
        assert np.abs(force[:6]).max() < 1e-4 * pin.computeTotalMass(model) * gravity
        assert_allclose(force[6:], solution.tau[k], atol=1e-3)


@pytest.mark.long
def test_ball_of_a_leg_comes_as_far_as_its_link_turns():
    solution = solved(trajopt.load("quadruped-jump-up", robot="go2:rolling"))
    stance, radius = solution.phases[0], solution.meta["contact_radius"][0]
    places = np.array([place for place, *_ in centres(solution, 0, stance)])
    data, turns = solution.model.createData(), []
    for k in stance:
        pin.framesForwardKinematics(solution.model, data, solution.q[k])
        turns.append(data.oMf[solution.model.getFrameId(solution.contact_frames[0])].rotation.copy())
    # Legs move in nearly vertical planes: shanks turn about y.
    angle = np.array([pin.log3(turn @ turns[0].T) for turn in turns])
    assert np.ptp(angle[:, 1]) > 0.2
    assert_allclose((places - places[0])[:, 0], radius * angle[:, 1], atol=0.01 * radius)
    assert_allclose(places[:, 2], radius, atol=1e-5)


@pytest.mark.long
def test_a_plan_passes_only_as_what_it_was_planned():
    held, rolls = walk("go2"), walk()
    assert not check(held).failures()
    assert not check(rolls).failures()
    for solution in (held, rolls):
        contacts = solution.description.contacts
        others = tuple(replace(contact, rolling=not contact.rolling) for contact in contacts)
        assert "stance_drift" in check(solution.with_description(contacts=others)).failures()


@pytest.mark.long
@pytest.mark.parametrize("free", [False, True])
def test_impacts_of_balls_that_roll_hold(free):
    problem = hop(schedule=phases(free=free, impact=True))
    solution = solved(rolling(raised(problem, RADIUS)))
    assert not check(solution).failures()
    assert solution.impulse is not None
    assert np.abs(solution.impulse[0, 0, 3:]).max() > 0
    assert_allclose(solution.impulse[..., 3:], np.cross(solution.impulse[..., :3], RADIUS * UP), atol=1e-12)


@pytest.mark.long
def test_redistributed_wrenches_and_the_diagnosis_know_of_rolling():
    problem = trajopt.load("quadruped-walk", robot="go2:rolling")
    relaxed = trajopt.solve(base_rows_problem(problem), mesh=None)
    shared = redistribute_wrenches(problem, relaxed)
    arms = np.array([radius * UP for radius in shared.meta["contact_radius"]])
    assert_allclose(shared.f[..., 3:], np.cross(shared.f[..., :3], arms), atol=1e-9)
    assert diagnose(walk(), problem=problem).contacts


# Dynamics of a set of contacts

FRAMES = [("FL_FOOT", 3), ("HR_FOOT", 3)]


def two_balls() -> tuple[pin.Model, ContactSet, np.ndarray, np.ndarray, np.ndarray]:
    """Solo12 on a foot that rolls on a slope, and on another that is held."""
    case = independent("solo12 on two feet")
    lever = Contact(frame="FL_FOOT", radius=0.05, rolling=True).lever(SLOPE)
    contacts = ContactSet.of(case.model, FRAMES, levers=[lever, None])
    return case.model, contacts, case.q, case.v, case.tau


def test_rows_of_a_set_are_derivatives_of_the_velocity_where_balls_touch():
    model, contacts, q, v, _ = two_balls()
    data, step = model.createData(), 1e-6

    def velocity(time: float) -> np.ndarray:
        rows = contact_kinematics(model, data, pin.integrate(model, q, time * v), v, contacts)
        return rows.velocity

    rows = contact_kinematics(model, data, q, v, contacts)
    close(rows.drift, (velocity(step) - velocity(-step)) / (2 * step), 1e-7)
    levers = [None if lever is None else np.array(lever) for lever in contacts.levers]
    assert_allclose(rows.jacobian, contact_jacobian(model, q, FRAMES, levers))
    assert levers[0] == pytest.approx(0.05 * SLOPE.normal)


def test_dynamics_of_a_set_solve_the_dense_equations():
    model, contacts, q, v, tau = two_balls()
    data = model.createData()
    rows = contact_kinematics(model, data, q, v, contacts)
    mass, bias = pin.crba(model, data, q), pin.nonLinearEffects(model, data, q, v)
    mass = np.triu(mass) + np.triu(mass, 1).T
    whole = np.block([[mass, -rows.jacobian.T], [rows.jacobian, np.zeros((6, 6))]])
    expected = np.linalg.lstsq(whole, np.concatenate([tau - bias, -rows.drift]), rcond=None)[0]
    found = forward_dynamics(model, q, v, tau, contacts)
    close(found.acceleration, expected[: model.nv], ROUNDING)
    assert_allclose(found.dynamics_residual, 0.0, atol=1e-8)
    assert_allclose(found.contact_acceleration, 0.0, atol=1e-7)
    assert_allclose(found.wrenches[0, 3:], np.cross(found.wrenches[0, :3], contacts.levers[0]))
    assert not found.wrenches[1, 3:].any()
    dynamics = ContactDynamics(model, contacts)
    close(dynamics.acceleration(q, v, tau), expected[: model.nv], ROUNDING)
    compiled = dynamics.compiled.accelerations(q[None], v[None], tau[None])
    close(compiled[0], expected[: model.nv], ROUNDING)
    with pytest.raises(ValueError, match="no point of that number holds its place"):
        dynamics.compiled.roll(0, np.ones(3))
    after = impact(model, q, v, contacts).velocity
    assert_allclose(rows.jacobian @ after, 0.0, atol=ROUNDING)


@pytest.mark.parametrize("levers", [[np.ones(3)], [np.ones(2), None], [None, np.ones(3), None]])
def test_levers_are_of_points_one_for_each(levers):
    model = body({"ball": (0.1, 0.2, -0.3), "sole": (0, 0, 0)})
    with pytest.raises(InputError, match="levers are"):
        ContactSet.of(model, [("sole", 6), ("ball", 3)], levers=levers)


# Files, names, refusals


def test_files_say_which_contacts_roll(tmp_path):
    file = walk().save(tmp_path / "walk.npz")
    assert Solution.load(file).description.rolling.all()
    assert "contact_rolling" not in walk("go2").meta
    for wrong in ([True], [1, 0, 1, 0], "yes"):
        with pytest.raises(SolutionFileError, match=r"rolling .*(is not a list|allowed: True or False)"):
            with_meta(walk(), contact_rolling=wrong)
    with pytest.raises(SolutionFileError, match="rolling without a radius"):
        with_meta(walk(), contact_radius=[0.0] * 4)


test_names_of_robots_that_cannot_roll_are_refused = refusals(
    lambda robot: trajopt.robot(robot),
    ("talos:rolling", "'talos' has no contact that could roll"),
    ("go3:rolling", "'go3' is unknown"),
)


def landing_with(**surface: object) -> Problem:
    ground = Surface(point=np.zeros(3), normal=UP, **surface)
    problem = raised(hop(), RADIUS)
    landing = Phase(name="landing", duration=0.3, contacts=(FOOT,), surfaces={FOOT: ground})
    return replace(problem, schedule=Schedule((*problem.schedule.phases[:2], landing)))


@pytest.mark.parametrize(
    ("problem", "words"),
    [
        (lambda: landing_on(WAVES, ball_hopper()), "'foot' rolls in phase 'stance'.*not curved"),
        (lambda: landing_with(bilateral=True), "'foot' rolls in phase 'landing'.*neither hold it nor"),
        (lambda: body_problem(raised(hop(), RADIUS)), "'foot' rolls in phase 'stance'.*hold contacts"),
    ],
    ids=["waves", "grip", "reduced"],
)
def test_where_balls_cannot_roll_one_line_says_so(problem, words):
    with pytest.raises(InputError, match=words):
        rolling(problem())


# In simulation


@pytest.mark.long
@pytest.mark.parametrize("controller", ["joints", "whole-body"])
def test_feet_that_roll_track_plans_that_do(controller):
    held, rolls = walk("go2"), walk()
    assert simulate(rolls).scene.place.rolling.all()
    assert not simulate(held).scene.place.rolling.any()
    settings = {"cycles": 3, "controller": controller, "rolling": True}
    ends = [simulate(plan, **settings).report.base_error_end for plan in (held, rolls)]
    assert ends[1] < 0.2 * ends[0]


WHEELS = ("fl", "fr", "rl", "rr")
CART = (
    '<robot name="cart"><link name="base"><inertial><origin xyz="0 0 0.05"/><mass value="10"/>'
    '<inertia ixx="0.2" ixy="0" ixz="0" iyy="0.4" iyz="0" izz="0.5"/></inertial></link>{}</robot>'
)
WHEEL = (
    '<link name="{0}_wheel"><inertial><mass value="0.5"/>'
    '<inertia ixx="0.0014" ixy="0" ixz="0" iyy="0.0025" iyz="0" izz="0.0014"/></inertial></link>'
    '<joint name="{0}_axle" type="continuous"><parent link="base"/><child link="{0}_wheel"/>'
    '<origin xyz="{1} {2} 0"/><axis xyz="0 1 0"/><limit effort="10" velocity="50"/></joint>'
)


@pytest.fixture(scope="module")
def cart(tmp_path_factory):
    places = {"fl": (0.3, 0.2), "fr": (0.3, -0.2), "rl": (-0.3, 0.2), "rr": (-0.3, -0.2)}
    path = tmp_path_factory.mktemp("cart") / "cart.urdf"
    path.write_text(CART.format("".join(WHEEL.format(name, *place) for name, place in places.items())))
    contacts = [Contact(frame=f"{name}_wheel", name=name, radius=0.1, rolling=True) for name in WHEELS]
    return Robot.from_urdf(path, contacts=contacts)


@pytest.mark.parametrize("goal", [TerminalState, FramePose])
def test_a_goal_is_reached_by_rolling(cart, goal):
    q = cart.reference.copy()
    q[0] += 1.0
    end = goal(q=q) if goal is TerminalState else goal(frame="base", position=q[:3])
    problem = Problem(
        name="cart",
        robot=cart,
        schedule=Schedule((Phase(name="roll", duration=2.0, contacts=WHEELS),)),
        terms=(*effort_costs(), FrictionCone(), TerminalRest(), end),
    )
    motion = trajopt.solve(problem)
    turned = np.arctan2(motion.q[-1, 8::2], motion.q[-1, 7::2])
    assert motion.success
    assert motion.q[-1, 0] == pytest.approx(q[0], abs=1e-6)
    assert turned == pytest.approx(np.full(4, np.angle(np.exp(10j))), abs=1e-3)


def test_a_height_that_wheels_do_not_reach_is_still_refused(cart):
    q = cart.reference.copy()
    q[2] += 0.5
    roll = Schedule((Phase(name="roll", duration=2.0, contacts=WHEELS),))
    with pytest.raises(InputError, match="above its ground"):
        Problem(name="cart", robot=cart, schedule=roll, terms=(*effort_costs(), TerminalState(q=q)))


RADIUS_ROUNDING = 1e-12  # metres, after a few products of numbers near one
RADIUS_SOLVED = 1e-6  # what a solver leaves of a constraint, in its unit and in m
# Drift of the foot on 24 intervals, and what a grid of 1.5 mm misses of the nearest point's distance, m.
DRIFTED = 1e-4
RADIUS_SLOPE = FlatGround(height=0.1, normal=(-0.2, 0.1, 1.0))
STEP = PiecewiseTerrain.stairs(0.1, 0.4, 1, at=(0.1, 0.0))
RAMP = PiecewiseTerrain.slope(0.2, 0.5, at=(-0.2, 0.0))


# The contact


@pytest.mark.parametrize("radius", [-0.01, np.nan, np.inf, "0.01", True])
def test_a_radius_is_a_length(radius):
    with pytest.raises(InputError, match=r"radius of Contact( 'toe')? is .*>= 0"):
        Contact(frame="toe", radius=radius)


test_contacts_that_cannot_roll_are_refused = refused_calls(
    (lambda: Contact(frame="toe", rolling=True), "contact 'toe' rolls and has no radius"),
    (lambda: hopper().with_rolling_contacts(), "no contact that could roll"),
    (
        lambda: Contact(frame="sole", kind="surface", half_length=0.1, half_width=0.05, radius=0.01),
        "surface contact 'sole' has a radius",
    ),
)


def test_a_reference_posture_stands_on_the_ball():
    model = hopper().model
    robot = Robot.from_model(model, contacts=[Contact(frame=FOOT, radius=RADIUS)])
    point = Robot.from_model(model, contacts=[FOOT])
    assert contact_positions(robot, robot.reference)[FOOT][2] == pytest.approx(RADIUS, abs=RADIUS_ROUNDING)
    assert contact_positions(point, point.reference)[FOOT][2] == pytest.approx(0.0, abs=RADIUS_ROUNDING)
    assert robot.length == pytest.approx(point.length)


# Footholds and surfaces


@pytest.mark.parametrize(
    "ground", [FlatGround(), RADIUS_SLOPE, HILLS, WAVES, PiecewiseTerrain.slope(0.2, 0.5)]
)
def test_a_foothold_is_the_point_of_the_ground_under_the_centre(ground):
    robot, q = ball_hopper(), ball_hopper().reference.copy()
    foot = contact_positions(robot, q)[FOOT]
    q[2] -= float(ground.offset(RADIUS).surface_at(foot).distance(foot)) / ground_slope(ground, foot)
    centre, foothold = contact_positions(robot, q)[FOOT], footholds_at(robot, q, ground)[FOOT]
    assert_allclose(ground.surface_at(foothold).distance(foothold), 0.0, atol=RADIUS_SOLVED)
    assert np.linalg.norm(centre - foothold) == pytest.approx(RADIUS)
    phase = Phase(name="landing", duration=0.3, contacts=(FOOT,), footholds={FOOT: foothold})
    assert_allclose(phase.centre(robot.contact(FOOT), ground), centre, atol=RADIUS_SOLVED)


def test_a_foothold_on_a_surface_or_patch_is_a_point_of_it():
    wall = Surface(point=np.array([0.5, 0.0, 0.0]), normal=np.array([-1.0, 0.0, 0.0]))
    ball, place = Contact(frame=FOOT, radius=RADIUS), np.array([0.5, 0.1, 0.3])
    own = {"name": "touch", "duration": 0.3, "contacts": (FOOT,), "footholds": {FOOT: place}}
    touch = Phase(**own, surfaces={FOOT: wall})
    assert_allclose(touch.centre(ball, FlatGround()), [0.5 - RADIUS, 0.1, 0.3], atol=RADIUS_ROUNDING)
    assert touch.surface(FOOT, FlatGround(), RADIUS).same_plane(wall.offset(RADIUS))
    patch = Patch.rectangle((0.5, 0.1, 0.3), (0.2, 0.2))
    stand = Phase(**own, patches={FOOT: patch})
    assert_allclose(stand.centre(ball, FlatGround()), [0.5, 0.1, 0.3 + RADIUS], atol=RADIUS_ROUNDING)
    assert Phase(name="fly", duration=0.1).centre(ball, FlatGround()) is None


def test_a_schedule_placed_on_terrain_has_its_footholds_on_the_ground():
    phase = Phase(name="landing", duration=0.3, contacts=(FOOT,), footholds={FOOT: np.array([0.4, 0.0, 0.0])})
    (placed,) = placed_on(Schedule((phase,)), STAIRS).phases
    assert placed.footholds[FOOT][2] == pytest.approx(0.2)
    assert placed.centre(Contact(frame=FOOT, radius=RADIUS), STAIRS)[2] == pytest.approx(0.2 + RADIUS)


def test_contacts_of_a_problem_lie_on_the_parallel_surface_and_its_file_has_the_ground():
    robot = ball_hopper()
    problem = landing_on(STEP, robot, footholds={FOOT: np.array([0.2, 0.0, 0.1])})
    assert problem.surfaces_of(0)[FOOT].height == pytest.approx(RADIUS)
    assert problem.surfaces_of(2)[FOOT].height == pytest.approx(0.1 + RADIUS)
    place = problem.contact_place(FOOT, 2)
    assert place is not None
    assert place[2] == pytest.approx(0.1 + RADIUS)


# Motions


def test_on_level_ground_a_radius_moves_the_whole_problem_up():
    problem = hop(terms=(*hop().terms, SwingClearance(height=0.03, terrain=FlatGround())))
    point, ball = (prepare(one) for one in (problem, raised(problem, RADIUS)))
    assert len(point.guess) == len(ball.guess)
    noise = 0.05 * np.random.default_rng(1).normal(size=len(point.guess))
    for shift in (0.0, noise):
        values = [
            (one.nlp.engine.f(one.guess + shift), one.nlp.engine.g(one.guess + shift))
            for one in (point, ball)
        ]
        bounds = [(one.transcription.lower_g, one.transcription.upper_g) for one in (point, ball)]
        assert values[0][0] == pytest.approx(values[1][0], rel=1e-9)
        for own, other in zip(*bounds, strict=True):
            limited = np.isfinite(own)
            assert np.array_equal(limited, np.isfinite(other))
            left = [
                np.asarray(g)[limited] - b[limited] for (_, g), b in zip(values, (own, other), strict=True)
            ]
            assert_allclose(left[0], left[1], atol=1e-9)


def solved_on_balls(problem: Problem) -> Solution:
    solution = solve(problem)
    assert solution.converged, solution.statistics.advice
    return solution


def depth_of_ball(solution: Solution, ground) -> np.ndarray:
    """How deep the ball is in the ground at the samples (K,), m: its centre's distance from points of it."""
    at = np.linspace(-RADIUS, RADIUS, 41)
    x, y = (grid.ravel() for grid in np.meshgrid(at, at))
    found = []
    for q in solution.q:
        centre = contact_positions(ball_hopper(), q)[FOOT]
        points = np.column_stack([centre[0] + x, centre[1] + y, ground.height(centre[0] + x, centre[1] + y)])
        found.append(RADIUS - np.linalg.norm(points - centre, axis=1).min())
    return np.array(found)


@pytest.mark.long
@pytest.mark.parametrize("ground", [WAVES, STEP, RAMP])
def test_a_ball_touches_uneven_ground_and_does_not_sink_into_it(ground):
    place = {}
    if isinstance(ground, PiecewiseTerrain):
        place = {"footholds": {FOOT: np.array([0.2, 0.0, float(ground.height(0.2, 0.0))])}}
    problem = replace(landing_on(ground, ball_hopper(), **place), default_intervals=24)
    solution = solved_on_balls(problem)
    depth, report = depth_of_ball(solution, ground), check(solution)
    assert np.abs(depth[solution.active[:, 0]]).max() < DRIFTED
    assert report.penetration > max(depth.max(), 0.0) - DRIFTED  # it looks between samples, too
    assert report.landing_height < RADIUS_SOLVED
    assert report.friction_margin > -RADIUS_SOLVED


def test_the_file_has_radii_and_one_without_them_has_points():
    solution = solved_on_balls(raised(hop(), RADIUS))
    assert solution.meta["contact_radius"] == [RADIUS]
    assert check(solution).landing_height < RADIUS_SOLVED
    older = with_meta(solution, drop=("contact_radius",))
    assert check(older).landing_height == pytest.approx(RADIUS, abs=RADIUS_SOLVED)
