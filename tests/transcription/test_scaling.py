"""What a finer mesh costs: sizes, evaluations and iterations, all counted."""

import statistics

import numpy as np
import pytest

from trajopt.solvers.drivers import run_solver
from trajopt.solvers.result import StoppingCriteria
from trajopt.solvers.status import Status
from trajopt.solving.solving import PreparedProblem, prepare
from trajopt.transcription.guess import perturbed
from trajopt_library import problems

COARSE, FINE = 25, 200
MOST = 1.3  # iterations on the fine mesh over those on the coarse one, or the other way round
SEEDS, SIGMA = (1, 2, 3), 0.1
ROUNDING = 1e-12
SAME = (
    1e-4  # relative, of the optimum: far above a solver's tolerance, of the order of the coarse mesh's error
)
# A line search tries a step, its second-order corrections and shorter steps; on average few.
EVALUATIONS = 4.0


def prepared(name: str, intervals: int) -> PreparedProblem:
    return prepare(problems.load(name), intervals=intervals)


@pytest.mark.long
@pytest.mark.parametrize("name", ["ur5-reach", "hopper-hop"])
def test_sizes_and_nonzeros_grow_linearly(name: str) -> None:
    found = []
    for intervals in (24, 48, 72):  # so many that phases of 0.4, 0.3 and 0.5 s share them exactly
        nlp = prepared(name, intervals).nlp
        t = nlp.transcription
        found.append([t.layout.n_unknowns, t.n_rows, len(nlp.row), len(nlp.hessian_row), len(t.linear.data)])
    first, second = np.diff(np.array(found), axis=0)
    np.testing.assert_array_equal(first, second)


def solved(made: PreparedProblem, seed: int) -> tuple[int, float, int]:
    """Iterations, objective, evaluations of values."""
    start = perturbed(made.transcription, made.guess, seed, SIGMA) if seed else made.guess
    result = run_solver(made.nlp, start, "ipopt", StoppingCriteria(), {}, lambda *_: True)
    assert result.status is Status.SOLVED, (seed, result.solver_status)
    return result.iterations, result.objective, made.nlp.engine.timings()["value"][1]


@pytest.mark.long
def test_iterations_do_not_grow_with_the_mesh() -> None:
    coarse, fine = ([solved(prepared("ur5-reach", n), seed) for seed in (0, *SEEDS)] for n in (COARSE, FINE))
    own = [rows[0][0] for rows in (coarse, fine)]
    medians = [statistics.median(row[0] for row in rows[1:]) for rows in (coarse, fine)]
    assert max(own) <= MOST * min(own)
    assert max(medians) <= MOST * min(medians)
    for iterations, _, evaluations in (*coarse, *fine):
        assert evaluations <= EVALUATIONS * (iterations + 1)


@pytest.mark.slow
def test_a_hop_is_solved_on_meshes_from_coarse_to_fine() -> None:
    optima = [solved(prepared("hopper-hop", n), 0)[1] for n in (100, FINE)]
    assert optima[0] == pytest.approx(optima[1], rel=SAME)
