"""One rigid body on footholds against sums over links, numeric Pinocchio and free motion."""

from dataclasses import replace
from functools import lru_cache

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.problems import FOOT, hop, hopper, planar_hopper
from trajopt import InputError, Problem, Robot, Solution
from trajopt.certify.report import AT_POINTS
from trajopt.dynamics import Coordinates
from trajopt.reduced import body_problem, guess_from_srb
from trajopt.reduced.body_guess import BasePath
from trajopt.reduced.footsteps import feet_of
from trajopt.reduced.single_rigid_body import (
    BODY,
    LONGEST,
    BodyDynamics,
    FootReach,
    body_robot,
    footholds_of,
    rigid_body,
)
from trajopt.robot import Units
from trajopt.terms import Context
from trajopt_library import problems, robots
from trajopt_library.problems.bipeds import biped

# Sums in another order.
ROUNDING = 1e-10
# What a solver leaves at 1e-6 in natural units, of velocities and momenta over an interval.
SOLVED = 1e-5
# Differences over 1e-5 s of piecewise polynomials.
DIFFERENCED = 1e-4
# Iterations within which every example is to solve from its own guess.
MOST_ITERATIONS = 60


@lru_cache
def jump() -> tuple[Problem, Solution]:
    """A jump of Solo12 with a turn, and its solution on one body."""
    problem = problems.load("solo12-jump", distance=0.3, yaw=0.5)
    return problem, trajopt.solve(body_problem(problem), intervals=30)


def composite(robot: Robot) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, CoM and inertia about it in base axes, link by link with the parallel-axis theorem."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.reference)
    links = [
        (data.oMi[1].actInv(data.oMi[j]), robot.model.inertias[j]) for j in range(1, robot.model.njoints)
    ]
    mass = sum(link.mass for _, link in links)
    com = sum(link.mass * place.act(link.lever) for place, link in links) / mass
    inertia = np.zeros((3, 3))
    for place, link in links:
        arm = place.act(link.lever) - com
        inertia += place.rotation @ link.inertia @ place.rotation.T
        inertia += link.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return mass, com, inertia


@pytest.mark.parametrize(
    "robot", [robots.load("solo12"), biped("talos"), hopper("surface")], ids=lambda r: r.name
)
def test_mass_properties_are_the_sum_over_links_and_weight_and_length_stay(robot: Robot) -> None:
    body, one = rigid_body(robot), body_robot(robot)
    mass, com, inertia = composite(robot)
    assert_allclose(body.mass, mass, rtol=ROUNDING)
    assert_allclose(body.lever, com, atol=ROUNDING)
    assert_allclose(body.inertia, inertia, atol=ROUNDING * mass)
    assert (one.nv, one.nu) == (6, 0)
    assert_allclose([one.weight, one.length], [robot.weight, robot.length], rtol=1e-9)
    for name, foot in feet_of(one, one.reference).items():
        assert_allclose(foot.position, feet_of(robot, robot.reference)[name].position, atol=ROUNDING)


def test_a_tilted_reference_gives_the_same_body() -> None:
    robot = robots.load("solo12")
    tilted = robot.reference.copy()
    tilted[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(0.3, -0.2, 1.0)).coeffs()
    body, turned = rigid_body(robot), rigid_body(replace(robot, reference=tilted))
    assert_allclose(turned.inertia, body.inertia, atol=ROUNDING)
    assert_allclose(turned.lever, body.lever, atol=ROUNDING)
    assert_allclose([turned.hips[n] for n in body.hips], [body.hips[n] for n in body.hips], atol=ROUNDING)


@pytest.mark.parametrize("robot", [robots.load("solo12"), biped("talos")], ids=lambda r: r.name)
def test_rows_are_newton_euler_of_numeric_pinocchio(robot: Robot) -> None:
    generator = np.random.default_rng(3)
    one, contacts = body_robot(robot), robot.contacts
    feet = feet_of(robot, robot.reference)
    context = Context(one, Coordinates(one.model), contacts)
    rows = BodyDynamics(body=rigid_body(robot), footholds=feet).rows(context, Units(one))
    function = ca.Function(
        "rows", [context.z, context.parameters], [rows.expression, context.q, context.v, context.a]
    )
    z = generator.uniform(-1, 1, context.z.numel())
    z[:4] /= np.linalg.norm(z[:4])
    phi, q, v, a = (np.asarray(x).ravel() for x in function(z, context.parameter_values))
    data = one.model.createData()
    force = pin.rnea(one.model, data, pin.normalize(one.model, q), v, a)
    base, start = pin.XYZQUATToSE3(pin.normalize(one.model, q)), 22
    for contact in contacts:
        wrench, start = z[start : start + contact.dimension], start + contact.dimension
        moment = wrench[3:] if contact.dimension == 6 else np.zeros(3)
        at_foot = pin.SE3(np.eye(3), feet[contact.name].position)
        force -= base.actInv(at_foot.act(pin.Force(wrench[:3], moment))).vector
    about_com = force[3:] - np.cross(rigid_body(robot).lever, force[:3])
    assert_allclose(phi, [*(base.rotation @ force[:3]), *about_com], atol=1e-9 * robot.weight)


def test_legs_reach_further_than_they_do_in_the_reference_and_no_further_than_their_links() -> None:
    for robot in (robots.load("solo12"), biped("talos")):
        body, data = rigid_body(robot), robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, robot.reference)
        for contact in robot.contacts:
            frame = robot.model.frames[robot.model.getFrameId(contact.frame)]
            chain = [j for j in robot.model.supports[frame.parentJoint] if j > 2]
            links = [robot.model.jointPlacements[j].translation for j in chain if robot.model.parents[j] > 1]
            longest = sum(np.linalg.norm(link) for link in [*links, frame.placement.translation])
            now = np.linalg.norm(
                feet_of(robot, robot.reference)[contact.name].position
                - data.oMi[1].act(body.hips[contact.name])
            )
            assert now < body.legs[contact.name] <= longest + 1e-6


def test_the_problem_has_no_legs_and_no_torques_but_all_that_is_about_the_base() -> None:
    problem = problems.load("solo12-jump", height=0.1)
    reduced = body_problem(problem)
    assert [type(term).__name__ for term in reduced.terms if not isinstance(term, FootReach)] == [
        "AccelerationCost",
        "VelocityCost",
        "WrenchCost",
        "FrictionPyramid",
        "FrameHeight",
        "FramePose",
        "FrameVelocity",
    ]
    assert not [term for term in reduced.node_constraints if "landing" in term.name]
    for before, after in zip(problem.schedule.phases, reduced.schedule.phases, strict=True):
        assert (after.name, after.duration, after.contacts) == (before.name, before.duration, before.contacts)


@pytest.mark.long
def test_solution_flies_on_a_parabola_with_constant_momentum() -> None:
    _, solution = jump()
    assert solution.converged
    assert solution.tau.shape == (solution.n_samples, 0)
    model, data = solution.model, solution.model.createData()
    rows = solution.phases[1]
    momenta, coms = [], []
    for row in rows:
        momenta.append(
            pin.computeCentroidalMomentum(model, data, solution.q[row], solution.v[row]).vector.copy()
        )
        coms.append(pin.centerOfMass(model, data, solution.q[row], solution.v[row]).copy())
    t = solution.t[rows.start : rows.stop] - solution.t[rows.start]
    momenta, coms = np.array(momenta), np.array(coms)
    speed = momenta[0, :3] / pin.computeTotalMass(model)
    parabola = coms[0] + np.outer(t, speed) + np.outer(t**2 / 2, model.gravity.linear)
    assert_allclose(coms, parabola, atol=SOLVED)
    # Gauss points of order 4 keep the angular momentum of a spinning body to their order, not exactly.
    assert_allclose(momenta[:, 3:], np.tile(momenta[0, 3:], (len(t), 1)), atol=1e-4)


def test_solution_balances_forces_on_footholds_within_friction_and_reach() -> None:
    problem, solution = jump()
    plan, body = footholds_of(problem), rigid_body(problem.robot)
    model, data, gravity = solution.model, solution.model.createData(), solution.model.gravity.linear
    names = [contact.name for contact in problem.robot.contacts]
    for row in np.flatnonzero(solution.collocation):
        feet = plan.supports[solution.phase[row]].feet
        f = solution.f[row, :, :3]
        pin.centerOfMass(model, data, solution.q[row], solution.v[row], solution.a[row])
        assert_allclose(
            body.mass * (data.acom[0] - gravity), f.sum(axis=0), atol=SOLVED * problem.robot.weight
        )
        base = pin.XYZQUATToSE3(solution.q[row])
        for name, foot in feet.items():
            force = f[names.index(name)]
            assert abs(force[:2]).max() <= 0.7 / np.sqrt(2) * force[2] + SOLVED * problem.robot.weight
            leg = np.linalg.norm(foot.position - base.act(body.hips[name]))
            assert leg <= (LONGEST + SOLVED) * body.legs[name]
    assert_allclose(solution.q[-1, :3], problem.robot.reference[:3] + np.array([0.3, 0, 0]), atol=SOLVED)
    assert_allclose(solution.v[-1], 0.0, atol=SOLVED)


def test_footholds_come_from_the_schedule_or_from_the_guess_onto_the_ground() -> None:
    problem = problems.load("solo12-jump")
    landing = problem.schedule.phases[2]
    feet = footholds_of(problem).supports[2].feet
    for name, point in landing.footholds.items():
        above = np.array([0.0, 0.0, problem.robot.contact(name).radius])
        assert_allclose(feet[name].position, point + above)
    free = replace(hop(), guess=lambda t: hopper().reference + np.eye(9)[0] * 0.2 + np.eye(9)[2] * 0.1)
    found = footholds_of(free).supports[2].feet[FOOT].position
    start = feet_of(free.robot, free.initial_q)[FOOT].position
    assert_allclose(found, [start[0] + 0.2, start[1], 0.0], atol=ROUNDING)


def test_base_path_goes_through_samples_with_their_rates_and_is_smooth_between() -> None:
    _, solution = jump()
    path, step = BasePath(solution), 1e-5
    for row in np.flatnonzero(solution.collocation)[::4]:
        t = solution.t[row]
        here = pin.XYZQUATToSE3(solution.q[row])
        assert_allclose(path(t).homogeneous, here.homogeneous, atol=ROUNDING)
        before, after = here.actInv(path(t - step)), here.actInv(path(t + step))
        twist = (pin.log6(after).vector - pin.log6(before).vector) / (2 * step)
        assert_allclose(twist, solution.v[row], atol=DIFFERENCED * max(1.0, np.abs(solution.v).max()))


def test_path_of_free_durations_is_stretched_to_the_nominal_ones_phase_by_phase() -> None:
    _, solution = jump()
    nominal = (0.8, 0.3, 0.25)
    path, stretched = BasePath(solution), BasePath(solution, nominal)
    starts, begins = np.cumsum([0.0, *nominal]), [solution.t[rows.start] for rows in solution.phases]
    for i, rows in enumerate(solution.phases):
        span = solution.t[rows.stop - 1] - begins[i]
        for s in (0.0, 0.3, 0.9):
            expected = path(begins[i] + s * span).homogeneous
            assert_allclose(stretched(starts[i] + s * nominal[i]).homogeneous, expected, atol=ROUNDING)


def test_guess_has_the_base_of_the_body_and_feet_on_their_footholds() -> None:
    problem, solution = jump()
    guess, plan = guess_from_srb(problem, solution), footholds_of(problem)
    starts = np.cumsum([0.0] + [support.duration for support in plan.supports])
    for i, support in enumerate(plan.supports):
        for s in (0.05, 0.5, 0.95):
            t = starts[i] + s * support.duration
            q = guess(t)
            assert_allclose(
                pin.XYZQUATToSE3(q[:7]).homogeneous, BasePath(solution)(t).homogeneous, atol=ROUNDING
            )
            found = feet_of(problem.robot, q)
            for name, foot in support.feet.items():
                assert_allclose(found[name].position, foot.position, atol=1e-6)
    middle = feet_of(problem.robot, guess((starts[1] + starts[2]) / 2))
    assert min(foot.position[2] for foot in middle.values()) > 0.0


def test_unsuitable_robots_solutions_and_reaches_are_refused() -> None:
    problem, solution = jump()
    with pytest.raises(InputError, match="free-flyer"):
        body_robot(robots.load("ur5"))
    with pytest.raises(InputError, match="free-flyer"):
        rigid_body(planar_hopper())
    with pytest.raises(InputError, match="reach"):
        body_problem(problem, shortest=1.0, longest=0.5)
    with pytest.raises(InputError, match="phases"):
        guess_from_srb(problems.load("biped-walk"), solution)
    assert problem.robot.model.existFrame(BODY) is False


@pytest.mark.slow
def test_full_jump_from_the_guess_of_one_body_reaches_the_same_optimum() -> None:
    problem, solution = jump()
    guess = guess_from_srb(problem, solution)
    # On the problem's own grid: on 30 intervals this guess is nearer to an optimum whose feet slide.
    found = [trajopt.solve(p, fixed_mesh=True) for p in (problem, replace(problem, guess=guess))]
    assert all(s.converged and s.statistics.iterations <= MOST_ITERATIONS for s in found)
    assert found[1].statistics.objective == pytest.approx(found[0].statistics.objective, rel=1e-4)
    assert not trajopt.check(found[1]).failures(AT_POINTS)
