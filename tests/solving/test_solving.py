"""Solving in one call: one known optimum for all transcriptions, statuses, settings."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.support.problems import REACH, REACH_TIME, SCHEME_ORDERS, hop, one_joint_arm, reach
from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.robot.units import Units
from trajopt.solvers.drivers import SOLVERS
from trajopt.solvers.status import Status
from trajopt.solving.solving import prepare, solve
from trajopt.terms import AccelerationCost, TerminalState, TorqueCost, TorqueLimits, VelocityCost

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
    costs = (TorqueCost(weight=1.0), VelocityCost(weight=0.1))
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
    weak = reach(terms=(AccelerationCost(weight=1.0), TorqueLimits(limit=np.array([0.05]))))
    solution = solve(weak, transcription="legendre:2", solver=solver, max_iterations=200)
    assert not solution.success
    assert solution.statistics.status in ("infeasible", "step_failed", "iteration_limit")
    assert solution.statistics.max_violation > 1e-3


def broken_after(problem: Problem, time: float) -> Problem:
    def motion(t: float) -> np.ndarray:
        return problem.guess(t) if t < time else np.full(problem.robot.nq, np.nan)

    return replace(problem, guess=motion)


def test_guess_that_is_not_finite_is_refused_with_its_time():
    problem = broken_after(reach(gravity=True, terms=(TorqueCost(weight=1.0),)), 0.41)
    with pytest.raises(InputError, match=r"guess of problem 'reach' at t = 0\.4\d+ s is not finite"):
        solve(problem, transcription="legendre:1", intervals=8)


def test_function_that_is_not_finite_is_a_status_that_names_the_place():
    """The error of a rotation has a pole at half a turn: here the guess ends there, to the last digit."""
    turned = hop().robot.reference.copy()
    turned[3:7] = [0.0, 0.0, 1.0, 0.0]
    problem = hop(terms=(TorqueCost(weight=1.0), TerminalState(q=turned)))
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
