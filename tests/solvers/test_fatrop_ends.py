"""FATROP comes to an end from every start, within its time limit, with a status that tells the cause."""

from __future__ import annotations

import json
import os

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.support.grouped_nlps import GroupedProblem, arguments, cart_pole, logarithm_well
from tests.support.processes import python
from trajopt import _engine

LIMIT = 0.5  # s, of each solve
SEEDS = 6
SAME = 1e-6
FAILURES = {
    "LineSearchFailed", "ErrorInStepComputation", "MaxWallTimeExceeded", "MaxIterExceeded", "InvalidNumber",
    "LocalInfeasibility",
}  # fmt: skip
# From starts as far off (standard deviation in natural units) FATROP's own inertia correction goes on until
# its matrix is NaN, and for ever after.
DEGENERATE = """
import json, sys
from trajopt_library import problems
from trajopt.transcription.guess import perturbed
from trajopt.solvers.drivers import run_solver
from trajopt.solvers.result import StoppingCriteria
from trajopt.solving.solving import prepare
name, intervals, limit, seeds = sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4])
prepared = prepare(problems.load(name), intervals=intervals)
found = []
for sigma in (30.0, 100.0):
    for seed in range(seeds):
        start = perturbed(prepared.transcription, prepared.guess, seed, sigma)
        stop = StoppingCriteria(max_time=limit)
        result = run_solver(prepared.nlp, start, "fatrop", stop, {}, lambda *_: True)
        found.append([result.solver_status, result.status.word, result.wall_time])
print(json.dumps(found))
"""


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "intervals"), [("hopper-hop", 12), pytest.param("solo12-jump", 6, marks=pytest.mark.slow)]
)
def test_degenerate_starts_end_with_a_status_of_failure(name: str, intervals: int) -> None:
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = python(DEGENERATE, name, intervals, LIMIT, SEEDS, env=environment)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert len(found) == 2 * SEEDS
    assert {status for status, _, _ in found} <= FAILURES
    assert not any(word == "solved" for _, word, _ in found)


def solve(problem: GroupedProblem, callback=None, **options):
    nlp = _engine.Nlp(**arguments(problem))
    bounds = (problem.lbx, problem.ubx, problem.lbg, problem.ubg)
    sizes = (problem.nx, problem.nu, problem.ng)
    return _engine.solve_fatrop(
        nlp, *sizes, problem.x0, *bounds, {"tolerance": 1e-9, "print_level": 0, **options}, callback
    )


def infinite_curvature() -> GroupedProblem:
    """Minimise x^(3/2), of a finite slope and infinite curvature at its start, x = 0."""
    problem = logarithm_well()
    y, none = ca.SX.sym("y"), ca.SX.sym("p", 0)
    problem.groups[0].cost = ca.Function("L", [y, none], [ca.sqrt(y**3)])
    problem.x0 = np.zeros(2)
    return problem


def test_infinite_curvature_ends_as_an_invalid_number() -> None:
    result = solve(infinite_curvature(), max_wall_time=10.0)
    assert (result["status"], result["iterations"]) == ("InvalidNumber", 0)


def test_a_regularisation_beyond_its_limit_ends_the_step() -> None:
    seen: list[float] = []
    found = solve(cart_pole(), callback=lambda info, _: seen.append(info["regularization"]))
    assert found["status"] == "Success"
    assert max(seen) > 0  # its Hessian is indefinite on the way
    assert solve(cart_pole(), delta_wmax=max(seen) / 1e6)["status"] == "ErrorInStepComputation"


def test_a_time_limit_that_has_passed_ends_before_the_first_step() -> None:
    result = solve(cart_pole(), max_wall_time=1e-9)
    assert (result["status"], result["iterations"]) == ("MaxWallTimeExceeded", 0)
    assert_allclose(result["x"], cart_pole().x0)


@pytest.mark.parametrize("scale", [0.05, 1.0, 40.0])
def test_a_scaled_objective_has_the_same_solution_multipliers_and_value(scale: float) -> None:
    result, own = solve(cart_pole(), objective_scale=scale), solve(cart_pole())
    assert result["status"] == "Success"
    for key in ("x", "f", "lam_g", "lam_x"):
        assert_allclose(result[key], own[key], atol=SAME, rtol=SAME, err_msg=key)


def test_iterations_report_the_unscaled_objective() -> None:
    seen: list[float] = []
    result = solve(cart_pole(), objective_scale=40.0, callback=lambda info, _: seen.append(info["objective"]))
    assert seen[-1] == pytest.approx(result["f"], rel=SAME)


@pytest.mark.parametrize("value", [0.0, -1.0, "much", float("nan")])
@pytest.mark.parametrize("name", ["objective_scale", "max_wall_time"])
def test_a_number_that_is_none_or_not_positive_is_refused(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=name):
        solve(cart_pole(), **{name: value})
