"""What a problem need not say: ground, start, and where the directions of rest are taken."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import trajopt
from trajopt import FlatGround, Problem
from trajopt.solving.solving import solve
from trajopt.terms import TerminalRest

pytestmark = pytest.mark.long

# Two solves of one optimum, whose rows of rest are taken at different postures.
SAME_OBJECTIVE = 1e-5
# Velocity at rest, m/s and rad/s: what contacts hold is an acceleration, whose integral drifts a little.
REST = 2e-4


@pytest.fixture(scope="module", params=["ur5-reach", "solo12-jump"])
def problem(request: pytest.FixtureRequest) -> Problem:
    return trajopt.load(request.param)


def test_ground_and_start_have_defaults(problem):
    needed = {name: getattr(problem, name) for name in ("name", "robot", "schedule", "terms", "guess")}
    if problem.robot.base == "fixed":
        needed["guess"] = lambda t: problem.robot.reference
        needed["terms"] = [term for term in problem.terms if not term.targets()]
    made = Problem(**needed)
    assert made.terrain == FlatGround()
    assert_array_equal(made.initial_q, problem.robot.reference)
    assert_array_equal(made.initial_v, np.zeros(problem.robot.nv))


def test_rest_needs_no_posture(problem):
    free = replace(
        problem,
        terms=tuple(TerminalRest() if isinstance(term, TerminalRest) else term for term in problem.terms),
    )
    given, found = solve(problem), solve(free)
    assert found.success
    assert found.statistics.constraints == given.statistics.constraints
    assert_allclose(found.statistics.objective, given.statistics.objective, rtol=SAME_OBJECTIVE)
    assert_allclose(found.v[-1], 0.0, atol=REST)
