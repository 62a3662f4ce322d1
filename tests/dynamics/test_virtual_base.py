"""Virtual joints are the same floating robot as the free-flyer in other coordinates."""

from dataclasses import replace

import meshcat
import numpy as np
import pinocchio as pin
import pytest

import trajopt
from tests.support.problems import FOOT, hopper, lean
from tests.support.refusals import refused_calls
from trajopt import Problem, Robot, Schedule, Solution
from trajopt.certify.report import AT_POINTS
from trajopt.dynamics import ORDERS
from trajopt.dynamics.base_joint import base_of, virtual_order
from trajopt.dynamics.model_quantities import generalized_force
from trajopt.dynamics.virtual_base import (
    angles_of,
    base_jacobian,
    from_free_flyer,
    rotation_jacobian,
    rotation_jacobian_rate,
    rotation_of,
    to_free_flyer,
    virtual_model,
)
from trajopt.reduced import with_virtual_base
from trajopt.reduced.base_conversion import BaseAccelerationCost
from trajopt.robot import Drive, Units, robot_file
from trajopt.terms import AccelerationCost, PostureCost, TerminalRest, TerminalState, VelocityCost
from trajopt.transcription import transcribe
from trajopt.view.replay.commands import Recorder
from trajopt.view.replay.robot import draw_skeleton
from trajopt_library import problems, robots

# Rounding of algorithms over a dozen bodies, and of a solve with J_w, whose condition stays below ten here.
ROUNDING = 1e-10
# Central differences of step 1e-5 of quantities of order one.
STEP, DIFFERENCES = 1e-5, 1e-8
# Both solved to 1e-6 in natural units; a scheme of order six leaves less over these intervals.
SAME_OBJECTIVE = 1e-5
SAME_PATH = 1e-4
# What the issue of scale asks of legendre:2, whose error differs in both coordinates.
JUMP_OBJECTIVE, JUMP_PATH = 1e-4, 1e-3
# The middle angle stays this far from a right angle, rad.
CLEAR = 1.2

every_order = pytest.mark.parametrize("order", ORDERS)


def random_state(robot: Robot, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """State of a virtual-base robot, its middle angle clear of the lock, its outer ones anywhere."""
    generator = np.random.default_rng(seed)
    q = robot.reference + generator.uniform(-0.5, 0.5, robot.nq)
    q[3:6] = generator.uniform(-3, 3, 3)
    q[4] = generator.uniform(-CLEAR, CLEAR)
    return q, generator.uniform(-2, 2, robot.nv), generator.uniform(-5, 5, robot.nv)


def tilted() -> Robot:
    """A floating robot whose root joint is displaced and turned in the world."""
    model = pin.Model(hopper().model)
    model.jointPlacements[1] = pin.SE3(pin.exp3(np.array([0.3, -0.5, 0.8])), np.array([0.4, 0.1, -0.2]))
    return Robot.from_model(model, contacts=[FOOT])


@every_order
@pytest.mark.parametrize("make", [lambda: robots.load("solo12"), tilted])
def test_frames_energies_and_forces_are_those_of_the_free_flyer(order, make):
    floating = make()
    virtual = floating.with_virtual_base(order)
    q, v, a = random_state(virtual)
    state = to_free_flyer(virtual.model, q, v, a)
    ours, theirs = virtual.model.createData(), floating.model.createData()
    pin.forwardKinematics(virtual.model, ours, q, v, a)
    pin.forwardKinematics(floating.model, theirs, *state)
    pin.updateFramePlacements(virtual.model, ours)
    pin.updateFramePlacements(floating.model, theirs)
    for number, frame in enumerate(floating.model.frames):
        found = virtual.model.getFrameId(frame.name)
        np.testing.assert_allclose(ours.oMf[found].homogeneous, theirs.oMf[number].homogeneous, atol=ROUNDING)
        for motion in (pin.getFrameVelocity, pin.getFrameAcceleration):
            np.testing.assert_allclose(
                motion(virtual.model, ours, found).vector,
                motion(floating.model, theirs, number).vector,
                atol=ROUNDING,
            )
    for energy in (lambda m, d, q, v: pin.computeKineticEnergy(m, d, q, v),
                   lambda m, d, q, v: pin.computePotentialEnergy(m, d, q)):  # fmt: skip
        assert energy(virtual.model, ours, q, v) == pytest.approx(
            energy(floating.model, theirs, *state[:2]), rel=1e-12
        )
    force, torque = pin.rnea(virtual.model, ours, q, v, a), pin.rnea(floating.model, theirs, *state)
    np.testing.assert_allclose(force[6:], torque[6:], atol=ROUNDING)
    rotation = rotation_of(order, q[3:6])
    wrench = np.concatenate([rotation @ torque[:3], rotation @ torque[3:6]])
    np.testing.assert_allclose(force[:6], base_jacobian(order, q[3:6]).T @ wrench, atol=ROUNDING)


@every_order
def test_the_mass_matrix_is_the_free_flyers_seen_through_the_base_jacobian(order):
    floating = robots.load("solo12")
    virtual = floating.with_virtual_base(order)
    q, v, _ = random_state(virtual)
    state = to_free_flyer(virtual.model, q, v, v)
    rotation = np.kron(np.eye(2), rotation_of(order, q[3:6]).T)
    to_body = np.eye(virtual.nv)
    to_body[:6, :6] = rotation @ base_jacobian(order, q[3:6])
    ours = pin.crba(virtual.model, virtual.model.createData(), q)
    theirs = pin.crba(floating.model, floating.model.createData(), state[0])
    np.testing.assert_allclose(ours, to_body.T @ theirs @ to_body, atol=ROUNDING)


@every_order
def test_the_jacobian_maps_rates_of_the_angles_to_the_turning_of_the_rotation(order):
    generator = np.random.default_rng(1)
    angles, rates = generator.uniform(-1, 1, 3), generator.uniform(-1, 1, 3)
    before, after = (rotation_of(order, angles + step * rates) for step in (-STEP, STEP))
    omega = pin.log3(after @ before.T) / (2 * STEP)
    np.testing.assert_allclose(rotation_jacobian(order, angles) @ rates, omega, atol=DIFFERENCES)
    moved = [rotation_jacobian(order, angles + step * rates) for step in (-STEP, STEP)]
    np.testing.assert_allclose(
        rotation_jacobian_rate(order, angles, rates), (moved[1] - moved[0]) / (2 * STEP), atol=DIFFERENCES
    )
    jacobian = base_jacobian(order, angles)
    np.testing.assert_array_equal(jacobian[:3], np.eye(6)[:3])
    np.testing.assert_array_equal(jacobian[3:, :3], 0)


@every_order
def test_maps_to_and_from_a_free_flyer_invert_each_other(order):
    virtual = robots.load("solo12").with_virtual_base(order)
    for seed in range(5):
        state = random_state(virtual, seed)
        back = from_free_flyer(order, *to_free_flyer(virtual.model, *state), near=state[0][3:6])
        for found, expected in zip(back, state, strict=True):
            np.testing.assert_allclose(found, expected, atol=ROUNDING)


@every_order
def test_angles_continue_those_nearby_over_turns_and_through_the_lock(order):
    for middle in (0.3, 1.5, np.pi / 2, 1.7, 3.0, -2.0, 7.0):
        angles = np.array([0.4, middle, -0.7])
        near = angles + np.array([0.05, -0.04, 0.03 if middle != np.pi / 2 else 0.0])
        np.testing.assert_allclose(
            rotation_of(order, angles_of(order, rotation_of(order, angles), near)),
            rotation_of(order, angles),
            atol=1e-7,  # half the digits of the cosine are lost in the lock
        )
        found = angles_of(order, rotation_of(order, angles), near)
        np.testing.assert_allclose(found, angles, atol=1e-7)
    plain = angles_of(order, rotation_of(order, [0.4, 2.0, -0.7]))
    assert abs(plain[1]) <= np.pi / 2


def test_everything_behind_the_base_is_kept():
    floating = robots.load("solo12").with_drives({"FL_KFE": Drive(gear_ratio=9.0, rotor_inertia=1e-5)})
    floating = replace(floating, torque_limit=np.linspace(1.0, 2.0, 12))
    virtual = floating.with_virtual_base()
    assert (virtual.base, virtual.nq, virtual.nv, virtual.nu, virtual.n_unactuated) == (
        "virtual",
        18,
        18,
        12,
        6,
    )
    assert virtual.contacts == floating.contacts
    assert virtual.drives == floating.drives
    assert virtual.visual == floating.visual
    np.testing.assert_array_equal(virtual.model.armature, floating.model.armature)
    np.testing.assert_array_equal(virtual.torque_limit, floating.torque_limit)
    np.testing.assert_array_equal(virtual.velocity_limit, floating.velocity_limit)
    np.testing.assert_array_equal(virtual.position_upper[6:], floating.position_upper[7:])
    assert np.isposinf(virtual.position_upper[:6]).all()
    np.testing.assert_allclose(virtual.reference[6:], floating.reference[7:])
    ours, theirs = Units(virtual), Units(floating)
    assert (ours.length, ours.force) == pytest.approx((theirs.length, theirs.force))
    np.testing.assert_array_equal(ours.position, theirs.position)


def test_pictures_hang_on_the_base():
    floating = robots.load("solo12")
    virtual = floating.with_virtual_base()
    q, v, a = random_state(virtual)
    placed = []
    for robot, state in ((virtual, q), (floating, to_free_flyer(virtual.model, q, v, a)[0])):
        geometry = floating.visual.geometry(robot.model)
        data = geometry.createData()
        pin.updateGeometryPlacements(robot.model, robot.model.createData(), geometry, data, state)
        placed.append(np.array([placement.homogeneous for placement in data.oMg]))
    np.testing.assert_allclose(placed[0], placed[1], atol=ROUNDING)


def test_a_file_gives_the_same_robot_as_the_conversion():
    path = robot_file("solo_description/robots/solo12.urdf")
    converted = robots.load("solo12").with_virtual_base()
    read = Robot.from_urdf(
        path, base="virtual", contacts=converted.contacts, reference=converted.reference[6:], name="solo12"
    )
    assert (base_of(read.model), virtual_order(read.model)) == ("virtual", "ZYX")
    np.testing.assert_allclose(read.reference, converted.reference, atol=ROUNDING)
    state = random_state(read)
    forces = [pin.rnea(robot.model, robot.model.createData(), *state) for robot in (read, converted)]
    np.testing.assert_array_equal(*forces)


def test_locking_and_converting_commute():
    floating = robots.load("solo12")
    one = floating.with_virtual_base("YXZ").with_locked(["FL_HAA", "HR_KFE"])
    other = floating.with_locked(["FL_HAA", "HR_KFE"]).with_virtual_base("YXZ")
    assert (one.base, virtual_order(one.model), one.nv) == ("virtual", "YXZ", 16)
    state = random_state(one)
    forces = [pin.rnea(robot.model, robot.model.createData(), *state) for robot in (one, other)]
    np.testing.assert_allclose(*forces, atol=ROUNDING)


def test_a_gantry_of_the_same_joints_is_not_a_base():
    model, parent = pin.Model(), 0
    kinds = (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ)
    for name, kind in zip(
        "abcdef", (*kinds, pin.JointModelRZ, pin.JointModelRY, pin.JointModelRX), strict=True
    ):
        parent = model.addJoint(parent, kind(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(parent, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    robot = Robot.from_model(model)
    assert (robot.base, robot.nu) == ("fixed", 6)


test_what_cannot_be_converted_is_refused = refused_calls(
    (lambda: robots.load("ur5").with_virtual_base(), r"has base='fixed'; 'freeflyer'"),
    (lambda: robots.load("solo12").with_virtual_base("ZYZ"), r"order 'ZYZ'.*one of ZYX"),
    (lambda: robots.load("solo12").with_virtual_base().with_virtual_base(), "has base='virtual'"),
    (lambda: virtual_model(robots.load("ur5").model), "has no free-flyer"),
    (lambda: to_free_flyer(robots.load("ur5").model, *np.zeros((3, 6))), "has no virtual base"),
)


def free_flyer_path(solution: Solution) -> np.ndarray:
    states = zip(solution.q, solution.v, solution.a, strict=True)
    return np.array([to_free_flyer(solution.model, *state)[0] for state in states])


def both(problem: Problem, order: str, **options: object) -> tuple[Solution, Solution]:
    solutions = [
        trajopt.solve(asked, **options, fixed_mesh=True)
        for asked in (problem, with_virtual_base(problem, order))
    ]
    for solution in solutions:
        assert solution.converged, solution.statistics.advice
    return solutions[0], solutions[1]


@pytest.mark.parametrize("order", ["ZYX", "YXZ"])
def test_the_same_problem_has_the_same_optimum_on_both_bases(order):
    turning, jointed = both(lean(), order, transcription="legendre:3")
    assert jointed.statistics.objective == pytest.approx(turning.statistics.objective, rel=SAME_OBJECTIVE)
    np.testing.assert_allclose(free_flyer_path(jointed)[:, :3], turning.q[:, :3], atol=SAME_PATH)
    np.testing.assert_allclose(jointed.tau, turning.tau, atol=SAME_PATH * hopper().weight)


@pytest.mark.long
def test_plans_on_virtual_joints_pass_the_check_and_the_free_flyers_dynamics(tmp_path):
    problem = with_virtual_base(problems.load("solo12-jump", distance=0.1, yaw=0.3))
    solution = trajopt.solve(problem, intervals=30)
    assert solution.converged, solution.statistics.advice
    solution.save(tmp_path / "jump.npz")
    report = trajopt.check(tmp_path / "jump.npz")
    assert report.within(AT_POINTS), str(report)
    assert report.ballistic_error is not None
    assert report.momentum_error is not None
    floating = robots.load("solo12")
    frames = [floating.model.getFrameId(contact.frame) for contact in floating.contacts]
    for k in np.flatnonzero(solution.collocation):
        motion = to_free_flyer(solution.model, solution.q[k], solution.v[k], solution.a[k])
        force = generalized_force(floating.model, floating.model.createData(), motion, frames, solution.f[k])
        expected = np.concatenate([np.zeros(6), solution.tau[k]])
        np.testing.assert_allclose(force, expected, atol=1e-5 * floating.weight)


def test_configurations_of_terms_are_mapped_and_other_terms_are_left_alone():
    problem = problems.load("solo12-jump", distance=0.1, yaw=0.7)
    posture = PostureCost(weight=0.1, q=problem.robot.reference)
    converted = with_virtual_base(replace(problem, terms=(*problem.terms, posture)))
    (end,) = [term for term in problem.terms if isinstance(term, TerminalState)]
    for kind in (TerminalState, TerminalRest):
        (found,) = [term for term in converted.terms if isinstance(term, kind)]
        np.testing.assert_allclose(found.q[3:6], [0.7, 0.0, 0.0], atol=ROUNDING)
        np.testing.assert_allclose(found.q[6:], end.q[7:])
    assert converted.terms[-1].q.shape == (18,)
    kept = [term for term in problem.terms if any(term is other for other in converted.terms)]
    assert len(kept) == len(problem.terms) - 4  # both goals, velocity and acceleration costs
    np.testing.assert_allclose(converted.guess(0.2)[6:], problem.guess(0.2)[7:])


def test_costs_of_the_joints_alone_need_no_conversion():
    costs = (VelocityCost(weight=1.0, joints_only=True), AccelerationCost(weight=1.0, during="flight"))
    jump = problems.load("solo12-jump")
    kept, converted = with_virtual_base(replace(jump, terms=costs)).terms
    assert kept is costs[0]
    assert (type(converted), converted.weight) == (BaseAccelerationCost, 1.0)
    assert converted.phases == ("flight",)


@pytest.mark.long
@pytest.mark.parametrize("yaw", [0.0, 0.6])
def test_the_same_jump_on_both_bases_agrees(yaw):
    jump = problems.load("solo12-jump", distance=0.2, yaw=yaw)
    turning, jointed = both(jump, "ZYX", intervals=30)
    assert jointed.statistics.objective == pytest.approx(turning.statistics.objective, rel=JUMP_OBJECTIVE)
    np.testing.assert_allclose(free_flyer_path(jointed)[:, :3], turning.q[:, :3], atol=JUMP_PATH)
    assert trajopt.check(jointed).within(AT_POINTS)
    assert jointed.statistics.gimbal_margin > 0.9


def test_a_skeleton_shows_no_virtual_joints(tmp_path):
    problem = with_virtual_base(lean())
    solution = trajopt.solve(problem, max_iterations=0, fixed_mesh=True)
    shown = draw_skeleton(meshcat.Visualizer(window=Recorder()), solution)
    still = draw_skeleton(
        meshcat.Visualizer(window=Recorder()), trajopt.solve(lean(), max_iterations=0, fixed_mesh=True)
    )
    assert {joint - 5 for joint in shown.points} == set(still.points)
    for joint, points in still.points.items():
        np.testing.assert_allclose(np.vstack(shown.points[joint + 5]), np.vstack(points), atol=ROUNDING)


def test_conversion_takes_free_durations():
    problem = problems.load("solo12-jump", distance=0.1)
    phases = [replace(phase, duration_bounds=(0.1, 1.0)) for phase in problem.schedule.phases]
    free = with_virtual_base(replace(problem, schedule=Schedule(tuple(phases))))
    assert transcribe(free, "legendre:1", 6).layout.forms[0].n_time_scales == 3
