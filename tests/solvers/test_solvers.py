"""Solvers on transcribed problems: IPOPT and CasADi's own IPOPT agree; stops, options, threads."""

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.support.problems import hop, lean, reach
from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.solvers.drivers import SOLVERS, run_solver
from trajopt.solvers.ipopt import IPOPT_OPTIONS
from trajopt.solvers.result import StoppingCriteria
from trajopt.solvers.status import Status
from trajopt.solving.solving import PreparedProblem, prepare
from trajopt.terms import TorqueCost
from trajopt.transcription.transcription import Transcription

pytestmark = pytest.mark.long

# Two solvers that stop at a tolerance of 1e-6 agree on the objective to this.
AGREEMENT = 1e-4
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


def test_two_threads_give_the_numbers_of_one_to_the_last_bit():
    for one, two in zip(evaluations(prepared()), evaluations(prepared(threads=2)), strict=True):
        assert_array_equal(one, two)


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


@pytest.mark.parametrize("solver", SOLVERS)
def test_exception_in_a_callback_reaches_the_caller(solver):
    made = prepared()

    def fail(info: dict, _: Unknowns) -> bool:
        raise ZeroDivisionError(f"at iteration {info['iteration']}")

    with pytest.raises(ZeroDivisionError, match="at iteration 0"):
        run_solver(made.nlp, made.guess, solver, StoppingCriteria(), {}, fail)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("option", [{"no_such_option": 1}, {"max_iter": "many"}])
def test_unknown_option_or_value_is_refused_by_name(solver, option):
    made = prepared()
    with pytest.raises(InputError, match=f"{solver}.*'{next(iter(option))}'"):
        run_solver(made.nlp, made.guess, solver, StoppingCriteria(), option, go_on)


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
