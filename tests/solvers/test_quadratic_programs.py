"""The quadratic programs of the SQP against another solver, and its filter."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import osqp
import pytest
from numpy.testing import assert_allclose
from scipy import sparse
from scipy.optimize import linprog

from trajopt.solvers.qp import QpStep, QuadraticProgram, StageQp
from trajopt.solvers.sqp_filter import Filter, FilterEntry

# Accuracy asked of programs, and what two solvers of one program agree to, of entries of order one.
ACCURACY = 1e-9
SAME_STEP = 1e-5
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
