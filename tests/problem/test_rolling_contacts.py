"""Balls that roll: rows against numeric Pinocchio at the point of contact, closed forms, files, refusals."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.balls import RADIUS, WAVES, ball_hopper, landing_on, raised
from tests.support.contact_cases import body, close, independent
from tests.support.problems import FOOT, hop, hopper, phases
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
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.simulation.simulate import simulate
from trajopt.solving.diagnosis.diagnose import diagnose
from trajopt.terms import FramePose, FrictionCone, TerminalRest, TerminalState, effort_costs
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


@pytest.mark.parametrize(
    ("robot", "words"),
    [("talos:rolling", "'talos' has no contact that could roll"), ("go3:rolling", "'go3' is unknown")],
)
def test_names_of_robots_that_cannot_roll_are_refused(robot, words):
    with pytest.raises(InputError, match=words):
        trajopt.robot(robot)


def test_only_balls_roll():
    with pytest.raises(InputError, match="contact 'toe' rolls and has no radius"):
        Contact(frame="toe", rolling=True)
    with pytest.raises(InputError, match="no contact that could roll"):
        hopper().with_rolling_contacts()


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
