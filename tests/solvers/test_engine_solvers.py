"""The engine's solvers: solutions, options, callbacks, refusals, and adversity."""

import ctypes
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.support.grouped_nlps import GroupedProblem, arguments, cart_pole, dense_jacobian, logarithm_well
from trajopt import _engine

ROUNDING = 1e-12  # sums of the same terms in another order
SOLVED = 1e-9  # tolerance asked of the solvers
SAME_SOLUTION = 1e-6
IPOPT = {"tol": SOLVED, "nlp_scaling_method": "none"}
WELL_OPTIMUM = 2 - np.sqrt(1.5)  # root of 2 (x - 3) (1 - x) + 1 below 1


@pytest.fixture(scope="module")
def problem() -> GroupedProblem:
    return cart_pole()


@pytest.fixture(scope="module")
def nlp(problem):
    return _engine.Nlp(**arguments(problem))


def solve_ipopt(nlp, problem, options=None, callback=None, **start):
    bounds = (problem.lbx, problem.ubx, problem.lbg, problem.ubg)
    return _engine.solve_ipopt(nlp, problem.x0, *bounds, {**IPOPT, **(options or {})}, callback, **start)


def test_solutions_and_multipliers_are_those_of_casadi(nlp, problem):
    options = {"ipopt": {"tol": SOLVED, "print_level": 0, "sb": "yes"}, "print_time": False}
    reference = ca.nlpsol("reference", "ipopt", problem.expression(), options)
    expected = reference(x0=problem.x0, lbx=problem.lbx, ubx=problem.ubx, lbg=problem.lbg, ubg=problem.ubg)
    result = solve_ipopt(nlp, problem)
    assert result["status"] == "Solve_Succeeded"
    assert_allclose(result["f"], float(expected["f"]), atol=SAME_SOLUTION)
    for key in ("x", "g", "lam_g", "lam_x"):
        assert_allclose(result[key], np.array(expected[key]).ravel(), atol=SAME_SOLUTION, err_msg=key)
    for key in ("primal", "dual", "complementarity", "max_violation"):
        assert result[key] < 10 * SOLVED, key


def test_a_solution_is_stationary_with_its_multipliers(nlp, problem):
    result = solve_ipopt(nlp, problem)
    slope = (
        nlp.gradient(result["x"])
        + dense_jacobian(nlp, problem, result["x"]).T @ result["lam_g"]
        + result["lam_x"]
    )
    assert_allclose(slope, 0, atol=10 * SOLVED)


def test_solving_with_threads_ends_at_the_same_point(nlp, problem):
    parallel = _engine.Nlp(**arguments(problem, threads=2))
    expected = solve_ipopt(nlp, problem)["x"]
    assert_allclose(solve_ipopt(parallel, problem)["x"], expected, atol=SAME_SOLUTION)


def test_nothing_is_printed(nlp, problem, capfd):
    solve_ipopt(nlp, problem)
    assert capfd.readouterr() == ("", "")


def keeping(seen):
    return lambda info, _: seen.append(info)


def test_the_variables_of_every_iteration_are_available(nlp, problem):
    seen, iterates, kept = [], [], []

    def look(info, unknowns):
        seen.append(info["objective"])
        iterates.append(unknowns())
        kept.append(unknowns)

    result = solve_ipopt(nlp, problem, callback=look)
    assert_allclose([nlp.f(x) for x in iterates], seen, rtol=ROUNDING)
    assert_allclose(iterates[-1], result["x"], rtol=ROUNDING, atol=ROUNDING)
    with pytest.raises(RuntimeError, match="during its callback only"):
        kept[-1]()


def test_every_iteration_is_reported(nlp, problem):
    seen = []
    result = solve_ipopt(nlp, problem, callback=keeping(seen))
    numbers = [info["iteration"] for info in seen]
    assert numbers == list(range(len(seen)))
    assert numbers[-1] == result["iterations"]
    assert_allclose([seen[-1]["objective"], seen[-1]["primal"]], [result["f"], 0], atol=SAME_SOLUTION)
    names = "iteration objective primal dual barrier step regularization line_search restoration"
    assert set(seen[0]) == set(names.split())


def test_stopping_returns_the_current_iterate(nlp, problem):
    seen = []

    def stop_at_the_fifth(info, unknowns):
        seen.append(info)
        return info["iteration"] < 5

    result = solve_ipopt(nlp, problem, callback=stop_at_the_fifth)
    assert result["status"] == "User_Requested_Stop"
    assert result["iterations"] == 5 == seen[-1]["iteration"]
    assert_allclose(result["f"], seen[-1]["objective"], rtol=ROUNDING)
    assert np.abs(result["x"] - problem.x0).max() > 0.1


def test_an_exception_in_the_callback_is_raised_after_the_solver_has_stopped(nlp, problem):
    calls = []

    def fail(info, unknowns):
        calls.append(info)
        raise LookupError("from the callback")

    with pytest.raises(LookupError, match="from the callback"):
        solve_ipopt(nlp, problem, callback=fail)
    assert len(calls) == 1


def test_an_interrupt_from_the_keyboard_keeps_the_iterate(nlp, problem):
    def interrupt(info, unknowns):
        if info["iteration"] == 3:
            raise KeyboardInterrupt

    result = solve_ipopt(nlp, problem, callback=interrupt)
    assert (result["status"], result["iterations"]) == ("User_Requested_Stop", 3)


@pytest.mark.parametrize("options", [{"no_such_option": 1}, {"max_iter": "many"}, {"mu_init": "small"}])
def test_a_wrong_option_is_refused_by_name(nlp, problem, options):
    with pytest.raises(ValueError, match=f"'{next(iter(options))}'"):
        solve_ipopt(nlp, problem, options)


def test_an_iteration_limit_is_reported(nlp, problem):
    result = solve_ipopt(nlp, problem, {"max_iter": 3})
    assert result["status"] == "Maximum_Iterations_Exceeded"
    assert result["iterations"] == 3


def test_a_time_limit_is_reported(nlp, problem):
    result = solve_ipopt(nlp, problem, {"max_wall_time": 1e-6})
    assert result["status"] == "Maximum_WallTime_Exceeded"


def test_ipopt_starts_warm_from_multipliers(nlp, problem):
    solution = solve_ipopt(nlp, problem)
    again = GroupedProblem(**{**vars(problem), "x0": solution["x"]})
    start = {"lam_g0": solution["lam_g"], "lam_x0": solution["lam_x"]}
    close = {"mu_init": 1e-9, "warm_start_bound_push": 1e-9, "warm_start_mult_bound_push": 1e-9}
    assert solve_ipopt(nlp, again, close, **start)["iterations"] <= 3 < solution["iterations"]


def test_a_step_out_of_the_domain_is_taken_back():
    problem = logarithm_well()
    nlp = _engine.Nlp(**arguments(problem))
    result = solve_ipopt(nlp, problem)
    assert result["status"] == "Solve_Succeeded"
    assert_allclose(result["x"], WELL_OPTIMUM, atol=SAME_SOLUTION)


def test_a_start_out_of_the_domain_is_reported():
    problem = logarithm_well()
    problem.x0[:] = 2.0
    result = solve_ipopt(_engine.Nlp(**arguments(problem)), problem)
    assert result["status"] == "Invalid_Number_Detected"


def test_vectors_of_wrong_size_are_refused(nlp, problem):
    with pytest.raises(ValueError, match="x has a wrong size"):
        nlp.f(problem.x0[:-1])
    for key in ("x0", "lbx", "ubg"):
        wrong = GroupedProblem(**{**vars(problem), key: vars(problem)[key][:-1]})
        with pytest.raises(ValueError, match="x" if key != "ubg" else "ubg"):
            solve_ipopt(nlp, wrong)
    with pytest.raises(ValueError, match="lam_g0"):
        solve_ipopt(nlp, problem, lam_g0=np.ones(2))


def test_solves_use_one_thread_of_blas(nlp, problem):
    loaded = Path(ca.__file__).parent / "libcasadi-tp-openblas.so.0"
    if not loaded.exists():
        pytest.skip("the wheel of casadi brings no such OpenBLAS here")
    blas = ctypes.CDLL(str(loaded))
    blas.openblas_set_num_threads(2)
    solve_ipopt(nlp, problem)
    assert blas.openblas_get_num_threads() == 1


def test_linear_systems_are_counted_and_timed(nlp, problem):
    result = solve_ipopt(nlp, problem, stage=np.zeros(len(problem.x0), dtype=np.int32))
    timings = result["timings"]
    seconds, factorizations = timings["factorization"]
    assert factorizations >= result["iterations"]
    assert timings["substitution"][1] >= 2 * result["iterations"]  # the step, and its refinement
    assert 0 < seconds <= result["wall_time"]
    n = len(problem.x0) + len(problem.lbg)  # in one dense front at most
    most = factorizations * n**3 + timings["substitution"][1] * 4 * n**2
    assert 0 < result["operations"] < most
    assert solve_ipopt(nlp, problem)["operations"] == 0  # MUMPS' systems


@pytest.mark.parametrize(("n", "depth"), [(0, 1), (1, 0), (1025, 1)])
def test_products_of_other_sizes_are_refused(n, depth):
    with pytest.raises(ValueError, match="1 to 1024"):
        _engine.product_rate(n, depth)
    assert _engine.product_rate(8, 8) > 0


ROOT = Path(__file__).parents[2]
OPTIONS = {"tol": 1e-9, "nlp_scaling_method": "none", "print_level": 0, "sb": "yes"}
# In a process of its own: threads beyond what its memory has room for.
MANY_THREADS = """
import resource, sys
import numpy as np
from trajopt import _engine
n = 8
stage, diagonal = np.arange(n, dtype=np.int32) % 2, np.arange(n, dtype=np.int32)
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 2**28, used + 2**28))
x, negative = _engine.solve_kkt(n, 0, 0, stage, diagonal, diagonal, np.full(n, 2.0), np.ones(n), 20000)
assert np.allclose(x, 0.5) and negative == 0
"""


def solve(nlp, problem, callback=None):
    bounds = (problem.lbx, problem.ubx, problem.lbg, problem.ubg)
    return _engine.solve_ipopt(nlp, problem.x0, *bounds, OPTIONS, callback)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits memory as Linux does")
@pytest.mark.skipif("TRAJOPT_ENGINE" in os.environ, reason="AddressSanitizer maps terabytes")
def test_threads_that_cannot_start_are_done_without():
    done = subprocess.run([sys.executable, "-c", MANY_THREADS], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


def test_an_nlp_takes_more_threads_than_it_has_work_for():
    problem = cart_pole()
    alone, many = (_engine.Nlp(**arguments(problem, threads=threads)) for threads in (1, 20000))
    assert_array_equal(many.jacobian(problem.x0), alone.jacobian(problem.x0))


@pytest.mark.long
@pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
def test_what_a_thread_throws_is_of_its_run_alone(tmp_path):
    program = tmp_path / "team"
    sources = [ROOT / "tests" / "solvers" / "team.cpp", ROOT / "trajopt" / "solvers" / "engine" / "team.cpp"]
    subprocess.run(["g++", "-std=c++17", "-pthread", *sources, "-o", program], check=True, timeout=300)
    done = subprocess.run([program], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout) == (0, "")


def test_two_threads_may_use_one_nlp():
    problem = cart_pole()
    nlp = _engine.Nlp(**arguments(problem))
    alone = solve(nlp, problem)
    x = alone["x"]
    expected = [nlp.f(x), nlp.g(x), nlp.gradient(x), nlp.jacobian(x)]

    def evaluations(_):
        return [nlp.f(x), nlp.g(x), nlp.gradient(x), nlp.jacobian(x)]

    with ThreadPoolExecutor(3) as pool:
        solves = [pool.submit(solve, nlp, problem, lambda info, _: nlp.f(x) is not None) for _ in range(2)]
        values = [pool.submit(evaluations, number) for number in range(200)]
        for done in solves:
            result = done.result(timeout=120)
            assert result["iterations"] == alone["iterations"]
            assert_array_equal(result["x"], x)
        for done in values:
            for value, known in zip(done.result(timeout=120), expected, strict=True):
                assert_array_equal(value, known)


@pytest.mark.parametrize(("sizes", "message"), [((-1, 0, 0), "negative"), ((2**30, 0, 0), "2\\^28")])
def test_sizes_that_cannot_be_are_refused(sizes, message):
    none = np.zeros(0, dtype=np.int32)
    with pytest.raises(ValueError, match=message):
        _engine.solve_kkt(*sizes, none, none, none, np.zeros(0), np.zeros(0), 1)


@pytest.mark.parametrize("stage", [[0, 5, 0], [-7, 0, 0], [0, 0]])
def test_stages_that_are_not_there_are_refused(stage):
    diagonal = np.arange(3, dtype=np.int32)
    with pytest.raises(ValueError, match="stage"):
        _engine.solve_kkt(
            3, 0, 0, np.array(stage, dtype=np.int32), diagonal, diagonal, np.ones(3), np.ones(3), 1
        )
