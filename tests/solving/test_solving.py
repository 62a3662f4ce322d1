"""Solving in one call, from unknowns to samples, and references that two meshes agree on."""

import json
import re
import sys
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import trajopt
from tests.support.command_lines import invoke
from tests.support.problems import (
    FOOT,
    REACH,
    REACH_TIME,
    SCHEME_ORDERS,
    hop,
    hopper,
    lean,
    one_joint_arm,
    one_phase,
    planar_hopper,
    reach,
)
from tests.support.refusals import refused_calls
from trajopt import InputError, Problem, Robot, Solution, end_of, middle_of, terms
from trajopt.certify.accuracy import measure
from trajopt.motion.samples import sample_quantities
from trajopt.robot import Units
from trajopt.solvers.drivers import SOLVERS
from trajopt.solvers.status import Status
from trajopt.solving import converged_reference
from trajopt.solving.extraction import extract
from trajopt.solving.reference import Agreement, NoReferenceError, in_other_optimum
from trajopt.solving.solving import prepare, solve
from trajopt.transcription import transcribe
from trajopt.transcription.guess import initial_guess
from trajopt.transcription.schemes import scheme

# The solver's tolerance on a problem of order one.
SOLVED = 1e-7
# Error constant C of C h^order, h the fraction of the motion's duration; measured up to 0.9.
CONSTANT = 2.0
# The same against gravity, with a swing about three times faster than the motion.
SWINGS = 3


def minimum_acceleration(t: np.ndarray) -> np.ndarray:
    """Rest to rest in REACH_TIME with the least integral of the squared acceleration: a cubic."""
    s = t / REACH_TIME
    return REACH * s**2 * (3 - 2 * s)


@pytest.mark.long
@pytest.mark.parametrize(("name", "order"), SCHEME_ORDERS.items())
@pytest.mark.parametrize("solver", SOLVERS)
def test_minimum_acceleration_motion_is_the_known_cubic(name, order, solver):
    intervals = 20
    solution = solve(reach(), transcription=name, intervals=intervals, solver=solver)
    assert solution.converged
    allowed = CONSTANT / intervals**order + SOLVED
    assert_allclose(solution.q[:, 0], minimum_acceleration(solution.t), atol=allowed)
    units = Units(one_joint_arm())
    exact = 12 * REACH**2 / REACH_TIME**3 / units.acceleration[0] ** 2 / units.time
    assert solution.statistics.objective == pytest.approx(exact, rel=allowed)


def swing(**options: object) -> float:
    """Least squared torque against gravity: nonlinear, with no closed form."""
    costs = (terms.TorqueCost(weight=1.0), terms.VelocityCost(weight=0.1))
    solution = solve(reach(gravity=True, terms=costs), tolerance=1e-9, **options)
    assert solution.converged
    return solution.statistics.objective


@pytest.mark.long
@pytest.mark.parametrize(("name", "order"), SCHEME_ORDERS.items())
def test_every_transcription_ends_at_one_optimum(name, order):
    intervals = 16
    reference = swing(transcription="legendre:4", intervals=12)
    error = swing(transcription=name, intervals=intervals) / reference - 1
    assert abs(error) < CONSTANT * (SWINGS / intervals) ** order + SOLVED


def test_not_converging_is_a_status_with_advice_and_no_exception():
    solution = solve(hop(), transcription="legendre:1", max_iterations=1)
    assert not solution.success
    assert solution.statistics.status == "iteration_limit"
    assert "max_iterations" in solution.statistics.advice
    assert [set(block) for block in solution.statistics.worst_blocks] == [
        {"block", "phase", "node", "point", "time", "violation"}
    ] * 3
    assert solution.statistics.max_violation > 1e-3


@pytest.mark.parametrize("solver", SOLVERS)
def test_goal_beyond_the_torque_limit_is_not_a_success(solver):
    weak = reach(terms=(terms.AccelerationCost(weight=1.0), terms.TorqueLimits(limit=np.array([0.05]))))
    solution = solve(weak, transcription="legendre:2", solver=solver, max_iterations=200)
    assert not solution.success
    assert solution.statistics.status in ("infeasible", "step_failed", "iteration_limit")
    assert solution.statistics.max_violation > 1e-3


def broken_after(problem: Problem, time: float) -> Problem:
    def motion(t: float) -> np.ndarray:
        return problem.guess(t) if t < time else np.full(problem.robot.nq, np.nan)

    return replace(problem, guess=motion)


def test_guess_that_is_not_finite_is_refused_with_its_time():
    problem = broken_after(reach(gravity=True, terms=(terms.TorqueCost(weight=1.0),)), 0.41)
    with pytest.raises(InputError, match=r"guess of problem 'reach' at t = 0\.4\d+ s is not finite"):
        solve(problem, transcription="legendre:1", intervals=8)


def test_function_that_is_not_finite_is_a_status_that_names_the_place():
    """The error of a rotation has a pole at half a turn: here the guess ends there, to the last digit."""
    turned = hop().robot.reference.copy()
    turned[3:7] = [0.0, 0.0, 1.0, 0.0]
    problem = hop(terms=(terms.TorqueCost(weight=1.0), terms.TerminalState(q=turned)))
    solution = solve(problem, transcription="legendre:1")
    assert solution.statistics.status == "not_finite"
    assert solution.statistics.advice.splitlines()[::2] == Status.NOT_FINITE.explain().splitlines()
    where = solution.statistics.advice.splitlines()[1]
    assert where.endswith("rows of block 'terminal_state' in phase 'landing', node 8")
    assert solution.statistics.iterations == 0
    assert solution.statistics.worst_blocks[0]["block"] == "terminal_state"
    assert solution.statistics.worst_blocks[0]["violation"] is None


def test_solution_knows_its_size_and_how_it_was_made():
    solution = solve(reach(), transcription="radau:2", intervals=6, tolerance=1e-5)
    made = prepare(reach(), transcription="radau:2", intervals=6)
    assert solution.statistics.variables == made.transcription.layout.n_unknowns == 7 * 2 + 6 * 2
    assert solution.statistics.constraints == made.transcription.n_rows == 6 * 2 + 2
    assert solution.statistics.solver == "ipopt"
    assert (solution.statistics.tolerance, solution.statistics.perturb) == (1e-5, 0.0)
    assert solution.statistics.max_violation < 1e-5


def test_defaults_are_the_problems_own():
    solution = solve(reach())
    assert solution.statistics.transcription == "legendre:2"
    assert solution.n_intervals == 10


def test_perturbed_starts_are_reproducible_and_reach_the_same_optimum():
    options = {"transcription": "legendre:2", "perturb": 0.2}
    once, again, other = (solve(reach(), seed=seed, **options) for seed in (1, 1, 2))
    assert_array_equal(once.q, again.q)
    assert_allclose(once.q, other.q, atol=SOLVED)
    assert (once.statistics.seed, other.statistics.seed) == (1, 2)


def test_progress_that_returns_false_interrupts():
    seen: list[float] = []

    def progress(info: dict[str, float]) -> bool:
        seen.append(info["iteration"])
        return len(seen) < 3

    solution = solve(hop(), transcription="legendre:1", progress=progress)
    assert solution.statistics.status == "interrupted"
    assert seen == [0, 1, 2]


@pytest.mark.parametrize(
    ("setting", "value", "message"),
    [
        ("solver", "snopt", "unknown solver 'snopt'; allowed: ipopt"),
        ("tolerance", 0.0, "allowed: between 0 and 1"),
        ("tolerance", float("nan"), "allowed: between 0 and 1"),
        ("max_iterations", -1, "allowed: 0 or more"),
        ("max_time", 0.0, "allowed: > 0"),
        ("max_time", float("nan"), "allowed: > 0"),
        ("perturb", -0.1, "allowed: 0 to 100"),
        ("perturb", float("inf"), "allowed: 0 to 100"),
        ("seed", -1, "allowed: 0 or more"),
        ("threads", 0, "allowed: 1 or more"),
        ("intervals", 0, "allowed: at least 1"),
        ("transcription", "legendre:9", "allowed: legendre:1..4"),
    ],
)
def test_setting_that_is_not_allowed_is_refused(setting, value, message):
    with pytest.raises(InputError) as refused:
        solve(reach(), **{"perturb": 0.1, setting: value})
    assert message in str(refused.value)


INTERVALS = 8
# Rows of a solution to 1e-8 in natural units hold to this in units of the weight.
RESIDUAL = 1e-6
ROUNDING = 1e-10
SCHEMES = ("legendre:2", "radau:2", "hermite-simpson")


@lru_cache
def solved(name: str) -> Solution:
    return solve(hop(), transcription=name, intervals=INTERVALS, tolerance=1e-8)


def by_interval(solution: Solution, name: str) -> np.ndarray:
    values = getattr(solution, name)
    return values.reshape(INTERVALS, -1, *values.shape[1:])


@pytest.mark.parametrize("name", SCHEMES)
def test_samples_are_start_points_and_end_of_each_interval(name):
    solution, method = solved(name), scheme(name)
    assert solution.converged
    assert solution.n_samples == INTERVALS * (method.s + 2)
    assert_array_equal(by_interval(solution, "collocation")[0], [False] + [True] * method.s + [False])
    assert_array_equal(
        by_interval(solution, "interval"), np.tile(np.arange(INTERVALS)[:, None], method.s + 2)
    )
    start, end = solution.interval_t.T
    fractions = np.concatenate([[0.0], method.c, [1.0]])
    expected = start[:, None] + np.outer(end - start, fractions)
    assert_allclose(by_interval(solution, "t"), expected, atol=ROUNDING)
    assert_array_equal(start[1:], end[:-1])


@pytest.mark.parametrize("name", SCHEMES)
def test_extracted_solution_is_a_consistent_file(name, tmp_path):
    solution = solved(name)
    read = Solution.load(solution.save(tmp_path / "hop.npz"))
    assert_array_equal(read.q, solution.q)
    assert read.converged


@pytest.mark.parametrize("name", SCHEMES)
def test_phases_and_active_contacts_follow_the_schedule(name):
    solution = solved(name)
    names = np.array(solution.description.phase_names)[solution.phase]
    assert list(solution.meta["intervals"]) == [3, 2, 3]
    assert_array_equal(solution.active[:, 0], names != "flight")
    assert_array_equal(solution.f[names == "flight"], 0.0)
    assert_array_equal(solution.f[:, :, 3:], 0.0)  # a point transmits no moment
    assert np.all(solution.f[solution.collocation & (names == "stance"), 0, 2] >= -RESIDUAL * hopper().weight)


@pytest.mark.parametrize("name", SCHEMES)
@pytest.mark.parametrize("quantity", ["a", "tau", "f"])
def test_values_at_nodes_are_interpolated_through_the_points(name, quantity):
    values, method = by_interval(solved(name), quantity), scheme(name)
    ends = method.interpolation(np.array([0.0, 1.0]))
    for interval in values:
        expected = np.tensordot(ends, interval[1:-1], axes=1)
        assert_allclose(interval[[0, -1]], expected, rtol=ROUNDING, atol=ROUNDING * np.max(np.abs(values)))


@pytest.mark.parametrize("name", SCHEMES)
def test_node_shared_by_two_intervals_has_one_state(name):
    solution = solved(name)
    for quantity in ("q", "v"):
        values = by_interval(solution, quantity)
        assert_array_equal(values[1:, 0], values[:-1, -1])


@pytest.mark.parametrize("name", SCHEMES)
def test_dynamics_hold_at_the_points_with_the_extracted_torques(name):
    solution, robot = solved(name), hopper()
    force = sample_quantities(solution).generalized_force[solution.collocation]
    n = robot.n_unactuated
    assert_allclose(force[:, :n] / robot.weight, 0.0, atol=RESIDUAL)
    assert_allclose(force[:, n:], solution.tau[solution.collocation], atol=ROUNDING * robot.weight)


@pytest.mark.parametrize("name", SCHEMES)
def test_contacts_do_not_accelerate_at_the_points(name):
    solution = solved(name)
    touching = solution.collocation & solution.active[:, 0]
    acceleration = sample_quantities(solution).acceleration[touching, 0, :3]
    assert_allclose(acceleration / 9.81, 0.0, atol=RESIDUAL)


@pytest.mark.parametrize("name", ["radau:2", "hermite-simpson", "trapezoidal"])
def test_point_at_the_end_of_an_interval_has_the_state_of_the_node(name):
    solution = solved(name)
    for quantity in ("q", "v"):
        values = by_interval(solution, quantity)
        assert_allclose(np.abs(values[:, -2]), np.abs(values[:, -1]), atol=RESIDUAL)
        if scheme(name).c[0] == 0.0:
            assert_allclose(values[:, 1], values[:, 0], atol=ROUNDING)


def test_solution_of_a_fixed_base_has_no_contact():
    t = transcribe(reach(), "legendre:2", 3)
    solution = extract(t, initial_guess(t))
    assert solution.f.shape == (12, 0, 6)
    assert solution.tau.shape == (12, 1)


def test_wrench_of_a_sole_has_force_and_moment():
    t = transcribe(hop("surface"), "legendre:2", 8)
    x = initial_guess(t)
    window = x[t.layout.node_offset[0] :]
    window[t.layout.local_wrench(0, 0)] = np.arange(1.0, 7.0)
    scale = t.scale[t.layout.local_wrench(0, 0)]
    assert_allclose(extract(t, x).f[1, 0], np.arange(1.0, 7.0) * scale)


def test_description_names_the_robot_its_contacts_and_limits():
    meta = solved("legendre:2").meta
    assert (meta["problem"], meta["robot"], meta["transcription"]) == ("hop", "hopper", "legendre:2")
    assert (meta["contact_frames"], meta["contact_kinds"]) == ([FOOT], ["point"])
    assert meta["effort_limit"] == [60.0, 60.0]
    assert meta["velocity_limit"] == [sys.float_info.max] * 6 + [20.0, 20.0]
    assert meta["gravity"] == [0.0, 0.0, -9.81]


def test_model_in_the_solution_is_the_one_that_was_optimised():
    robot, solution = hopper(), solved("legendre:2")
    assert solution.model.nv == robot.nv
    assert_allclose(solution.model.armature, robot.model.armature)
    assert planar_hopper().nv == 6


TURN = 1.2  # rad
# On a busy machine a solve, or what comes after it, is what the time ends.
TIME = r"no reference: (the time is up|.* is not solved \(time limit\))"


def reference_swing() -> Problem:
    """A bar lifted against gravity with little torque: no polynomial in time."""
    return reach(gravity=True, terms=(terms.TorqueCost(weight=1.0),))


def bar() -> Robot:
    """A bar that turns about y, without gravity."""
    model = pin.Model()
    model.name = "bar"
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "joint")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, 0.1, 0.1, 0.5), pin.SE3.Identity())
    model.addFrame(pin.Frame("bar", joint, 0, pin.SE3(np.eye(3), np.array([0, 0, 0.5])), pin.OP_FRAME))
    model.gravity = pin.Motion.Zero()
    return Robot.from_model(model, reference=np.zeros(1), name="bar")


def either_way(sign: float) -> Problem:
    """Turn far away from the downward direction, either way: one optimum each, chosen by the guess."""
    away = terms.FrameDirection(
        frame="bar", axis=(0, 0, 1), direction=(0.05, 0, -1), angle=np.pi - TURN, at=end_of("turn")
    )
    chosen = terms.AccelerationCost(weight=1.0), terms.PostureCost(weight=0.1), away
    given = {"guess": lambda t: np.array([sign * TURN * t]), "default_intervals": 6}
    return one_phase(bar(), *chosen, name="turn", initial_q=np.zeros(1), **given)


def test_reference_agrees_and_says_how_it_was_found():
    seen = []
    found = converged_reference(reference_swing(), progress=seen.append)
    assert tuple(seen) == found.rungs
    assert [rung.scheme for rung in found.rungs[:2]] == ["legendre:2", "legendre:3"]
    assert [rung.intervals for rung in found.rungs[:3]] == [10, 10, 20]
    assert abs(found.agreement.objective_gap) <= 1e-5
    assert found.agreement.farthest <= 1e-3 * 0.5
    assert found.rungs[-1].apart == found.agreement
    assert found.rungs[-1].intervals == found.solution.n_intervals
    described = json.loads(json.dumps(found.solution.statistics.more["reference"], allow_nan=False))
    assert described["rungs"][-1]["objective"] == found.solution.statistics.objective
    assert "the last two agree to" in str(found)


def test_reference_of_least_acceleration_is_the_cubic():
    """12 theta^2 / T^3 is the least integral of the squared acceleration from rest to rest."""
    found = converged_reference(reach())
    plan = found.solution
    s = plan.t / plan.t[-1]
    assert_allclose(plan.q[:, 0], plan.q[-1, 0] * (3 * s**2 - 2 * s**3), atol=1e-9)
    coarse = trajopt.solve(reach(), intervals=3)
    assert measure(coarse, plan).distance < 1e-9
    assert abs(measure(coarse, plan).objective_gap) < 1e-9


@pytest.mark.long
def test_distance_to_the_reference_falls_with_the_step():
    found = converged_reference(lean(), agreement=Agreement(objective=1e-7, distance=1e-4)).solution
    gaps = [measure(trajopt.solve(lean(), transcription="legendre:1", intervals=n), found) for n in (4, 8)]
    assert gaps[1].distance < 0.5 * gaps[0].distance
    assert gaps[1].open_loop < 0.5 * gaps[0].open_loop


@pytest.mark.long
def test_budget_ends_the_climb_and_names_the_agreement():
    strict = Agreement(objective=1e-15, distance=1e-15)
    words = r"more than 600 variables; the last two meshes agree to .* m"
    with pytest.raises(NoReferenceError, match=words) as caught:
        converged_reference(reference_swing(), agreement=strict, max_unknowns=600)
    assert len(caught.value.rungs) > 2
    with pytest.raises(NoReferenceError, match=TIME):
        converged_reference(reference_swing(), agreement=strict, max_time=0.2)


def test_mesh_that_is_not_solved_is_named():
    goal = replace(reference_swing(), terms=(*reference_swing().terms, terms.FrameDirection(
        frame="universe", axis=(0, 0, 1), direction=(0, 0, -1), angle=0.1, at=middle_of("reach"),
    )))  # fmt: skip
    with pytest.raises(NoReferenceError, match="legendre:2 with 10 intervals is not solved"):
        converged_reference(goal)


test_bad_bounds_are_refused = refused_calls(
    (lambda: Agreement(objective=0.0), "objective of Agreement is 0"),
    (lambda: Agreement(distance=np.inf), "distance of Agreement is inf"),
    (lambda: converged_reference(reach(), max_time=-1.0), "max_time is -1"),
    (lambda: converged_reference(reach(), scheme="legendre:9"), "unknown transcription"),
)


def test_solutions_in_different_optima_are_told_from_those_on_different_meshes():
    left, right = (trajopt.solve(either_way(sign), intervals=n) for sign, n in ((-1.0, 6), (1.0, 12)))
    assert left.converged
    assert right.converged
    assert left.q[-1, 0] < 0 < right.q[-1, 0]
    assert in_other_optimum(either_way(-1.0), left, right)
    finer = trajopt.solve(either_way(1.0), intervals=24)
    assert not in_other_optimum(either_way(1.0), right, finer)


@pytest.mark.long
def test_commands_make_a_reference_and_check_against_it(tmp_path):
    made, plan = tmp_path / "reference.npz", tmp_path / "plan.npz"
    result = invoke("bench", "reference", "ur5-reach", "--output", made, "--json")
    assert result.exit_code == 0
    assert json.loads(result.stdout)["file"] == str(made)
    assert "30 intervals" in result.stderr
    assert invoke("solve", "ur5-reach", "--output", plan).exit_code == 0
    plain = json.loads(invoke("check", plan, "--json").stdout)
    full = json.loads(invoke("check", plan, "--reference", made, "--json").stdout)
    found = full.pop("accuracy")
    assert full == plain
    assert abs(found["objective_gap"]) < 1e-4
    assert found["distance"] < 1e-3
    assert found["open_loop"] == pytest.approx(measure(plan).open_loop)
    text = invoke("check", plan, "--accuracy").stdout
    assert "local error of one interval" in text
    assert "reference" not in text


def test_command_that_finds_none_writes_no_file(tmp_path):
    made = tmp_path / "reference.npz"
    arguments = ["bench", "reference", "ur5-reach", "--distance", "1e-15", "--max-time", "0.5"]
    result = invoke(*arguments, "--output", made)
    assert result.exit_code == 1
    assert re.search(TIME, result.stderr)
    assert not made.exists()
