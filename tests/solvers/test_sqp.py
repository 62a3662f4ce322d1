"""Whole solves by the SQP: optima, starts, stops, options, and what it reports."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import sparse

from tests.support.problems import SCHEME_ORDERS, hop, lean, reach
from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.solvers.convexification import ConvexifiedHessian
from trajopt.solvers.drivers import run_solver
from trajopt.solvers.result import Callback, Result, StoppingCriteria, WarmMultipliers
from trajopt.solvers.status import Status
from trajopt.solving.solving import PreparedProblem, prepare, solve, solve_prepared
from trajopt.terms import AccelerationCost, TorqueCost, TorqueLimits, VelocityCost
from trajopt.transcription.guess import perturbed
from trajopt.transcription.nlp import Nlp
from trajopt_library import problems

Unknowns = Callable[[], np.ndarray]
# Solves to 1e-6 from two solvers: the objective differs by the error's square, positions by the error
# over the curvature.
SAME_OBJECTIVE = 1e-6
TOLERANCE = 1e-6
# Violation at which an early stop is asked for, above what a solve ends with, below that of the guess.
EARLY = 1e-3


def sqp(prepared: PreparedProblem, x: np.ndarray | None = None, **given: object) -> Result:
    settings = {"options": {}, "callback": lambda *_: True, "warm": None, "stop": StoppingCriteria(), **given}
    start = prepared.guess if x is None else x
    order = ("stop", "options", "callback", "warm")
    return run_solver(prepared.nlp, start, "sqp", *(settings[name] for name in order))


def swing() -> Problem:
    """The arm against gravity: nonlinear, one joint."""
    costs = (TorqueCost(weight=1.0), VelocityCost(weight=0.1))
    return reach(gravity=True, terms=(*costs, TorqueLimits(limit=np.array([11.0]))))


def ready(problem: Problem, **options: object) -> PreparedProblem:
    return prepare(problem, **options)


def kkt(nlp: Nlp, x: np.ndarray, lam_g: np.ndarray, lam_x: np.ndarray) -> tuple[float, float, float]:
    """Primal, dual and complementarity errors from the engine's functions alone."""
    t = nlp.transcription
    g = nlp.engine.g(x)
    jacobian = nlp.jacobian(x)
    dual = np.abs(nlp.engine.gradient(x) + jacobian.T @ lam_g + lam_x).max()
    primal, products = 0.0, 0.0
    for value, low, high, multiplier in (
        (g, t.lower_g, t.upper_g, lam_g),
        (x, t.lower_x, t.upper_x, lam_x),
    ):
        primal = max(primal, np.maximum(low - value, value - high).max())
        for v, a, b, m in zip(value, low, high, multiplier, strict=True):
            gap = (b - v if m > 0 else v - a) if a != b else 0.0
            products = max(products, abs(m) * (gap if np.isfinite(gap) else 1.0))
    return primal, float(dual), products


@pytest.mark.parametrize("problem", [swing, lean], ids=lambda make: make.__name__)
def test_solutions_fulfil_the_conditions_of_optimality_and_report_their_errors(problem):
    prepared = ready(problem())
    found = sqp(prepared)
    assert found.status is Status.SOLVED
    primal, dual, products = kkt(prepared.nlp, found.x, found.lam_g, found.lam_x)
    assert primal <= 0.1 * TOLERANCE
    assert max(dual, products) <= TOLERANCE
    reported = (found.primal, found.dual, found.complementarity)
    assert_allclose(reported, (primal, dual, products), rtol=1e-6, atol=1e-12)
    assert found.objective == prepared.nlp.engine.f(found.x)


@pytest.mark.parametrize("problem", [swing, lean], ids=lambda make: make.__name__)
def test_the_optimum_is_ipopts(problem):
    prepared = ready(problem())
    expected = run_solver(
        prepared.nlp, prepared.guess, "ipopt", StoppingCriteria(tolerance=1e-8), {}, lambda *_: True
    )
    found = sqp(prepared)
    assert (expected.status, found.status) == (Status.SOLVED, Status.SOLVED)
    assert found.objective == pytest.approx(expected.objective, rel=SAME_OBJECTIVE)


@pytest.mark.long
@pytest.mark.parametrize("name", SCHEME_ORDERS)
def test_every_scheme_is_solved(name):
    prepared = ready(lean(), transcription=name)
    best = run_solver(
        prepared.nlp, prepared.guess, "ipopt", StoppingCriteria(tolerance=1e-8), {}, lambda *_: True
    )
    assert sqp(prepared).objective == pytest.approx(best.objective, rel=SAME_OBJECTIVE)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ur5-reach", "hopper-hop", "solo12-jump", "quadruped-trot", "biped-squat"])
def test_real_robots_end_at_ipopts_optimum_also_from_perturbed_starts(name):
    """`quadruped-trot` is periodic: its rows join the first and the last stage."""
    prepared = prepare(problems.load(name))
    best = run_solver(prepared.nlp, prepared.guess, "ipopt", StoppingCriteria(), {}, lambda *_: True)
    starts = [prepared.guess, perturbed(prepared.transcription, prepared.guess, 1, 0.1)]
    for start in starts:
        found = sqp(prepared, start)
        assert found.status is Status.SOLVED
        assert found.objective == pytest.approx(best.objective, rel=1e-5)


def test_a_start_from_a_solution_with_its_multipliers_takes_no_step():
    prepared = ready(lean())
    first = sqp(prepared)
    again = sqp(prepared, first.x, warm=WarmMultipliers(lam_g=first.lam_g, lam_x=first.lam_x))
    assert (again.status, again.iterations) == (Status.SOLVED, 0)


@pytest.mark.long
def test_after_a_small_change_a_start_from_the_solution_takes_fewer_steps():
    first = solve(lean(), solver="sqp")
    changed = replace(lean(), initial_v=1.02 * lean().initial_v)
    cold, warm = (solve(changed, solver="sqp", start=s) for s in (None, first))
    assert cold.converged
    assert warm.converged
    assert warm.statistics.iterations < cold.statistics.iterations
    assert warm.statistics.objective == pytest.approx(cold.statistics.objective, rel=SAME_OBJECTIVE)


def test_contradicting_limits_are_reported_as_infeasible_near_their_least_violation():
    weak = reach(terms=(AccelerationCost(weight=1.0), TorqueLimits(limit=np.array([0.05]))))
    solution = solve(weak, solver="sqp")
    assert (solution.success, solution.statistics.status) == (False, "infeasible")
    assert solution.statistics.solver_status == "Infeasible"
    assert np.isfinite(solution.q).all()


@pytest.mark.long
@pytest.mark.parametrize("limit", [0, 2])
@pytest.mark.parametrize("by", ["stop", "option"])
def test_the_limit_of_steps_is_obeyed(limit, by):
    given = (
        {"stop": StoppingCriteria(max_iterations=limit)} if by == "stop" else {"options": {"max_sqp": limit}}
    )
    found = sqp(ready(hop()), **given)
    assert (found.status, found.iterations) == (Status.ITERATION_LIMIT, limit)


def test_early_stops_at_the_first_step_whose_rows_hold_as_well_as_asked():
    prepared, seen = ready(lean()), []

    def watch(info: dict[str, float], _: Unknowns) -> bool:
        seen.append(info["primal"])
        return True

    found = sqp(prepared, options={"early": EARLY}, callback=watch)
    assert found.status is Status.EARLY
    assert found.primal == seen[-1] <= EARLY < min(seen[:-1])
    solution = solve(lean(), solver="sqp", options={"early": EARLY})
    assert (solution.success, solution.statistics.status) == (False, "early")
    assert "not optimal" in solution.statistics.advice


@pytest.mark.parametrize(
    "options",
    [
        {"no_such_option": 1}, {"early": 0.0}, {"early": "soon"}, {"early": True}, {"early": float("nan")},
        {"max_sqp": -1}, {"max_sqp": 2.5}, {"regularization": -1.0},
    ],
)  # fmt: skip
def test_wrong_options_are_refused_by_name(options):
    with pytest.raises(InputError, match=f"sqp: option '{next(iter(options))}'"):
        sqp(ready(reach()), options=options)


def test_every_step_is_reported_with_the_keys_of_the_other_solvers():
    prepared, seen = ready(lean()), []
    names: dict[str, set[str]] = {}
    for solver in ("ipopt", "sqp"):
        told: list[dict[str, float]] = []
        run_solver(prepared.nlp, prepared.guess, solver, StoppingCriteria(), {}, _keeping(told))
        names[solver], seen = set(told[0]), told
    assert names["sqp"] == names["ipopt"]
    assert [info["iteration"] for info in seen] == list(range(len(seen)))


def _keeping(told: list[dict[str, float]]) -> Callback:
    def keep(info: dict[str, float], _: Unknowns) -> bool:
        told.append(info)
        return True

    return keep


@pytest.mark.parametrize("how", ["false", "interrupt"])
def test_stopping_keeps_the_current_iterate(how):
    prepared, seen = ready(hop()), []

    def stop(info: dict[str, float], _: Unknowns) -> bool:
        seen.append(info)
        if info["iteration"] < 3:
            return True
        if how == "interrupt":
            raise KeyboardInterrupt
        return False

    found = sqp(prepared, callback=stop)
    assert (found.status, found.iterations) == (Status.INTERRUPTED, 3)
    assert found.objective == seen[-1]["objective"] == prepared.nlp.engine.f(found.x)
    assert np.abs(found.x - prepared.guess).max() > 1e-3


def test_an_exception_in_the_callback_is_raised():
    def fail(_: dict[str, float], __: Unknowns) -> bool:
        raise LookupError("from the callback")

    with pytest.raises(LookupError, match="from the callback"):
        sqp(ready(reach()), callback=fail)


def test_the_time_limit_is_reported():
    assert sqp(ready(hop()), stop=StoppingCriteria(max_time=1e-6)).status is Status.TIME_LIMIT


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_start_that_is_not_finite_is_a_status(value):
    prepared = ready(reach())
    start = prepared.guess.copy()
    start[5] = value
    found = sqp(prepared, start)
    assert (found.status, found.iterations) == (Status.NOT_FINITE, 0)


def test_huge_start_multipliers_do_not_prevent_convergence():
    prepared = ready(swing())
    generator = np.random.default_rng(0)
    wild = WarmMultipliers(
        lam_g=1e8 * generator.normal(size=prepared.transcription.n_rows), lam_x=np.zeros_like(prepared.guess)
    )
    found = sqp(prepared, warm=wild)
    assert found.objective == pytest.approx(sqp(prepared).objective, rel=SAME_OBJECTIVE)


def test_no_more_is_written_than_the_bounds_allow():
    prepared = ready(hop())
    t = prepared.transcription
    found = sqp(prepared, perturbed(t, prepared.guess, 0, 1.0), options={"max_sqp": 3})
    assert np.all(found.x >= t.lower_x)
    assert np.all(found.x <= t.upper_x)


def test_figures_of_the_programs_are_in_the_meta():
    prepared = ready(swing())
    solution = solve_prepared(prepared, prepared.guess, origin={"seed": 0, "perturb": 0.0}, solver="sqp")
    statistics, figures = solution.statistics, solution.statistics.more
    assert figures["quadratic_programs"] >= statistics.iterations > 0
    assert figures["quadratic_program_iterations"] >= figures["quadratic_programs"]
    assert 0 < figures["quadratic_program_time_s"] <= statistics.wall_time_s


def test_curvature_that_is_taken_away_is_a_share_of_the_negative_eigenvalues():
    prepared = ready(lean(), intervals=3)
    nlp, n = prepared.nlp, len(prepared.guess)
    multipliers = np.random.default_rng(0).normal(size=prepared.transcription.n_rows)
    values = nlp.engine.hessian(prepared.guess, 1.0, multipliers)
    known = ConvexifiedHessian(nlp)

    def dense(entries: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        lower = sparse.csr_matrix((entries, (row, column)), shape=(n, n)).toarray()
        return lower + np.tril(lower, -1).T

    whole = dense(values, nlp.hessian_row, nlp.hessian_column)
    eigenvalues, vectors = np.linalg.eigh(whole)
    assert eigenvalues[0] < -0.01
    for share in (0.0, 0.25, 1.0):
        less = np.where(eigenvalues < 0, (1 - share) * eigenvalues, eigenvalues)
        found = dense(known.values(values, share), known.row, known.column)
        assert_allclose(found, (vectors * less) @ vectors.T, atol=1e-10 * eigenvalues[-1])
