"""Figures between samples: their worst value is found, and local errors are those of an integration."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.problems import hop, landing, reach
from trajopt.certify.accuracy.local_errors import local_errors
from trajopt.certify.accuracy.measures import interval_errors
from trajopt.certify.check import check
from trajopt.certify.contact_figures import force_traces
from trajopt.motion.quantities import MotionQuantities
from trajopt.motion.resampling import resampled
from trajopt.solution.solution import Solution

pytestmark = pytest.mark.long

FINE = np.linspace(0.0, 1.0, 201)
# The worst value differs from that of two hundred samples in each interval by this part of the figure's unit.
FOUND = 2e-3
# An estimate of local errors serves within this factor.
FACTOR = 2.0


@pytest.fixture(scope="module", params=["legendre:2", "legendre:4", "radau:3"])
def plan(request: pytest.FixtureRequest) -> Solution:
    return trajopt.solve(landing(), intervals=8, transcription=request.param)


def test_worst_of_two_hundred_samples_is_found_with_a_few(plan):
    report, fine = check(plan, integrate=False), resampled(plan.normalized(), FINE)
    motion = MotionQuantities(fine)
    expected = {**force_traces(motion), **motion.limit_traces}
    for name in ("friction_margin", "unilateral_margin", "velocity_excess", "position_excess"):
        worst = expected[name].worst()
        assert worst is not None
        found, sign = getattr(report, f"{name}_between"), -1 if expected[name].margin else 1
        assert sign * found > sign * worst[0] - FOUND, name
        assert sign * found < sign * worst[0] + FOUND, name


def test_places_are_those_of_the_worst_values(plan):
    report = check(plan, integrate=False)
    place = report.places["friction_margin_between"]
    assert place.phase == "landing"
    assert place.name == "foot"
    number = int(plan.interval_at(place.time))
    start, end = plan.interval_t[number]
    assert start <= place.time <= end


@pytest.mark.parametrize("problem", [landing(), hop(), reach(gravity=True)], ids=["landing", "hop", "reach"])
def test_local_errors_are_those_of_an_integration(problem):
    plan = trajopt.solve(problem, intervals=12).normalized()
    found = local_errors(MotionQuantities(plan)).position
    expected = interval_errors(plan)
    large = expected > 1e-2 * expected.max()
    assert_allclose(np.log(found[large] / expected[large]), 0.0, atol=np.log(FACTOR))
    assert found.sum() == pytest.approx(expected.sum(), rel=0.5)


def test_local_errors_of_uneven_meshes_are_in_the_order_of_the_intervals():
    plan = trajopt.solve(landing(), transcription="legendre:2,legendre:2,legendre:3", intervals=8)
    found = local_errors(MotionQuantities.normalized(plan)).position
    assert np.argmax(found) == np.argmax(interval_errors(plan))
