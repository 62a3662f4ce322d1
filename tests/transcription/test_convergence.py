"""Order of every scheme at the nodes, on a tumbling robot driven by given joint torques."""

import statistics

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.support.problems import SCHEME_ORDERS, hopper
from tests.support.tumbling import DURATION, Interval, errors_at_the_end, slope, start, torque
from trajopt import FlatGround, Phase, Problem, Schedule
from trajopt.solvers.drivers import run_solver
from trajopt.solvers.result import StoppingCriteria
from trajopt.solvers.status import Status
from trajopt.solving.extraction import extract
from trajopt.solving.solving import PreparedProblem, prepare
from trajopt.transcription.guess import perturbed
from trajopt.transcription.schemes import scheme
from trajopt_library import problems

# The measured slope may differ from the order by this much: the next term of the error's expansion.
SLOPE = 0.3
# Numbers of intervals whose errors lie between the asymptotic range and the roundoff floor.
INTERVALS = {
    1: (80, 160, 320),
    2: (20, 40, 80),
    3: (16, 32, 64),
    4: (10, 20, 40),
    5: (10, 20, 40),
    6: (8, 16, 32),
}
ROUNDOFF_FLOOR = 3e-12
# The propagated states solve the NLP's rows up to Newton's tolerance, in scaled units.
DEFECT = 1e-11


@pytest.mark.parametrize(("name", "order"), SCHEME_ORDERS.items())
def test_error_at_the_nodes_falls_with_the_order_of_the_scheme(name, order):
    assert scheme(name).order == order
    counts = INTERVALS[order]
    errors = errors_at_the_end(scheme(name), counts)
    assert errors[-1] > ROUNDOFF_FLOOR
    assert slope(counts, errors) == pytest.approx(order, abs=SLOPE)


def tumbling() -> Problem:
    """The same motion as a problem: one phase without contacts."""
    q, v = start()
    return Problem(
        name="tumbling",
        robot=hopper(),
        schedule=Schedule((Phase(name="flight", duration=DURATION),)),
        terrain=FlatGround(),
        initial_q=q,
        initial_v=v,
        terms=(),
        guess=lambda t: q,
    )


@pytest.mark.parametrize("name", SCHEME_ORDERS)
def test_transcription_holds_on_the_propagated_states(name):
    count = 8
    prepared = prepare(tumbling(), transcription=name, intervals=count)
    layout = prepared.transcription.layout
    propagation = Interval(scheme(name)).propagate(count)
    x = np.zeros(layout.n_unknowns)
    for k in range(count + 1):
        x[layout.node(k)] = propagation.nodes[k]
    for k in range(count):
        window = x[layout.node_offset[k] : layout.node_offset[k + 1]]
        for i in range(layout.scheme_of(0).s):
            window[layout.local_derivative(0, i)] = propagation.y[k, i]
    x = x / prepared.transcription.scale
    assert set(prepared.transcription.rows.names) == {"defect", "base_dynamics"}
    assert_allclose(prepared.nlp.engine.g(x), 0.0, atol=DEFECT)
    solution = extract(prepared.transcription, x)
    at_points = solution.collocation
    given = np.array([torque(t) for t in solution.t[at_points]])
    assert_allclose(solution.tau[at_points], given, atol=DEFECT * hopper().weight)


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
