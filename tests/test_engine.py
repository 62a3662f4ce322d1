"""The engine against casadi: derivatives of grouped problems, and solutions by IPOPT and FATROP."""

from __future__ import annotations

import subprocess
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from grouped_nlps import Group, GroupedProblem, arguments, cart_pole
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse

from trajopt import _engine

ROUNDING = 1e-12  # sums of the same terms in another order
STEP = 1e-6  # of central differences: error about STEP^2 + 1e-16 / STEP
DIFFERENCES = 1e-7
SOLVED = 1e-9  # tolerance asked of the solvers
SAME_SOLUTION = 1e-6
IPOPT = {"tol": SOLVED, "nlp_scaling_method": "none"}
FATROP = {"tolerance": SOLVED}


def logarithm_well() -> GroupedProblem:
    """Minimise (x - 3)^2 - log(1 - x), no number beyond x = 1, from where Newton's first step goes there."""
    y, none = ca.SX.sym("y"), ca.SX.sym("p", 0)
    well = Group(
        cost=ca.Function("L", [y, none], [(y - 3) ** 2 - ca.log(1 - y)]),
        rows=ca.Function("phi", [y, none], [ca.SX(0, 1)]),
        gather=sparse.csr_matrix([[1.0]]),
        offset=[1],
        row=np.zeros((1, 0), dtype=int),
        row_scale=np.zeros(0),
        weight=np.ones(1),
        p=np.zeros((1, 0)),
    )
    free = np.full(2, np.inf)
    return GroupedProblem(
        n_x=2, n_g=1, groups=[well], linear=sparse.csr_matrix([[-1.0, 1.0]]),
        lbx=-free, ubx=free, lbg=np.zeros(1), ubg=np.zeros(1), x0=np.array([-5.0, -5.0]),
        nx=np.ones(2, dtype=np.int32), nu=np.zeros(2, dtype=np.int32), ng=np.zeros(2, dtype=np.int32),
    )  # fmt: skip


WELL_OPTIMUM = 2 - np.sqrt(1.5)  # root of 2 (x - 3) (1 - x) + 1 below 1


@pytest.fixture(scope="module")
def problem() -> GroupedProblem:
    return cart_pole()


@pytest.fixture(scope="module")
def nlp(problem):
    return _engine.Nlp(**arguments(problem))


@pytest.fixture
def point(problem):
    return problem.x0 + 0.3 * np.random.default_rng(3).standard_normal(problem.n_x)


def solve_ipopt(nlp, problem, options=None, callback=None, **start):
    bounds = (problem.lbx, problem.ubx, problem.lbg, problem.ubg)
    return _engine.solve_ipopt(nlp, problem.x0, *bounds, {**IPOPT, **(options or {})}, callback, **start)


def solve_fatrop(nlp, problem, options=None, callback=None, **start):
    bounds = (problem.lbx, problem.ubx, problem.lbg, problem.ubg)
    sizes = (problem.nx, problem.nu, problem.ng)
    return _engine.solve_fatrop(
        nlp, *sizes, problem.x0, *bounds, {**FATROP, **(options or {})}, callback, **start
    )


SOLVERS = {"ipopt": solve_ipopt, "fatrop": solve_fatrop}
STOPPED = {"ipopt": "User_Requested_Stop", "fatrop": "UserRequestedStop"}


@pytest.fixture(params=SOLVERS)
def solver(request):
    return request.param


def dense(shape, place, values):
    matrix = np.zeros(shape)
    np.add.at(matrix, place, values)
    return matrix


def jacobian(nlp, problem, x):
    return dense((problem.n_g, problem.n_x), problem.patterns["jacobian"], nlp.jacobian(x))


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
    assert_allclose(jacobian(nlp, problem, point), first, atol=ROUNDING)
    assert_allclose(hessian(nlp, problem, point, sigma, lam), second, atol=ROUNDING * 10)


def test_derivatives_are_limits_of_differences(nlp, problem, point):
    lam = np.random.default_rng(5).standard_normal(problem.n_g)
    assert_allclose(nlp.gradient(point), difference_quotients(nlp.f, point), atol=DIFFERENCES)
    assert_allclose(jacobian(nlp, problem, point), difference_quotients(nlp.g, point), atol=DIFFERENCES)

    def slope(x):
        return 0.3 * nlp.gradient(x) + jacobian(nlp, problem, x).T @ lam

    assert_allclose(
        hessian(nlp, problem, point, 0.3, lam), difference_quotients(slope, point), atol=DIFFERENCES
    )


def every_number(nlp, problem, x):
    lam = np.cos(np.arange(problem.n_g))
    return np.concatenate([[nlp.f(x)], nlp.g(x), nlp.gradient(x), nlp.jacobian(x), nlp.hessian(x, 0.9, lam)])


def test_compiled_functions_give_the_numbers_of_the_virtual_machine(nlp, problem, point, tmp_path):
    compiled = _engine.Nlp(**arguments(problem, tmp_path))
    assert_allclose(every_number(compiled, problem, point), every_number(nlp, problem, point), atol=ROUNDING)


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


def test_solutions_and_multipliers_are_those_of_casadi(nlp, problem, solver):
    options = {"ipopt": {"tol": SOLVED, "print_level": 0, "sb": "yes"}, "print_time": False}
    reference = ca.nlpsol("reference", "ipopt", problem.expression(), options)
    expected = reference(x0=problem.x0, lbx=problem.lbx, ubx=problem.ubx, lbg=problem.lbg, ubg=problem.ubg)
    result = SOLVERS[solver](nlp, problem)
    assert result["status"] in ("Solve_Succeeded", "Success")
    assert_allclose(result["f"], float(expected["f"]), atol=SAME_SOLUTION)
    for key in ("x", "g", "lam_g", "lam_x"):
        assert_allclose(result[key], np.array(expected[key]).ravel(), atol=SAME_SOLUTION, err_msg=key)
    for key in ("primal", "dual", "complementarity", "max_violation"):
        assert result[key] < 10 * SOLVED, key


def test_a_solution_is_stationary_with_its_multipliers(nlp, problem, solver):
    result = SOLVERS[solver](nlp, problem)
    slope = (
        nlp.gradient(result["x"]) + jacobian(nlp, problem, result["x"]).T @ result["lam_g"] + result["lam_x"]
    )
    assert_allclose(slope, 0, atol=10 * SOLVED)


def test_solving_with_compiled_functions_and_threads_ends_at_the_same_point(nlp, problem, solver, tmp_path):
    compiled = _engine.Nlp(**arguments(problem, tmp_path, threads=2))
    expected = SOLVERS[solver](nlp, problem)["x"]
    assert_allclose(SOLVERS[solver](compiled, problem)["x"], expected, atol=SAME_SOLUTION)


def test_nothing_is_printed(nlp, problem, solver, capfd):
    SOLVERS[solver](nlp, problem)
    assert capfd.readouterr() == ("", "")


def test_the_solver_of_casadi_prints_after_ours_has_run(nlp, problem, capfd):
    solve_fatrop(nlp, problem)
    x = ca.SX.sym("x")
    ca.nlpsol("own", "fatrop", {"x": x, "f": (x - 1) ** 2}, {"structure_detection": "none"})(x0=0)
    assert "inf_pr" in capfd.readouterr().out


def test_every_iteration_is_reported(nlp, problem, solver):
    seen = []
    result = SOLVERS[solver](nlp, problem, callback=seen.append)
    numbers = [info["iteration"] for info in seen]
    assert numbers == list(range(len(seen)))
    assert numbers[-1] == result["iterations"]
    assert_allclose([seen[-1]["objective"], seen[-1]["primal"]], [result["f"], 0], atol=SAME_SOLUTION)
    names = "iteration objective primal dual barrier step regularization line_search restoration"
    assert set(seen[0]) == set(names.split())


def test_stopping_returns_the_current_iterate(nlp, problem, solver):
    seen = []

    def stop_at_the_fifth(info):
        seen.append(info)
        return info["iteration"] < 5

    result = SOLVERS[solver](nlp, problem, callback=stop_at_the_fifth)
    assert result["status"] == STOPPED[solver]
    assert result["iterations"] == 5 == seen[-1]["iteration"]
    assert_allclose(result["f"], seen[-1]["objective"], rtol=ROUNDING)
    assert np.abs(result["x"] - problem.x0).max() > 0.1


def test_an_exception_in_the_callback_is_raised_after_the_solver_has_stopped(nlp, problem, solver):
    calls = []

    def fail(info):
        calls.append(info)
        raise LookupError("from the callback")

    with pytest.raises(LookupError, match="from the callback"):
        SOLVERS[solver](nlp, problem, callback=fail)
    assert len(calls) == 1


def test_an_interrupt_from_the_keyboard_keeps_the_iterate(nlp, problem, solver):
    def interrupt(info):
        if info["iteration"] == 3:
            raise KeyboardInterrupt

    result = SOLVERS[solver](nlp, problem, callback=interrupt)
    assert (result["status"], result["iterations"]) == (STOPPED[solver], 3)


@pytest.mark.parametrize("options", [{"no_such_option": 1}, {"max_iter": "many"}, {"mu_init": "small"}])
def test_a_wrong_option_is_refused_by_name(nlp, problem, solver, options):
    with pytest.raises(ValueError, match=f"'{next(iter(options))}'"):
        SOLVERS[solver](nlp, problem, options)


def test_an_iteration_limit_is_reported(nlp, problem, solver):
    result = SOLVERS[solver](nlp, problem, {"max_iter": 3})
    assert result["status"] in ("Maximum_Iterations_Exceeded", "MaxIterExceeded")
    assert result["iterations"] in (3, 4)  # FATROP looks at its limit one step late


def test_a_time_limit_is_reported(nlp, problem, solver):
    result = SOLVERS[solver](nlp, problem, {"max_wall_time": 1e-6})
    assert result["status"] in ("Maximum_WallTime_Exceeded", "MaxWallTimeExceeded")


def test_ipopt_starts_warm_from_multipliers(nlp, problem):
    solution = solve_ipopt(nlp, problem)
    again = GroupedProblem(**{**vars(problem), "x0": solution["x"]})
    start = {"lam_g0": solution["lam_g"], "lam_x0": solution["lam_x"]}
    close = {"mu_init": 1e-9, "warm_start_bound_push": 1e-9, "warm_start_mult_bound_push": 1e-9}
    assert solve_ipopt(nlp, again, close, **start)["iterations"] <= 3 < solution["iterations"]


def test_fatrop_starts_from_given_multipliers(nlp, problem):
    solution = solve_fatrop(nlp, problem)
    residual = {}
    for name, lam in {"own": None, "given": solution["lam_g"]}.items():
        start = GroupedProblem(**{**vars(problem), "x0": solution["x"]})
        first = []
        solve_fatrop(nlp, start, {"mu_init": 1e-9}, lambda info, first=first: first.append(info), lam_g0=lam)
        residual[name] = first[0]["dual"]
    assert residual["given"] != residual["own"]


def test_a_step_out_of_the_domain_is_taken_back(solver):
    problem = logarithm_well()
    nlp = _engine.Nlp(**arguments(problem))
    result = SOLVERS[solver](nlp, problem)
    assert result["status"] in ("Solve_Succeeded", "Success")
    assert_allclose(result["x"], WELL_OPTIMUM, atol=SAME_SOLUTION)


def test_a_start_out_of_the_domain_is_reported(solver):
    problem = logarithm_well()
    problem.x0[:] = 2.0
    result = SOLVERS[solver](_engine.Nlp(**arguments(problem)), problem)
    assert result["status"] in ("Invalid_Number_Detected", "InvalidNumber")


def changed(arguments, key, change):
    """A copy with one entry, of the NLP or of its first group, changed."""
    copy = {**arguments, "groups": [dict(group) for group in arguments["groups"]]}
    target = copy if key in copy else copy["groups"][0]
    target[key] = change(target[key])
    return copy


def test_an_evaluation_that_fails_gives_no_number(tmp_path):
    well = logarithm_well()
    given = arguments(well, tmp_path)
    library, name = given["groups"][0]["value"]
    source = Path(library).with_suffix(".c")
    entry = f"{name}(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem){{"
    code = source.read_text()
    assert code.count(entry) == 1
    source.write_text(code.replace(entry, entry + " return 1;"))
    failing = str(tmp_path / "failing.so")
    subprocess.run(["gcc", "-fPIC", "-shared", "-w", str(source), "-o", failing, "-lm"], check=True)
    given["groups"][0]["value"] = (failing, name)
    assert np.isnan(_engine.Nlp(**given).f(well.x0))


def test_a_group_may_have_no_cost(problem, point):
    given = arguments(problem)
    z, p = ca.SX.sym("z", 5), ca.SX.sym("p", 1)
    phi = problem.groups[0].rows(z, p)
    none = ca.SX(1, 1)
    free = changed(given, "value", lambda _: ca.Function("value", [z, p], [none, phi]).serialize())
    first = ca.Function("first", [z, p], [none, phi, ca.SX(5, 1), ca.jacobian(phi, z)]).serialize()
    nlp = _engine.Nlp(**changed(free, "first", lambda _: first))
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
        ("value", lambda _: "not a function"),
        ("value", lambda _: ("/no/such/library.so", "value")),
        ("value", lambda _: 3),
        ("second", lambda v: ca.Function("second", [ca.SX.sym("z")], []).serialize()),
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


def test_vectors_of_wrong_size_are_refused(nlp, problem, solver):
    with pytest.raises(ValueError, match="x has a wrong size"):
        nlp.f(problem.x0[:-1])
    for key in ("x0", "lbx", "ubg"):
        wrong = GroupedProblem(**{**vars(problem), key: vars(problem)[key][:-1]})
        with pytest.raises(ValueError, match="x" if key != "ubg" else "ubg"):
            SOLVERS[solver](nlp, wrong)
    with pytest.raises(ValueError, match="lam_g0"):
        SOLVERS[solver](nlp, problem, lam_g0=np.ones(2))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"nu": np.ones(21, dtype=np.int32)}, "unknowns"),
        ({"ng": np.full(21, 2, dtype=np.int32)}, "rows"),
        ({"nu": np.ones(3, dtype=np.int32)}, "one entry a stage"),
        ({"lbg": np.full(101, -1.0)}, "closes a gap"),
        ({"lbx": np.full(104, 100.0)}, "lower bound is above"),
    ],
)
def test_fatrop_refuses_a_structure_that_is_not_the_problems(nlp, problem, change, message):
    with pytest.raises(ValueError, match=message):
        solve_fatrop(nlp, GroupedProblem(**{**vars(problem), **change}))


def test_fatrop_refuses_a_gap_row_without_the_identity():
    problem = cart_pole()
    problem.linear = 2 * problem.linear
    with pytest.raises(ValueError, match="gap row 0 of stage 0"):
        solve_fatrop(_engine.Nlp(**arguments(problem)), problem)


def test_fatrop_reports_an_infeasible_problem(nlp, problem):
    stuck = GroupedProblem(**{**vars(problem), "lbg": problem.lbg.copy(), "ubg": problem.ubg.copy()})
    stuck.lbg[-1], stuck.ubg[-1] = -8.0, -7.0  # the sine of an angle, doubled
    seen = []
    result = solve_fatrop(nlp, stuck, callback=seen.append)
    assert result["status"] in ("LocalInfeasibility", "LineSearchFailed", "ErrorInStepComputation")
    assert any(info["restoration"] for info in seen)
    assert result["max_violation"] > 1
