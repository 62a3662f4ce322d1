"""Order of every scheme at the nodes, on a tumbling robot driven by given joint torques."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.support.problems import SCHEME_ORDERS, hopper
from tests.support.tumbling import DURATION, Interval, errors_at_the_end, slope, start, torque
from trajopt.problem.problem import Problem
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.solving.extraction import extract
from trajopt.solving.solving import prepare
from trajopt.terrain.flat import FlatGround
from trajopt.transcription.schemes import scheme

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
