"""Solvers on transcribed problems: agreement with CasADi, stops, options, threads, the elastic problem."""

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.support.problems import REACH, REACH_TIME, hop, inertia, lean, limited_reach, reach
from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.solvers.drivers import SOLVERS, run_solver
from trajopt.solvers.elastic import CLEAR_VIOLATION, REMOVABLE_VIOLATION, least_violation
from trajopt.solvers.ipopt import IPOPT_OPTIONS
from trajopt.solvers.result import StoppingCriteria
from trajopt.solvers.status import Status
from trajopt.solving.solving import PreparedProblem, prepare
from trajopt.solving.stalling import DECREASE, DUAL_LIMIT, START, TAIL, VIOLATION, WINDOW, is_stalled
from trajopt.terms import TorqueCost
from trajopt.transcription.guess import perturbed
from trajopt.transcription.transcription import Transcription
from trajopt.transcription.violations import row_violations

# The same solver on the same functions, at a tolerance of 1e-9.
SAME_OPTIMUM = 1e-6


Unknowns = Callable[[], np.ndarray]


def go_on(_: dict, __: Unknowns) -> bool:
    return True


def prepared(threads: int = 1) -> PreparedProblem:
    return prepare(hop(), transcription="legendre:2", intervals=7, threads=threads)


def evaluations(made: PreparedProblem) -> list[np.ndarray]:
    generator, nlp = np.random.default_rng(0), made.nlp.engine
    x = made.guess + generator.uniform(-0.2, 0.2, made.guess.shape)
    multipliers = generator.uniform(-1, 1, made.transcription.n_rows)
    return [
        np.array([nlp.f(x)]),
        nlp.g(x),
        nlp.gradient(x),
        nlp.jacobian(x),
        nlp.hessian(x, 0.5, multipliers),
    ]


@pytest.mark.long
def test_two_threads_give_the_numbers_of_one_to_the_last_bit():
    for one, two in zip(evaluations(prepared()), evaluations(prepared(threads=2)), strict=True):
        assert_array_equal(one, two)


@pytest.mark.long
@pytest.mark.parametrize("solver", SOLVERS)
def test_callback_that_says_stop_returns_the_iterate_of_that_moment(solver):
    made, seen = prepared(), []

    def stop_at_three(info: dict, _: Unknowns) -> bool:
        seen.append(info)
        return info["iteration"] < 3

    result = run_solver(made.nlp, made.guess, solver, StoppingCriteria(), {}, stop_at_three)
    assert result.status is Status.INTERRUPTED
    assert result.iterations == seen[-1]["iteration"] == 3
    assert np.max(np.abs(result.x - made.guess)) > 0
    assert made.nlp.engine.f(result.x) == pytest.approx(seen[-1]["objective"])


@pytest.mark.long
@pytest.mark.parametrize("solver", SOLVERS)
def test_exception_in_a_callback_reaches_the_caller(solver):
    made = prepared()

    def fail(info: dict, _: Unknowns) -> bool:
        raise ZeroDivisionError(f"at iteration {info['iteration']}")

    with pytest.raises(ZeroDivisionError, match="at iteration 0"):
        run_solver(made.nlp, made.guess, solver, StoppingCriteria(), {}, fail)


@pytest.mark.long
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("option", [{"no_such_option": 1}, {"max_iter": "many"}])
def test_unknown_option_or_value_is_refused_by_name(solver, option):
    made = prepared()
    with pytest.raises(InputError, match=f"{solver}.*'{next(iter(option))}'"):
        run_solver(made.nlp, made.guess, solver, StoppingCriteria(), option, go_on)


@pytest.mark.long
@pytest.mark.parametrize("solver", SOLVERS)
def test_iteration_limit_is_a_status(solver):
    made = prepared()
    result = run_solver(made.nlp, made.guess, solver, StoppingCriteria(max_iterations=2), {}, go_on)
    assert result.status is Status.ITERATION_LIMIT
    assert result.iterations <= 3


def symbolic(t: Transcription) -> tuple[ca.MX, ca.MX, ca.MX]:
    """Unknowns, objective and rows of a transcription as one CasADi expression, from its groups."""
    x = ca.MX.sym("x", t.layout.n_unknowns)
    cost, rows = ca.MX(0), ca.mtimes(ca.sparsify(ca.DM(t.linear.toarray())), x)
    for group in t.groups:
        for i, stage in enumerate(group.stages):
            offset = int(t.layout.node_offset[stage])
            z = ca.mtimes(
                ca.sparsify(ca.DM(group.gather.toarray())), x[offset : offset + group.gather.shape[1]]
            )
            o = z
            for layer in group.point.layers:
                o = layer(o)
            value, phi = group.point.terms(z, o if group.point.layers else ca.MX(0, 1), group.parameters[i])
            cost += group.cost_weight[i] * value
            if len(group.row_scale):
                place = ca.DM.zeros(t.n_rows, len(group.row_scale))
                for j, row in enumerate(group.rows[i]):
                    place[int(row), j] = group.row_scale[j]
                rows += ca.mtimes(ca.sparsify(place), phi)
    return x, cost, rows


def swing_up() -> Problem:
    """The arm against gravity."""
    return reach(gravity=True, terms=(TorqueCost(weight=1.0),))


@pytest.mark.long
@pytest.mark.parametrize("build", [swing_up, lean])
def test_optimum_is_that_of_casadi_on_the_same_functions(build):
    made = prepare(build(), transcription="legendre:2", intervals=4)
    t = made.transcription
    x, f, g = symbolic(t)
    options = {"print_time": False, "ipopt": {**IPOPT_OPTIONS, "tol": 1e-9}}
    reference = ca.nlpsol("reference", "ipopt", {"x": x, "f": f, "g": g}, options)
    bounds = {"lbx": t.lower_x, "ubx": t.upper_x, "lbg": t.lower_g, "ubg": t.upper_g}
    expected = reference(x0=made.guess, **bounds)
    assert reference.stats()["success"]
    result = run_solver(made.nlp, made.guess, "ipopt", StoppingCriteria(tolerance=1e-9), {}, go_on)
    assert result.status is Status.SOLVED
    assert result.objective == pytest.approx(float(expected["f"]), rel=SAME_OPTIMUM)


SMALL = 1.0


def test_rows_that_stay_violated_under_growing_multipliers_are_no_progress():
    n = START + 1
    assert is_stalled([1.0] * n, [SMALL] * (n - TAIL) + [2 * DUAL_LIMIT] * TAIL)


def test_multipliers_must_be_large_in_all_of_the_last_iterations():
    n = START + 1
    assert not is_stalled([1.0] * n, [SMALL] * (n - TAIL) + [2 * DUAL_LIMIT] * (TAIL - 1) + [SMALL])


def test_few_iterations_give_no_verdict():
    assert not is_stalled([1.0] * START, [2 * DUAL_LIMIT] * START)
    assert not is_stalled([], [])


def test_rows_that_hold_are_feasible_whatever_the_multipliers():
    assert not is_stalled([1.0] * 30 + [VIOLATION], [2 * DUAL_LIMIT] * 31)


@pytest.mark.parametrize(("after", "stalled"), [(0.9 * DECREASE, False), (1.1 * DECREASE, True)])
def test_the_best_violation_must_fall_by_a_factor(after, stalled):
    slowly = [1.0] + [after] * WINDOW
    assert is_stalled(slowly, [SMALL] * len(slowly)) is stalled


def test_an_increase_after_a_better_iterate_does_not_count_as_a_fall():
    rising = [0.1] + [1.0] * WINDOW
    assert is_stalled(rising, [SMALL] * len(rising))


LIMITS = {"max_iterations": 200, "max_time": 60.0}
# Least torque for the reach: full torque one way, then the other.
LEAST_TORQUE = 4 * inertia() * REACH / REACH_TIME**2
# What the barrier of the elastic problem leaves of each row.
BARRIER = 1e-3


def test_feasible_point_is_found_from_a_start_far_away():
    prepared = prepare(hop())
    start = perturbed(prepared.transcription, prepared.guess, 1, 0.3)
    assert row_violations(prepared.nlp, start).max() > CLEAR_VIOLATION
    found = least_violation(prepared.nlp, start, go_on, **LIMITS)
    assert found.feasible
    assert not found.infeasible
    assert row_violations(prepared.nlp, found.x).max() <= REMOVABLE_VIOLATION


@pytest.mark.parametrize("share", [0.5, 0.8])
def test_torque_below_the_least_is_certified_and_a_larger_one_is_not(share):
    prepared = prepare(limited_reach(share * LEAST_TORQUE))
    found = least_violation(prepared.nlp, prepared.guess, go_on, **LIMITS)
    assert found.infeasible
    assert not found.feasible
    enough = prepare(limited_reach(1.5 * LEAST_TORQUE))
    assert least_violation(enough.nlp, enough.guess, go_on, **LIMITS).feasible


def test_rows_give_way_by_what_they_lack_and_prices_bound_the_multipliers():
    prepared = prepare(limited_reach(0.5 * LEAST_TORQUE))
    found = least_violation(prepared.nlp, prepared.guess, go_on, **LIMITS)
    missed = row_violations(prepared.nlp, found.x)[: prepared.transcription.n_rows]
    assert np.all(missed <= found.gives + BARRIER)
    rows = found.weights[: len(missed)]
    assert np.abs(rows).max() <= 1 + BARRIER
    assert np.abs(rows).max() == pytest.approx(1, abs=BARRIER)


def test_limits_and_the_callback_stop_it_without_a_verdict():
    prepared = prepare(limited_reach(0.5 * LEAST_TORQUE))
    short = least_violation(prepared.nlp, prepared.guess, go_on, max_iterations=3, max_time=60.0)
    assert short.iterations <= 3
    assert not short.stopped
    stopped = least_violation(
        prepared.nlp, prepared.guess, lambda figures, _: figures["iteration"] < 2, **LIMITS
    )
    assert stopped.stopped
    for found in (short, stopped):
        assert not found.infeasible
        assert not found.feasible


def test_variables_that_a_callback_reads_are_those_of_the_problem():
    prepared = prepare(limited_reach(0.5 * LEAST_TORQUE))
    sizes = set()

    def look(_, read):
        sizes.add(len(read()))
        return True

    least_violation(prepared.nlp, prepared.guess, look, **LIMITS)
    assert sizes == {len(prepared.guess)}
