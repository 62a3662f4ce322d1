"""The engine in adversity: threads that cannot start, exceptions, two threads on one NLP, wrong sizes."""

import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.support.grouped_nlps import arguments, cart_pole
from trajopt import _engine

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


@pytest.mark.parametrize(
    ("sizes", "message"),
    [
        ((-1, 0, 0), "negative"),
        ((2**30, 0, 0), "2\\^28"),
    ],
)
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
