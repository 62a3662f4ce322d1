"""The SQP: its quadratic programs against another solver, its filter, and the optima it ends at."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import osqp
import pytest
from numpy.testing import assert_allclose
from scipy import sparse
from scipy.optimize import linprog

from tests.support.problems import SCHEME_ORDERS, hop, lean, reach
from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.solvers.convexification import ConvexifiedHessian
from trajopt.solvers.drivers import run_solver
from trajopt.solvers.qp import QpStep, QuadraticProgram, StageQp
from trajopt.solvers.result import Callback, Result, StoppingCriteria, WarmMultipliers
from trajopt.solvers.sqp_filter import Filter, FilterEntry
from trajopt.solvers.status import Status
from trajopt.solving.solving import PreparedProblem, prepare, solve, solve_prepared
from trajopt.terms import AccelerationCost, EffortLimits, TorqueCost, VelocityCost
from trajopt.transcription.guess import perturbed
from trajopt.transcription.nlp import Nlp
from trajopt_library import problems

Unknowns = Callable[[], np.ndarray]

# Accuracy asked of programs, and what two solvers of one program agree to, of entries of order one.
ACCURACY = 1e-9
SAME_STEP = 1e-5
# Solves to 1e-6 from two solvers: the objective differs by the error's square, positions by the error
# over the curvature.
SAME_OBJECTIVE = 1e-6
TOLERANCE = 1e-6
# Violation at which an early stop is asked for, above what a solve ends with, below that of the guess.
EARLY = 1e-3
# A sum of thousands of slacks in another order, and the price of a small share of the objective.
SAME_MISS = 1e-3


def dense_program(seed: int, *, convex: bool = True) -> tuple[SimpleNamespace, QuadraticProgram]:
    """A random program of 12 unknowns with equations, inequalities of all kinds and bounds, feasible.

    If not ``convex`` its matrix is negative on a direction that the equations forbid.
    """
    generator = np.random.default_rng(seed)
    n, rows = 12, 9
    j = generator.normal(size=(rows, n)) * (generator.uniform(size=(rows, n)) < 0.6)
    j[:, :rows] += np.eye(rows)
    root = generator.normal(size=(n, n))
    h = root @ root.T / n + 0.1 * np.eye(n)
    if not convex:
        h -= 5.0 * np.outer(j[0], j[0])
    inner = generator.normal(size=n)
    low, high = j @ inner - 0.2, j @ inner + generator.uniform(0.0, 0.5, rows)
    low[:4] = high[:4] = (j @ inner)[:4]
    low[5], high[6] = -np.inf, np.inf
    x_low, x_high = inner - 0.3, np.where(np.arange(n) % 3 == 0, np.inf, inner + 0.4)
    row, column = np.nonzero(np.ones((rows, n)))
    lower = np.tril_indices(n)
    bounds = SimpleNamespace(lower_g=low, upper_g=high, lower_x=x_low, upper_x=x_high)
    nlp = SimpleNamespace(
        transcription=bounds, row=row, column=column, hessian_row=lower[0], hessian_column=lower[1]
    )
    q = QuadraticProgram(
        hessian=h[lower], gradient=generator.normal(size=n), jacobian=j.ravel(),
        low=low, high=high, x_low=x_low, x_high=x_high,
    )  # fmt: skip
    return nlp, q


def matrices(q: QuadraticProgram) -> tuple[np.ndarray, np.ndarray]:
    n = len(q.gradient)
    h = np.zeros((n, n))
    h[np.tril_indices(n)] = q.hessian
    return h + np.tril(h, -1).T, q.jacobian.reshape(-1, n)


def by_osqp(q: QuadraticProgram) -> tuple[np.ndarray, np.ndarray]:
    h, j = matrices(q)
    n = len(h)
    solver = osqp.OSQP()
    solver.setup(
        sparse.csc_matrix(np.triu(h)), q.gradient, sparse.csc_matrix(np.vstack([j, np.eye(n)])),
        np.concatenate([q.low, q.x_low]), np.concatenate([q.high, q.x_high]),
        verbose=False, eps_abs=1e-10, eps_rel=1e-10, max_iter=100000, polishing=True,
    )  # fmt: skip
    found = solver.solve()
    return np.array(found.x), np.array(found.y)


def assert_optimal(q: QuadraticProgram, step: QpStep) -> None:
    """Karush, Kuhn and Tucker: no slope, rows within bounds, multipliers only at the bound they are of."""
    h, j = matrices(q)
    assert_allclose(h @ step.d + q.gradient + j.T @ step.lam_g + step.lam_x, 0, atol=SAME_STEP)
    for value, low, high, multiplier in (
        (j @ step.d, q.low, q.high, step.lam_g),
        (step.d, q.x_low, q.x_high, step.lam_x),
    ):
        assert np.all(value >= low - SAME_STEP)
        assert np.all(value <= high + SAME_STEP)
        free = (value > low + 1e-3) & (value < high - 1e-3)
        assert_allclose(multiplier[free], 0, atol=SAME_STEP)
        assert np.all(multiplier[value < high - 1e-3] <= SAME_STEP)
        assert np.all(multiplier[value > low + 1e-3] >= -SAME_STEP)


@pytest.mark.parametrize("seed", range(4))
def test_steps_and_multipliers_of_random_convex_programs_are_osqps(seed):
    nlp, q = dense_program(seed)
    step = StageQp(nlp).solve(q, 0.0, ACCURACY)
    d, y = by_osqp(q)
    assert step.solved
    assert_allclose(step.d, d, atol=SAME_STEP)
    assert_allclose(np.concatenate([step.lam_g, step.lam_x]), y, atol=10 * SAME_STEP)
    assert_optimal(q, step)


@pytest.mark.parametrize("seed", range(4))
def test_programs_may_be_negative_where_the_equations_forbid_to_go(seed):
    nlp, q = dense_program(seed, convex=False)
    assert np.linalg.eigvalsh(matrices(q)[0])[0] < -1
    step = StageQp(nlp).solve(q, 0.0, ACCURACY)
    assert step.solved
    assert_optimal(q, step)


def test_a_second_program_with_other_numbers_knows_nothing_of_the_first():
    nlp, first = dense_program(0)
    q = replace(first, gradient=-2 * first.gradient, hessian=0.5 * first.hessian)
    qp = StageQp(nlp)
    qp.solve(first, 0.0, ACCURACY)
    assert_allclose(qp.solve(q, 0.0, ACCURACY).d, StageQp(nlp).solve(q, 0.0, ACCURACY).d, atol=SAME_STEP)


def test_delta_is_added_to_the_diagonal():
    nlp, q = dense_program(1)
    h, _ = matrices(q)
    more = replace(q, hessian=(h + 0.7 * np.eye(len(h)))[np.tril_indices(len(h))])
    steps = [StageQp(nlp).solve(*given, ACCURACY).d for given in ((q, 0.7), (more, 0.0))]
    assert_allclose(*steps, atol=SAME_STEP)


def contradiction(seed: int) -> tuple[SimpleNamespace, QuadraticProgram]:
    """A program whose first two equations ask two things of one direction."""
    nlp, q = dense_program(seed)
    _, j = matrices(q)
    j[1] = j[0]
    low, high = q.low.copy(), q.high.copy()
    low[1] = high[1] = low[0] + 1.0
    return nlp, replace(q, jacobian=j.ravel(), low=low, high=high)


@pytest.mark.parametrize("seed", range(3))
def test_elastic_programs_miss_as_little_as_a_linear_program_finds(seed):
    nlp, q = contradiction(seed)
    qp, (_, j) = StageQp(nlp), matrices(q)
    assert qp.solve(q, 0.0, ACCURACY).infeasible
    rows, n = j.shape
    slack = [np.hstack([sign * j, -np.eye(rows)]) for sign in (-1, 1)]
    limits = np.concatenate([-q.low, q.high])
    kept = np.isfinite(limits)
    least = linprog(
        np.concatenate([np.zeros(n), np.ones(rows)]), A_ub=np.vstack(slack)[kept], b_ub=limits[kept],
        bounds=[*zip(q.x_low, q.x_high, strict=True), *[(0, None)] * rows],
    ).fun  # fmt: skip
    step = qp.elastic(q, 1e-2, 1e-5, ACCURACY)
    assert step.solved
    assert step.missed == pytest.approx(least, rel=SAME_MISS)
    outside = np.maximum(0, np.maximum(q.low - j @ step.d, j @ step.d - q.high))
    assert outside.sum() == pytest.approx(step.missed, abs=SAME_STEP)


def test_elastic_program_of_a_feasible_one_misses_nothing():
    nlp, q = dense_program(2)
    qp = StageQp(nlp)
    step = qp.elastic(q, 0.0, 1e-2, ACCURACY)
    assert step.missed < SAME_STEP
    assert_allclose(step.d, qp.solve(q, 0.0, ACCURACY).d, atol=10 * SAME_STEP)


def test_filter_takes_what_improves_either_and_forbids_what_a_kept_pair_beats():
    known = Filter(1.0, 1e-9)
    here = FilterEntry(1.0, 5.0)
    taken = {
        FilterEntry(0.5, 9.0): True, FilterEntry(2.0, 4.0): True, FilterEntry(1.0, 5.0): False,
        FilterEntry(1.1, 5.1): False, FilterEntry(2e4, 0.0): False, FilterEntry(np.nan, 0.0): False,
        FilterEntry(0.5, np.nan): False, FilterEntry(0.5, np.inf): False,
    }  # fmt: skip
    assert {there: known.takes(here, there, slope=1.0, share=1.0) for there in taken} == taken
    known.keep(FilterEntry(0.5, 6.0))
    assert not known.takes(here, FilterEntry(0.6, 7.0), slope=1.0, share=1.0)
    assert known.takes(here, FilterEntry(0.4, 7.0), slope=1.0, share=1.0)
    assert known.takes(here, FilterEntry(0.6, 4.0), slope=1.0, share=1.0)


def test_filter_holds_a_step_about_the_objective_to_its_promise():
    known, here = Filter(1.0, 1e-9), FilterEntry(1e-8, 5.0)
    assert not known.takes(here, FilterEntry(0.0, 5.0 - 1e-6), slope=-1.0, share=1.0)
    assert known.takes(here, FilterEntry(1e-3, 4.5), slope=-1.0, share=1.0)


def test_kept_pairs_that_a_new_one_beats_are_dropped():
    known = Filter(1.0, 1e-9)
    for pair in (FilterEntry(1.0, 5.0), FilterEntry(0.5, 7.0), FilterEntry(0.4, 4.0)):
        known.keep(pair)
    assert len(known.pairs) == 1


# Whole solves


def sqp(prepared: PreparedProblem, x: np.ndarray | None = None, **given: object) -> Result:
    settings = {"options": {}, "callback": lambda *_: True, "warm": None, "stop": StoppingCriteria(), **given}
    start = prepared.guess if x is None else x
    order = ("stop", "options", "callback", "warm")
    return run_solver(prepared.nlp, start, "sqp", *(settings[name] for name in order))


def swing() -> Problem:
    """The arm against gravity: nonlinear, one joint."""
    costs = (TorqueCost(weight=1.0), VelocityCost(weight=0.1))
    return reach(gravity=True, terms=(*costs, EffortLimits(limit=np.array([11.0]))))


def ready(problem: Problem, **options: object) -> PreparedProblem:
    return prepare(problem, compile="none", **options)


def kkt(nlp: Nlp, x: np.ndarray, lam_g: np.ndarray, lam_x: np.ndarray) -> tuple[float, float, float]:
    """Primal, dual and complementarity errors from the engine's functions alone."""
    t = nlp.transcription
    g = nlp.engine.g(x)
    jacobian = sparse.csr_matrix((nlp.engine.jacobian(x), (nlp.row, nlp.column)), shape=(len(g), len(x)))
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


def test_after_a_small_change_a_start_from_the_solution_takes_fewer_steps():
    first = solve(lean(), solver="sqp", compile="none")
    changed = replace(lean(), initial_v=1.02 * lean().initial_v)
    cold, warm = (solve(changed, solver="sqp", compile="none", start=s) for s in (None, first))
    assert cold.success
    assert warm.success
    assert warm.meta["iterations"] < cold.meta["iterations"]
    assert warm.meta["objective"] == pytest.approx(cold.meta["objective"], rel=SAME_OBJECTIVE)


def test_contradicting_limits_are_reported_as_infeasible_near_their_least_violation():
    weak = reach(terms=(AccelerationCost(weight=1.0), EffortLimits(limit=np.array([0.05]))))
    solution = solve(weak, solver="sqp", compile="none")
    assert (solution.success, solution.meta["status"]) == (False, "infeasible")
    assert solution.meta["solver_status"] == "Infeasible"
    assert np.isfinite(solution.q).all()


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
    solution = solve(lean(), solver="sqp", compile="none", options={"early": EARLY})
    assert (solution.success, solution.meta["status"]) == (False, "early")
    assert "not optimal" in solution.meta["advice"]


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


def test_multipliers_that_are_wild_are_got_over():
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
    meta = solution.meta
    assert meta["quadratic_programs"] >= meta["iterations"] > 0
    assert meta["quadratic_program_iterations"] >= meta["quadratic_programs"]
    assert 0 < meta["quadratic_program_time_s"] <= meta["wall_time_s"]


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
