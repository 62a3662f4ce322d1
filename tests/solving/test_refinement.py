"""Refinement: the model of the error, the mesh it asks for, and what is reached, measured independently."""

import math
import time
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.problems import REACH, REACH_TIME, hop, one_joint_arm, reach
from trajopt import Contact, InputError, Phase, Problem, Schedule, check
from trajopt.certify.accuracy import measure
from trajopt.certify.report import GRADE
from trajopt.collision import BoxObstacle
from trajopt.collision.shapes import SphereObstacle
from trajopt.motion.grid import mesh_of
from trajopt.robot import Payload, Units, frame_pose, inverse_kinematics
from trajopt.solving import refinement, solve_graded
from trajopt.solving.exchange import Exchange
from trajopt.solving.graded import FIRST_SCHEME, tolerance_for
from trajopt.solving.refinement import CALM_SCHEME, PATIENCE, USUAL_SCHEME, Refinement, _balanced
from trajopt.solving.remeshing import MOST_PARTS, PhaseErrors, remeshed
from trajopt.solving.rounds import phase_errors
from trajopt.solving.solving import solve
from trajopt.terms import (
    AccelerationCost,
    Clearance,
    FramePose,
    PositionLimits,
    PostureCost,
    TerminalRest,
    TimeCost,
    TorqueLimits,
    VelocityLimits,
)
from trajopt.transcription.mesh import Mesh, PhaseMesh
from trajopt.transcription.schemes import scheme
from trajopt.transcription.transcription import chosen_mesh
from trajopt_library import problems
from trajopt_library.robots.ur5 import TOOL

pytestmark = pytest.mark.long

# Unknowns per node and per point of the made-up phases.
SIZES = (10, 8)
# Of sums of widths.
ROUNDING = 1e-9
# Largest variation of a least-time torque, limits a second, and the share of time that degree one may cost.
CALM_RATE, LOST_TIME = 15.0, 5e-3
# Least time of the UR5's carry at the degrees two to four, s, where a torque turns 302 times. To pass ball
# and box with its body it switches eight times.
CALM_TURNS = 20
CARRY_TIME = 0.5433
# Part of a uniform mesh's variables that refinement needs at most.
FEWER = 0.6


def quadrature_error(name, h, rate):
    """Error of a scheme's quadrature of exp(rate t) over [0, h]."""
    method = scheme(name)
    return abs(h * method.b1 @ np.exp(rate * h * method.c) - np.expm1(rate * h) / rate)


@pytest.mark.parametrize(
    "name", [f"{kind}:{degree}" for kind in ("legendre", "radau") for degree in (1, 2, 3)]
)
def test_error_constant_is_that_of_the_quadrature(name):
    h, rate = 0.5, 1.0
    expected = scheme(name).error_constant * h ** (scheme(name).order + 1)
    # The derivative of exp is between 1 and exp(h) in the interval.
    assert expected <= quadrature_error(name, h, rate) * (1 + 1e-3)
    assert quadrature_error(name, h, rate) <= expected * np.exp(rate * h) * (1 + 1e-3)


def carried_past_bodies() -> Problem:
    """A UR5 carries 3 kg past a box and a ball, within four fifths of its torques."""
    loaded = trajopt.robot("ur5")
    robot = replace(loaded, contacts=(Contact(frame=TOOL, name="tool"),))
    turned = frame_pose(robot, robot.reference, TOOL).rotation
    places = [
        pin.SE3(pin.rpy.rpyToMatrix(0, 0, a) @ turned, np.array([0.55 * np.cos(a), 0.55 * np.sin(a), 0.35]))
        for a in (-0.8, 0.8)
    ]
    near = np.array([-0.8, *robot.reference[1:]])
    start = inverse_kinematics(robot, near, {TOOL: places[0]}).q
    box = BoxObstacle(name="box", sides=[0.2, 0.1, 0.4], position=[0.6, -0.15, 0.2])
    ball = SphereObstacle(name="ball", centre=[0.55, 0.25, 0.4], radius=0.1)
    body = Payload(contact="tool", mass=3.0, centre=np.array([0, 0, 0.05]), inertia=np.eye(3) * 0.005)
    return Problem(
        name="ur5-carry",
        robot=robot,
        schedule=Schedule((Phase(name="carry", duration=1.2, duration_bounds=(0.1, 5.0)),)),
        initial_q=start,
        payloads={"carry": body},
        terms=(
            *(TimeCost(weight=1.0), AccelerationCost(weight=1e-4)),
            *(TorqueLimits(limit=0.8 * robot.torque_limit), VelocityLimits(), PositionLimits()),
            Clearance(obstacles=(box, ball), margin=0.02),
            FramePose(frame=TOOL, position=places[1].translation, rotation=places[1].rotation),
            TerminalRest(),
        ),
    )


def modelled(name, widths, rate):
    """Local errors of the quadrature on intervals of these widths."""
    return np.array([quadrature_error(name, width, rate) for width in widths])


@pytest.mark.parametrize("name", ["legendre:2", "radau:2", "legendre:1"])
def test_mesh_that_is_asked_for_meets_the_target_where_the_model_holds(name):
    mesh, rate, length = PhaseMesh.uniform(name, 3), 6.0, 1.0
    local = modelled(name, mesh.widths, rate)
    target = local.sum() / 6
    errors = PhaseErrors(local=local, phase=float(local.sum()) / target, unknowns=SIZES)
    (made,) = remeshed(Mesh(phases=(mesh,)), [errors], np.zeros(3), length, raise_degree=False).phases
    assert made.scheme == name
    assert modelled(name, made.widths, rate).sum() <= target


def test_phases_within_the_target_stay_as_they_are():
    mesh = Mesh.uniform("legendre:2", [4, 4])
    good = PhaseErrors(local=np.full(4, 1e-9), phase=1e-2, unknowns=SIZES)
    bad = PhaseErrors(local=np.full(4, 1e-4), phase=1e3, unknowns=SIZES)
    made = remeshed(mesh, [good, bad], np.zeros(8), 1.0)
    assert made.phases[0] == mesh.phases[0]
    assert made.phases[1] != mesh.phases[1]


def test_intervals_with_more_error_are_cut_into_more_parts():
    mesh, local = Mesh.uniform("legendre:2", [4]), np.array([1e-4, 1e-9, 1e-9, 1e-6])
    errors = PhaseErrors(local=local, phase=50.0, unknowns=SIZES)
    (made,) = remeshed(mesh, [errors], np.zeros(4), 1.0, raise_degree=False).phases
    edges = np.array(made.fractions)
    inside = [
        int(np.sum((edges > low + 1e-12) & (edges <= low + 0.25 + 1e-12))) for low in (0, 0.25, 0.5, 0.75)
    ]
    assert inside[0] > inside[3] >= inside[1] == inside[2] == 1


def test_broken_intervals_are_split_also_in_phases_that_are_remeshed():
    mesh, broken = Mesh.uniform("legendre:4", [3]), np.array([0.0, 0.0, 2.0])
    errors = PhaseErrors(local=np.array([1e-4, 1e-12, 1e-12]), phase=2.0, unknowns=SIZES)
    (alone,) = remeshed(mesh, [errors], np.zeros(3), 1.0, raise_degree=False).phases
    (made,) = remeshed(mesh, [errors], broken, 1.0, raise_degree=False).phases
    assert made.count == alone.count + 1
    assert np.sum(np.array(made.fractions) > 2 / 3 + ROUNDING) == 2


def test_around_what_a_phase_misses_round_after_round_neighbours_are_split():
    loop = Refinement(hop(), GRADE, True, {}, Exchange(hop()), None)
    mesh, good = (
        Mesh.uniform("legendre:4", [2, 5, 2]),
        PhaseErrors(local=np.zeros(2), phase=0.5, unknowns=SIZES),
    )
    errors, broken = [good, replace(good, phase=3.0), good], np.zeros(9)
    broken[3] = 2.0
    for number in range(PATIENCE + 1):
        found = loop._pressed(mesh, errors, broken)
        assert (found[[2, 4]] > 1).all() == (number == PATIENCE)
    assert found[3] == 2.0
    assert not found[[0, 1, 5, 6, 7, 8]].any()
    assert not loop._pressed(mesh, [good] * 3, np.zeros(9)).any()


def test_intervals_beside_split_ones_do_not_stay_much_wider():
    widths = np.array([0.4, 0.4, 0.1, 0.05, 0.05])
    found = _balanced(widths, np.array([0.0, 0.0, 0.0, 0.0, 9.0]))
    assert (found > 1).tolist() == [False, True, True, True, True]
    assert found[4] == 9.0
    assert not _balanced(widths, np.zeros(5)).any()


def test_error_all_over_a_phase_raises_its_degree():
    mesh = Mesh.uniform("legendre:2", [6])
    errors = PhaseErrors(local=np.full(6, 1e-4), phase=1e3, unknowns=SIZES)
    (made,) = remeshed(mesh, [errors], np.zeros(6), 1.0).phases
    assert made.scheme == "legendre:3"


@pytest.mark.parametrize("name", ["trapezoidal", "hermite-simpson", "semi-implicit-euler", "legendre:4"])
def test_schemes_without_a_next_degree_are_split(name):
    errors = PhaseErrors(local=np.full(5, 1e-3), phase=50.0, unknowns=SIZES)
    (made,) = remeshed(Mesh.uniform(name, [5]), [errors], np.zeros(5), 1.0).phases
    assert made.scheme == name
    assert made.count > 5


@pytest.mark.parametrize(
    ("local", "phase", "least"),
    [([np.inf, 1e-3], np.inf, 3), ([0.0, 0.0, 0.0], 1e3, 0)],
    ids=["a phase that ran away", "errors of rounding"],
)
def test_no_mesh_is_without_end(local, phase, least):
    count = len(local)
    errors = PhaseErrors(local=np.array(local), phase=phase, unknowns=SIZES)
    (made,) = remeshed(Mesh.uniform("legendre:4", [count]), [errors], np.zeros(count), 1.0).phases
    assert least <= made.count <= count * MOST_PARTS


def test_refined_motion_is_as_accurate_as_measured_anew_from_its_file(tmp_path):
    target = 1e-4
    found = solve_graded(hop(), accuracy=target, mesh=Mesh.uniform("legendre:2", (3, 3, 3)))
    assert found.reached
    assert found.solution.success
    again = measure(found.solution.save(tmp_path / "hop.npz"))
    assert max(phase_errors(again)) <= target
    assert again.open_loop <= target
    assert found.solution.statistics.graded.reached is True
    assert found.solution.statistics.graded.target_m == target
    assert found.solution.statistics.graded.error_m == pytest.approx(found.error)
    assert len(found.rounds) > 1


def test_refinement_needs_fewer_variables_than_a_uniform_mesh_for_the_same_error():
    problem = problems.load("hopper-hop")
    uniform = solve(problem)
    error = max(phase_errors(measure(uniform)))
    found = solve_graded(problem, accuracy=error)
    assert found.reached
    assert found.solution.statistics.variables <= FEWER * uniform.statistics.variables


def test_mesh_that_meets_the_target_is_left_alone():
    mesh = Mesh.uniform("legendre:4", [10])
    found = solve_graded(reach(), accuracy=1e-3, mesh=mesh)
    assert found.reached
    assert len(found.rounds) == 1
    assert found.rounds[0].mesh == mesh


def test_solution_at_hand_is_measured_and_its_own_mesh_refined():
    coarse = solve(hop(), intervals=6)
    found = solve_graded(hop(), accuracy=1e-4, first=coarse)
    assert found.reached
    assert found.rounds[0].mesh == mesh_of(coarse)
    assert found.rounds[0].errors == phase_errors(measure(coarse))
    enough = solve_graded(hop(), accuracy=10 * found.error, first=found.solution)
    assert len(enough.rounds) == 1
    failed = solve(hop(), intervals=6, max_iterations=1)
    assert not solve_graded(hop(), first=failed).reached


def test_target_below_rounding_is_not_reached_and_says_why():
    found = solve_graded(reach(), accuracy=1e-300, max_rounds=2)
    assert not found.reached
    assert found.why == "2 rounds were not enough"
    assert found.solution.success  # the grade is: only the accuracy is not
    assert found.to_dict()["reached"] is False


def test_limit_of_unknowns_stops_with_the_best_solution(monkeypatch):
    monkeypatch.setattr(refinement, "MOST_VARIABLES", 300)
    found = solve_graded(hop(), accuracy=1e-8)
    assert not found.reached
    assert "more than 300 variables" in found.why
    assert found.solution.converged


def test_problem_without_a_solution_is_told_as_such():
    found = solve_graded(hop(), accuracy=1e-3, max_iterations=1)
    assert not found.reached
    assert not found.solution.success
    assert found.why == "a mesh was not solved: iteration limit"
    assert found.to_dict()["error_m"] is None


def test_torques_that_ring_along_rate_limits_are_solved_at_degree_one():
    given = problems.load("arm-transfer", robot="panda", goal="time")
    rings = replace(given, default_transcription=USUAL_SCHEME, default_intervals=30)
    found = solve_graded(rings)
    first, last = found.rounds[0].mesh, found.solution
    assert first.transcription == FIRST_SCHEME
    assert last.success
    assert last.statistics.transcription == CALM_SCHEME
    rough = check(solve(rings, mesh=Mesh.uniform(FIRST_SCHEME, (20,)), judge=False))
    assert rough.chatter
    assert found.report.chatter == ""
    assert found.report.torque_variation < CALM_RATE * last.t[-1] < rough.torque_variation
    assert last.t[-1] == pytest.approx(rough.phases[-1].end, rel=LOST_TIME)
    # A degree that is named is kept, and so is one that a requested accuracy needs.
    named = replace(rings, default_transcription="legendre:3", default_intervals=20)
    for kept in (solve_graded(named, max_rounds=2), solve_graded(rings, accuracy=1e-3, max_rounds=2)):
        assert CALM_SCHEME not in kept.rounds[-1].mesh.transcription


@pytest.mark.slow
def test_a_body_carried_in_least_time_past_others_does_not_chatter():
    found = solve_graded(carried_past_bodies())
    assert found.report.ok
    assert not found.report.chatter
    assert found.report.torque_reversals < CALM_TURNS
    assert found.solution.t[-1] == pytest.approx(CARRY_TIME, rel=LOST_TIME)


def test_budget_ends_the_rounds_with_the_best_motion():
    found = solve_graded(hop(), accuracy=1e-9, max_time=1e-6, mesh=Mesh.uniform("legendre:1", (3, 3, 3)))
    assert len(found.rounds) <= 2
    assert {own.status for own in found.rounds} == {"time_limit"}
    first = solve(hop(), intervals=6)
    kept = solve_graded(hop(), first=first, accuracy=1e-9, max_time=first.statistics.wall_time_s)
    assert kept.why == "the time is used"
    assert len(kept.rounds) == 1
    assert kept.solution.converged


def test_solve_that_takes_long_on_a_finer_mesh_is_begun_anew_and_taken_up_where_that_fails(monkeypatch):
    mesh = Mesh.uniform("legendre:1", (3, 3, 3))
    expected = solve_graded(hop(), mesh=mesh, accuracy=1e-3)
    assert len(expected.rounds) > 1
    monkeypatch.setattr(refinement, "GIVE_UP", 0)
    monkeypatch.setattr(refinement, "GIVE_UP_LEAST", 1.0)
    found = solve_graded(hop(), mesh=mesh, accuracy=1e-3)
    statuses = [own.status for own in found.rounds]
    # From the motion, from it again but farther from its bounds, from the guess; then taken up.
    assert statuses[:5] == ["solved", *3 * ["iteration_limit"], "solved"]
    assert [own.iterations for own in found.rounds[1:4]] == [1, 1, 1]
    assert found.reached
    assert found.solution.statistics.objective == expected.solution.statistics.objective


def test_rounds_that_stay_far_from_the_grade_are_begun_anew_on_the_own_mesh(monkeypatch):
    mesh, own = Mesh.uniform("legendre:1", (3, 3, 3)), chosen_mesh(hop())
    usual = solve_graded(hop(), mesh=mesh, accuracy=1e-3)
    assert own not in [each.mesh for each in usual.rounds]
    monkeypatch.setattr(refinement, "FAR_ROUNDS", 1)
    monkeypatch.setattr(refinement, "FAR_RATIO", 0.0)
    found = solve_graded(hop(), mesh=mesh, accuracy=1e-3)
    assert found.reached
    assert [each.mesh for each in found.rounds[:2]] == [mesh, own]
    assert own not in [each.mesh for each in solve_graded(hop(), mesh=mesh, refine=False).rounds]


def test_a_first_mesh_that_takes_long_is_left_and_taken_up_again(monkeypatch):
    monkeypatch.setattr(refinement, "MOST_FIRST", 2)
    found = solve_graded(hop())
    assert [each.status for each in found.rounds[:2]] == ["iteration_limit", "solved"]
    assert found.rounds[0].iterations == 2
    assert found.reached


def test_limit_of_time_bounds_the_guess_and_the_checks(monkeypatch):
    made, calls = hop(), []

    def slow(t):
        calls.append(t)
        clock.append(1.0)
        return made.guess(t)

    clock: list[float] = []
    real = time.perf_counter
    monkeypatch.setattr(time, "perf_counter", lambda: real() + sum(clock))
    problem = replace(made, guess=slow)
    calls.clear()
    clock.clear()
    found = solve_graded(problem, max_time=10.0)
    assert {own.status for own in found.rounds} == {"time_limit"}
    assert not found.reached
    within = len(calls)
    clock.clear()
    assert solve_graded(problem, max_time=10.0, solver_time=True).reached
    assert len(calls) > 2 * within


@pytest.mark.parametrize("kind", ["torque_limit", "velocity_limit", "position_upper"])
def test_limits_that_seem_out_of_reach_get_rows_where_a_motion_exceeds_one(kind):
    limit = (
        1.05
        * {
            "torque_limit": Units(one_joint_arm()).unreachable_torque,
            "velocity_limit": Units(one_joint_arm()).unreachable_velocity,
            "position_upper": 2 * np.pi,
        }[kind]
    )
    # A cubic from rest to rest has 1.5 times its mean rate at most, and six times its way over T^2 in
    # acceleration: both are a tenth beyond the limit.
    inertia = pin.crba(one_joint_arm().model, one_joint_arm().model.createData(), np.zeros(1)).item()
    duration = {
        "torque_limit": math.sqrt(6 * inertia * REACH / (1.1 * limit)),
        "velocity_limit": 1.5 * REACH / (1.1 * limit),
        "position_upper": REACH_TIME,
    }[kind]
    pull = (PostureCost(weight=1e3, q=np.array([1.1 * limit])),) if kind == "position_upper" else ()
    limits = (TorqueLimits(), VelocityLimits(), PositionLimits())
    robot = replace(one_joint_arm(), **{kind: np.array([limit])})
    free = reach(terms=(AccelerationCost(weight=1.0), *pull, *limits))
    schedule = Schedule((Phase(name="reach", duration=duration),))
    problem = replace(free, robot=robot, schedule=schedule, guess=free.guess)
    found = solve_graded(problem, mesh=Mesh.uniform("legendre:3", (12,)))
    assert found.reached
    assert found.rounds[0].mesh == found.rounds[1].mesh  # a finer one would not mend it
    values = {"torque_limit": found.solution.tau, "velocity_limit": found.solution.v}
    assert np.abs(values.get(kind, found.solution.q)).max() == pytest.approx(limit, rel=1e-3)


@pytest.mark.parametrize("target", [0.0, -1e-3, float("nan"), float("inf"), "1e-3"])
def test_targets_that_are_no_length_are_refused(target):
    with pytest.raises(InputError, match=r"accuracy is .* m; allowed: finite and > 0"):
        solve_graded(reach(), accuracy=target)


def test_tolerance_follows_the_target_within_what_solvers_reach():
    assert_allclose(tolerance_for(1.0, 0.2), 1e-6)
    assert_allclose(tolerance_for(1e-4, 1.0), 1e-7)
    assert_allclose(tolerance_for(1e-12, 1.0), 1e-10)
