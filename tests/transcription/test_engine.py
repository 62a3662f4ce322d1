"""The engine against casadi: values and derivatives of grouped problems, and input it refuses."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.support.grouped_nlps import (
    GroupedProblem,
    arguments,
    cart_pole,
    dense,
    dense_jacobian,
    logarithm_well,
)
from trajopt import _engine

ROUNDING = 1e-12  # sums of the same terms in another order
STEP = 1e-6  # of central differences: error about STEP^2 + 1e-16 / STEP
DIFFERENCES = 1e-7


@pytest.fixture(scope="module")
def problem() -> GroupedProblem:
    return cart_pole()


@pytest.fixture(scope="module")
def nlp(problem):
    return _engine.Nlp(**arguments(problem))


@pytest.fixture
def point(problem):
    return problem.x0 + 0.3 * np.random.default_rng(3).standard_normal(problem.n_x)


def hessian(nlp, problem, x, sigma, lam):
    lower = dense((problem.n_x, problem.n_x), problem.patterns["hessian"], nlp.hessian(x, sigma, lam))
    return lower + np.tril(lower, -1).T


def difference_quotients(function, x):
    steps = STEP * np.eye(len(x))
    return np.stack([(function(x + d) - function(x - d)) / (2 * STEP) for d in steps], axis=-1)


def test_values_and_derivatives_are_those_of_one_expression(nlp, problem, point):
    e = problem.expression()
    lam, sigma = np.random.default_rng(4).standard_normal(problem.n_g), 0.7
    multiplier = ca.SX.sym("lam", problem.n_g)
    second = ca.hessian(sigma * e["f"] + ca.dot(multiplier, e["g"]), e["x"])[0]
    whole = ca.Function(
        "whole", [e["x"], multiplier],
        [e["f"], e["g"], ca.gradient(e["f"], e["x"]), ca.jacobian(e["g"], e["x"]), second],
    )  # fmt: skip
    f, g, gradient, first, second = (np.array(part) for part in whole(point, lam))
    assert_allclose(nlp.f(point), f.item(), rtol=ROUNDING)
    assert_allclose(nlp.g(point), g.ravel(), atol=ROUNDING)
    assert_allclose(nlp.gradient(point), gradient.ravel(), atol=ROUNDING)
    assert_allclose(dense_jacobian(nlp, problem, point), first, atol=ROUNDING)
    assert_allclose(hessian(nlp, problem, point, sigma, lam), second, atol=ROUNDING * 10)


def test_derivatives_are_limits_of_differences(nlp, problem, point):
    lam = np.random.default_rng(5).standard_normal(problem.n_g)
    assert_allclose(nlp.gradient(point), difference_quotients(nlp.f, point), atol=DIFFERENCES)
    assert_allclose(dense_jacobian(nlp, problem, point), difference_quotients(nlp.g, point), atol=DIFFERENCES)

    def slope(x):
        return 0.3 * nlp.gradient(x) + dense_jacobian(nlp, problem, x).T @ lam

    assert_allclose(
        hessian(nlp, problem, point, 0.3, lam), difference_quotients(slope, point), atol=DIFFERENCES
    )


def every_number(nlp, problem, x):
    lam = np.cos(np.arange(problem.n_g))
    return np.concatenate([[nlp.f(x)], nlp.g(x), nlp.gradient(x), nlp.jacobian(x), nlp.hessian(x, 0.9, lam)])


@pytest.mark.parametrize("threads", [2, 7, 64])
def test_threads_change_no_bit(nlp, problem, point, threads):
    parallel = _engine.Nlp(**arguments(problem, threads=threads))
    assert_array_equal(every_number(parallel, problem, point), every_number(nlp, problem, point))


def test_a_point_is_evaluated_once_a_kind(problem, point):
    nlp = _engine.Nlp(**arguments(problem))
    for _ in range(3):
        nlp.f(point), nlp.g(point), nlp.gradient(point), nlp.jacobian(point)
    assert {kind: count for kind, (_, count) in nlp.timings().items()} == {
        "value": 1,
        "first": 1,
        "second": 0,
    }
    nlp.f(point + 1e-3)
    assert nlp.timings()["value"][1] == 2


def changed(arguments, key, change):
    """A copy with one entry, of the NLP or of its first group, changed."""
    copy = {**arguments, "groups": [dict(group) for group in arguments["groups"]]}
    target = copy if key in copy else copy["groups"][0]
    target[key] = change(target[key])
    return copy


def test_groups_with_one_function_share_its_runs_and_change_no_number(problem, point):
    given = arguments(problem)
    half = np.arange(len(given["groups"][0]["x_offset"])) < 7
    by_stage = ("x_offset", "p", "cost_weight", "row", "jac_target", "hess_target")
    swing = given["groups"][0]
    parts = [
        {**swing, **{key: np.ascontiguousarray(swing[key][which]) for key in by_stage}}
        for which in (half, ~half)
    ]
    split = _engine.Nlp(**{**given, "groups": [*parts, given["groups"][1]]})
    assert_allclose(
        every_number(split, problem, point), every_number(_engine.Nlp(**given), problem, point), atol=ROUNDING
    )


def test_a_group_may_have_no_cost(problem, point):
    given = arguments(problem)
    z, p = ca.SX.sym("z", 5), ca.SX.sym("p", 1)
    phi = problem.groups[0].rows(z, p)
    none = ca.SX(1, 1)
    free = changed(given, "value", lambda _: _engine.Tape(ca.Function("value", [z, p], [none, phi])))
    first = ca.Function("first", [z, p], [none, phi, ca.SX(5, 1), ca.jacobian(phi, z)])
    nlp = _engine.Nlp(**changed(free, "first", lambda _: _engine.Tape(first)))
    goal, full = GroupedProblem(**{**vars(problem), "groups": problem.groups[1:]}), _engine.Nlp(**given)
    e = goal.expression()
    cost = ca.Function("cost", [e["x"]], [e["f"], ca.gradient(e["f"], e["x"])])
    assert_allclose(nlp.f(point), float(cost(point)[0]), rtol=ROUNDING)
    assert_allclose(nlp.gradient(point), np.array(cost(point)[1]).ravel(), atol=ROUNDING)
    assert_array_equal(nlp.jacobian(point), full.jacobian(point))


def test_the_first_number_that_is_not_finite_is_named(nlp, problem, point):
    assert nlp.first_nonfinite(point) is None
    well = logarithm_well()
    assert _engine.Nlp(**arguments(well)).first_nonfinite(np.array([0.0, 2.0])) == (0, 0, "cost", 0)
    point[5 * 3 + 1] = np.nan
    group, stage, output, _ = nlp.first_nonfinite(point)
    assert (group, stage, output) == (0, 3, "cost") or (group, stage, output) == (0, 3, "rows")


@pytest.mark.parametrize(
    ("key", "change"),
    [
        ("n_x", lambda _: 0),
        ("n_x", lambda _: "many"),
        ("threads", lambda _: 0),
        ("a_indptr", lambda v: v[:-1]),
        ("a_indices", lambda v: v + 1000),
        ("jac_const", lambda v: v[:-1]),
        ("jac_row", lambda v: v + 1000),
        ("hess_row", lambda v: v * 0),
        ("groups", lambda v: v[0]),
        ("x_offset", lambda v: v + 1000),
        ("gather_data", lambda v: v[:-1]),
        ("gather_indices", lambda v: v + 5),
        ("nloc", lambda _: 2.5),
        ("p", lambda v: v[:-1]),
        ("cost_weight", lambda v: v[:-1]),
        ("row", lambda v: v[:, :-1].copy()),
        ("row", lambda v: -v - 1),
        ("row_scale", lambda v: v[:-1]),
        ("jac_src", lambda v: v + 1000),
        ("jac_target", lambda v: v[:, :-1].copy()),
        ("hess_target", lambda v: v + 100000),
        ("value", lambda _: "not a tape"),
        ("value", lambda _: None),
        ("second", lambda _: _engine.Tape(ca.Function("second", [ca.SX.sym("z")], []))),
    ],
)
def test_wrong_input_is_refused_in_one_line_that_names_it(problem, key, change):
    with pytest.raises(ValueError, match=key) as refused:
        _engine.Nlp(**changed(arguments(problem), key, change))
    assert "\n" not in str(refused.value)


def test_a_missing_entry_is_refused_by_name(problem):
    given = arguments(problem)
    del given["hess_row"]
    with pytest.raises(ValueError, match="hess_row"):
        _engine.Nlp(**given)
