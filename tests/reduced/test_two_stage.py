"""Two stages of locomotion against numeric Pinocchio, linear programs and the full problem."""

from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import linprog

import trajopt
from tests.support.problems import FOOT, hop, hopper, reach
from trajopt import InputError, Problem, Solution, terms
from trajopt.certify.report import AT_POINTS
from trajopt.dynamics import contact_jacobian
from trajopt.motion.samples import sample_quantities
from trajopt.reduced import base_rows_problem, recover_torques, redistribute_wrenches
from trajopt.reduced.two_stage import standing_share, torque_bounds, torque_terms
from trajopt.robot import Drive, Units
from trajopt.solving.extraction import extract
from trajopt.solving.solving import prepare
from trajopt.transcription import Derivatives, transcribe
from trajopt.transcription.guess import initial_guess
from trajopt_library import problems

# Numeric Pinocchio against itself in another order of sums.
ROUNDING = 1e-9
# OSQP at 1e-9 on rows of order one, in parts of a torque limit; unpolished where its polishing fails.
OPTIMAL = 1e-5
# Iterations within which every example is to solve from its own guess.
MOST_ITERATIONS = 60


@lru_cache
def guessed(**values: object) -> tuple[Problem, Solution]:
    """The jump of Solo12 with its guess as the motion: real kinematics without a solver."""
    problem = problems.load("solo12-jump", **values)
    transcription = transcribe(problem, "legendre:2", 12)
    return problem, extract(transcription, initial_guess(transcription))


def largest_point(problem: Problem) -> object:
    groups = transcribe(problem, "legendre:1", 8).groups
    return max((group.point for group in groups), key=lambda point: point.n_z)


@dataclass(frozen=True, kw_only=True)
class PowerCost(terms.Cost):
    """A cost of a user's own that asks for torques together with rates."""

    def residual(self, context: terms.Context, units: Units) -> ca.SX:
        return context.torque * context.dxi[context.robot.n_unactuated :] / units.torque


@dataclass(frozen=True, kw_only=True)
class BaseForceCost(terms.Cost):
    """A cost that asks for generalised forces, but for the base rows alone."""

    def residual(self, context: terms.Context, units: Units) -> ca.SX:
        return context.base_rows / units.force


def test_terms_that_ask_for_torques_are_found_by_what_they_depend_on() -> None:
    driven = hopper().with_drives({"hip": Drive(gear_ratio=5.0, torque_limit=1.0)})
    problem = hop(
        robot=driven,
        terms=(*hop().terms, terms.DriveLimits(), PowerCost(weight=1.0), BaseForceCost(weight=1.0)),
    )
    found = {type(term).__name__ for term in torque_terms(problem)}
    assert found == {"TorqueCost", "TorqueLimits", "DriveLimits", "PowerCost"}


def test_stage_one_keeps_all_other_terms_and_puts_a_wrench_cost_for_the_torque_cost() -> None:
    problem = hop()
    one = base_rows_problem(problem)
    dropped = [type(term) for term in problem.terms if term not in one.terms]
    added = [term for term in one.terms if term not in problem.terms]
    assert dropped == [terms.TorqueCost, terms.TorqueLimits]
    assert added == [terms.WrenchCost(weight=standing_share(problem.robot))]
    assert base_rows_problem(problem, replacement=()).terms == tuple(
        term for term in problem.terms if type(term) not in dropped
    )


def test_replacement_costs_as_much_as_the_torques_of_standing_still() -> None:
    robot = problems.load("solo12-jump").robot
    model, data, q = robot.model, robot.model.createData(), robot.reference
    # Four feet in a rectangle under the CoM, near enough: each carries a quarter, up to what the CoM is off.
    pin.framesForwardKinematics(model, data, q)
    external = pin.StdVec_Force([pin.Force.Zero() for _ in range(model.njoints)])
    for contact in robot.contacts:
        frame = model.frames[model.getFrameId(contact.frame)]
        upright = pin.SE3(data.oMf[model.getFrameId(contact.frame)].rotation.T, np.zeros(3))
        quarter = pin.Force(np.array([0.0, 0.0, robot.weight / 4]), np.zeros(3))
        external[frame.parentJoint] = frame.placement.act(upright.act(quarter))
    still = np.zeros(robot.nv)
    torque = pin.rnea(model, data, q, still, still, external)[6:] / (robot.weight * robot.length)
    assert np.mean(torque**2) / (1 / 4**2 / 3) == pytest.approx(standing_share(robot), rel=0.02)


def test_a_problem_without_other_costs_on_motion_gets_one() -> None:
    one = base_rows_problem(reach(terms=(terms.TorqueCost(weight=2.0),)))
    assert any(isinstance(term, terms.AccelerationCost) and term.weight > 0 for term in one.terms)


@pytest.mark.long
def test_compiled_graph_of_stage_one_has_no_actuated_rows() -> None:
    problem = hop()
    full, one = (largest_point(p) for p in (problem, base_rows_problem(problem)))
    actuated = problem.robot.nu
    assert one.layers[-1].numel_out(0) == full.layers[-1].numel_out(0) - actuated
    sizes = [
        [getattr(Derivatives(point), name).n_instructions() for name in ("first", "second")]
        for point in (full, one)
    ]
    assert all(small < 0.95 * large for large, small in zip(*sizes, strict=True))


def test_recovered_torques_reproduce_the_motion_in_forward_dynamics() -> None:
    solution = trajopt.solve(base_rows_problem(hop()), fixed_mesh=True)
    assert solution.converged
    torque, report = recover_torques(hop(), solution)
    assert report.base_residual < 1e-5  # what a solver leaves at 1e-6 in natural units
    model, robot = solution.model, hop().robot
    data, frame = model.createData(), model.getFrameId(FOOT)
    for row in np.flatnonzero(solution.collocation)[::3]:
        q, v = solution.q[row], solution.v[row]
        force = pin.Force(solution.f[row, 0, :3], solution.f[row, 0, 3:])
        pin.framesForwardKinematics(model, data, q)
        in_world_axes = pin.SE3(data.oMf[frame].rotation.T, np.zeros(3))
        external = pin.StdVec_Force([pin.Force.Zero() for _ in range(model.njoints)])
        joint = model.frames[frame].parentJoint
        external[joint] = model.frames[frame].placement.act(in_world_axes.act(force))
        tau = np.concatenate([np.zeros(robot.n_unactuated), torque[row]])
        acceleration = pin.aba(model, data, q, v, tau, external)
        assert_allclose(acceleration, solution.a[row], atol=1e-4 * np.abs(solution.a).max())


def test_report_names_joint_time_phase_and_amount_of_the_worst_torque() -> None:
    problem, solution = guessed()
    torque, _ = recover_torques(problem, solution)
    points = np.flatnonzero(solution.collocation)
    at, joint = np.unravel_index(np.argmax(np.abs(torque[points])), (len(points), 12))
    peak, limit = abs(torque[points[at], joint]), 0.8 * abs(torque[points[at], joint])
    limited, _ = guessed(torque_limit=float(limit))
    _, report = recover_torques(limited, solution)
    worst = report.worst
    assert worst.excess == pytest.approx(peak / limit - 1, rel=1e-9)
    assert worst.joint == problem.robot.model.names[int(2 + joint)]
    assert worst.time == solution.t[points[at]]
    assert worst.phase == ("stance", "flight", "landing")[solution.phase[points[at]]]
    assert not report.within_limits
    expected = np.mean(np.abs(torque[points, joint]) > limit)
    assert report.joints[joint].share_beyond == pytest.approx(expected)
    assert worst.joint in str(report)


def test_bounds_of_drives_are_their_envelope_with_friction() -> None:
    drive = Drive(
        gear_ratio=6.0, torque_limit=0.4, stall_torque=0.5, no_load_speed=60.0,
        viscous_friction=0.02, coulomb_friction=0.05,
    )  # fmt: skip
    problem = hop(robot=hopper().with_drives({"hip": drive}))
    v = np.zeros((7, problem.robot.nv))
    v[:, 6] = np.linspace(-9.0, 9.0, 7)
    bounds = torque_bounds(problem, v)
    for side in (bounds.lower, bounds.upper):
        delivered = side[:, 0] + drive.friction_torque(v[:, 6])
        assert_allclose(drive.envelope_margin(delivered, v[:, 6]), 0.0, atol=ROUNDING)
    assert_allclose(bounds.upper[:, 1], problem.robot.torque_limit[1])


def test_redistribution_keeps_motion_base_rows_and_friction_and_lowers_torques_everywhere() -> None:
    problem, solution = guessed()
    shared = redistribute_wrenches(problem, solution)
    points = solution.collocation
    before, after = (
        sample_quantities(solution).generalized_force[points],
        sample_quantities(shared).generalized_force[points],
    )
    assert_allclose(after[:, :6], before[:, :6], atol=ROUNDING * problem.robot.weight)
    assert_allclose(shared.tau[points], after[:, 6:], atol=ROUNDING)
    assert (np.sum(after[:, 6:] ** 2, axis=1) <= np.sum(before[:, 6:] ** 2, axis=1) + ROUNDING).all()
    assert np.mean(shared.tau[points] ** 2) < 0.95 * np.mean(solution.tau[points] ** 2)
    assert np.array_equal(shared.q, solution.q)
    f, g = (s.f[points][s.active[points]] for s in (solution, shared))
    pyramid = problem.terrain.friction / np.sqrt(2)
    was, now = (pyramid * w[:, 2] - np.abs(w[:, :2]).max(axis=1) for w in (f, g))
    assert now.min() > min(was.min(), 0.0) - 1e-6 * problem.robot.weight


def test_redistribution_with_inactive_friction_is_least_squares_over_internal_forces() -> None:
    problem, solution = guessed()
    kept = tuple(term for term in problem.terms if not isinstance(term, terms.FrictionPyramid))
    shared = redistribute_wrenches(replace(problem, terms=kept), solution)
    robot = problem.robot
    for row in np.flatnonzero(solution.collocation & (solution.phase == 0))[::5]:
        frames = [(contact.frame, 3) for contact in robot.contacts]
        jacobian = contact_jacobian(robot.model, solution.q[row], frames)
        _, singular, vt = np.linalg.svd(jacobian[:, :6].T)
        internal = vt[len(singular) :].T
        levers = -jacobian[:, 6:].T @ internal
        torque = solution.tau[row]
        best = torque - levers @ np.linalg.lstsq(levers, torque, rcond=None)[0]
        assert_allclose(shared.tau[row], best, atol=1e-3 * np.abs(torque).max())


def test_largest_excess_after_redistribution_is_the_least_that_a_linear_program_finds() -> None:
    limit = 1.0
    problem, solution = guessed(torque_limit=limit)
    shared = redistribute_wrenches(problem, solution)
    robot, mu = problem.robot, problem.terrain.friction / np.sqrt(2)
    rows = np.flatnonzero(solution.collocation & solution.active.any(axis=1))
    excess = np.abs(solution.tau[rows]).max(axis=1) / limit - 1
    tested = rows[np.argsort(excess)[-4:]]
    assert excess.max() > 0
    for row in tested:
        frames = [(contact.frame, 3) for contact in robot.contacts]
        jacobian = contact_jacobian(robot.model, solution.q[row], frames)
        w = solution.f[row, :, :3].ravel()
        friction = np.kron(np.eye(4), [[0, 0, -1], [1, 0, -mu], [-1, 0, -mu], [0, 1, -mu], [0, -1, -mu]])
        reach_of_guess = np.maximum(friction @ w, 0.0)  # the guess may be outside: it may stay so
        bound_of_torque = np.vstack([-jacobian[:, 6:].T, jacobian[:, 6:].T])
        tau = solution.tau[row] + jacobian[:, 6:].T @ w
        found = linprog(
            np.append(np.zeros(12), 1.0),
            A_ub=np.block([[bound_of_torque, -limit * np.ones((24, 1))], [friction, np.zeros((20, 1))]]),
            b_ub=np.concatenate([limit - tau, limit + tau, reach_of_guess]),
            A_eq=np.column_stack([jacobian[:, :6].T, np.zeros(6)]),
            b_eq=jacobian[:, :6].T @ w,
            bounds=[(None, None)] * 12 + [(0, None)],
        )
        assert found.success
        after = max(0.0, np.abs(shared.tau[row]).max() / limit - 1)
        assert after == pytest.approx(found.x[-1], abs=OPTIMAL)


def test_the_smooth_friction_cone_is_respected_too() -> None:
    problem, solution = guessed()
    coned = tuple(
        terms.FrictionCone() if isinstance(term, terms.FrictionPyramid) else term for term in problem.terms
    )
    shared = redistribute_wrenches(replace(problem, terms=coned), solution)
    points, mu, weight = solution.collocation, problem.terrain.friction, problem.robot.weight
    was, now = (
        (mu * s.f[points][:, :, 2] - np.linalg.norm(s.f[points][:, :, :2], axis=2)).min()
        for s in (solution, shared)
    )
    assert now > min(was, 0.0) - 1e-6 * weight
    assert shared.statistics.more["redistributed"]["points"] > 0


@pytest.mark.long
def test_soles_and_a_hand_on_a_wall_keep_pressure_inside_and_friction() -> None:
    problem = problems.load("talos-wall")
    transcription = transcribe(problem, "legendre:2", 12)
    solution = extract(transcription, initial_guess(transcription))
    shared = redistribute_wrenches(problem, solution)
    robot, wall = problem.robot, problem.schedule.phases[-1].surfaces["hand"]
    worst = {}
    for name, plan in (("before", solution), ("after", shared)):
        samples, beyond = sample_quantities(plan), []
        for row in np.flatnonzero(plan.collocation):
            for i, contact in enumerate(robot.contacts):
                axes = samples.rotation[row, i] if contact.kind == "surface" else wall.frame
                force, moment = axes.T @ plan.f[row, i, :3], axes.T @ plan.f[row, i, 3:]
                friction = problem.terrain.friction if contact.kind == "surface" else wall.friction
                beyond.append(np.linalg.norm(force[:2]) - friction * force[2])
                beyond.append(abs(moment[0]) - contact.half_width * force[2])
                beyond.append(abs(moment[1]) - contact.half_length * force[2])
        worst[name] = max(beyond)
    assert worst["after"] <= max(worst["before"], 0.0) + 1e-6 * robot.weight
    assert np.mean(shared.tau[shared.collocation] ** 2) < 0.9 * np.mean(
        solution.tau[solution.collocation] ** 2
    )


def test_one_point_foot_and_flight_have_nothing_to_share() -> None:
    transcription = transcribe(hop(), "legendre:1", 8)
    solution = extract(transcription, initial_guess(transcription))
    shared = redistribute_wrenches(hop(), solution)
    assert shared.statistics.more["redistributed"]["points"] == 0
    assert_allclose(shared.f, solution.f, atol=ROUNDING)


def test_foreign_solutions_and_problems_without_torques_are_refused() -> None:
    _, solution = guessed()
    with pytest.raises(InputError, match="velocities"):
        recover_torques(hop(), solution)
    with pytest.raises(InputError, match="redistributed"):
        redistribute_wrenches(hop(), solution)
    free = hop(
        actuation="acceleration", terms=(terms.AccelerationCost(weight=1.0), terms.PostureCost(weight=1.0))
    )
    with pytest.raises(InputError, match="actuation"):
        base_rows_problem(free)


@pytest.mark.slow
def test_stage_one_costs_more_than_the_full_jump_and_sharing_anew_brings_it_nearer() -> None:
    problem = problems.load("solo12-jump", torque_limit=2.2)
    settings = {"intervals": 30}
    full = trajopt.solve(problem, **settings, fixed_mesh=True)
    motion = trajopt.solve(base_rows_problem(problem), **settings, fixed_mesh=True)
    assert full.converged
    assert motion.converged
    assert motion.statistics.iterations <= MOST_ITERATIONS
    shared = redistribute_wrenches(problem, motion)
    # Both Gauss points of an interval weigh the same.
    weights = np.repeat(np.diff(full.interval_t, axis=1).ravel() / 2, 2)
    costs = [float(weights @ np.mean(s.tau[s.collocation] ** 2, axis=1)) for s in (full, shared, motion)]
    assert costs[0] < costs[1] < costs[2]
    excess = [recover_torques(problem, s)[1].worst.excess for s in (full, shared, motion)]
    assert excess[0] < 1e-6
    assert excess[1] < excess[2]
    # Nothing but what sharing cannot mend is wrong, and the check sees that too.
    assert trajopt.check(shared).failures(AT_POINTS) == ("effort_excess",) * (excess[1] > 1e-6)


def test_prepared_sizes_are_those_of_the_full_problem_because_torques_are_no_unknowns() -> None:
    problem = hop()
    full, one = (prepare(p) for p in (problem, base_rows_problem(problem)))
    assert one.transcription.layout.n_unknowns == full.transcription.layout.n_unknowns
    assert one.transcription.n_rows == full.transcription.n_rows - 2 * problem.robot.nu * 8
