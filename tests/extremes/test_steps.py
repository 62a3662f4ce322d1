"""Steps from 1e-4 to 0.2 s, horizons from 0.05 to 60 s, 5 to 2,000 intervals, every scheme and degree."""

from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.extremes.motions import stand
from tests.extremes.outcomes import Failed, Refused, Solved, assert_outcome
from tests.support.problems import REACH, reach
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.solvers.status import Status
from trajopt_library import problems, robots

# Open loop, rad and parts of the length: about three times what was measured (docs/extremes.md).
ARM = {
    "legendre:1": 12.0, "legendre:2": 0.4, "legendre:3": 4e-3, "legendre:4": 3e-5,
    "radau:1": 14.0, "radau:2": 4.0, "radau:3": 4e-2, "radau:4": 3e-4,
    "trapezoidal": 14.0, "hermite-simpson": 0.3, "semi-implicit-euler": 9.0,
}  # fmt: skip
HOPPER = {
    "legendre:1": 7.0, "legendre:2": 0.1, "legendre:3": 4e-4, "legendre:4": 1e-5,
    "radau:1": 9.0, "radau:2": 2.0, "radau:3": 3e-3, "radau:4": 2e-5,
    "trapezoidal": 2.0, "hermite-simpson": 0.2, "semi-implicit-euler": 9.0,
}  # fmt: skip
JUMP = {
    "legendre:1": 12.0, "legendre:2": 0.5, "legendre:3": 1e-2, "legendre:4": 1e-3,
    "radau:2": 8.0, "radau:3": 6e-2, "radau:4": 5e-3, "hermite-simpson": 0.4,
}  # fmt: skip
# On the grid of the jump these let feet slide by more than a quarter of a leg.
TOO_COARSE = ("radau:1", "trapezoidal", "semi-implicit-euler")
# Where feet may be off between the points of these coarse grids, m: order one drifts by half a leg.
COARSE = {
    "legendre:1": 0.2, "legendre:2": 1e-2, "legendre:3": 1e-3, "legendre:4": 1e-3, "radau:1": 0.5,
    "radau:2": 5e-2, "radau:3": 1e-3, "radau:4": 1e-3, "trapezoidal": 0.3, "hermite-simpson": 1e-2,
    "semi-implicit-euler": 0.5,
}  # fmt: skip
# What the cubic of the one-joint arm is met to: tolerances of the solver, over the length of the reach.
CUBIC = 1e-6


@pytest.mark.long
@pytest.mark.parametrize("scheme", ARM)
def test_arm_reaches_by_every_scheme(scheme):
    make = partial(problems.load, "ur5-reach")
    assert_outcome(Solved(open_loop=ARM[scheme]), make, transcription=scheme, intervals=10)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", HOPPER)
def test_hopper_hops_by_every_scheme(scheme):
    expected = Solved(open_loop=HOPPER[scheme], coarse=COARSE[scheme])
    assert_outcome(expected, partial(problems.load, "hopper-hop"), transcription=scheme, intervals=40)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", [*JUMP, *TOO_COARSE])
def test_quadruped_jumps_by_every_scheme(scheme):
    known = scheme in JUMP
    expected = Solved(JUMP[scheme], coarse=COARSE[scheme]) if known else Failed(Status.COARSE_GRID)
    assert_outcome(expected, partial(problems.load, "solo12-jump"), transcription=scheme, intervals=20)


def timed_reach(duration: float):
    """The one-joint arm's reach in another time: 60 deg and more, without gravity or limits."""
    return replace(
        reach(),
        schedule=Schedule((Phase(name="reach", duration=duration),)),
        guess=lambda t: np.array([REACH * np.clip(t / duration, 0, 1)]),
    )


@pytest.mark.parametrize(
    ("duration", "intervals"),
    [
        *product([0.05, 1.0, 60.0], [5, 50]),
        pytest.param(0.05, 2000, marks=pytest.mark.slow),
        pytest.param(60.0, 2000, marks=pytest.mark.slow),
    ],
)
def test_least_acceleration_is_the_cubic_on_any_horizon_and_grid(duration, intervals):
    """The minimum of the integral of q''^2 from rest to rest is 3 s^2 - 2 s^3; steps of 25 us to 12 s."""
    solution = assert_outcome(Solved(open_loop=CUBIC), partial(timed_reach, duration), intervals=intervals)
    s = solution.t / duration
    assert_allclose(solution.q[:, 0], REACH * (3 * s**2 - 2 * s**3), atol=CUBIC * REACH)
    assert_allclose(
        solution.v[:, 0], REACH / duration * (6 * s - 6 * s**2), atol=CUBIC * 6 * REACH / duration
    )


@pytest.mark.long
@pytest.mark.parametrize("step", [1e-4, 1e-2, 0.2])
def test_quadruped_stands_still_at_any_step(step):
    """At rest nothing is discretised: forces that carry the weight, whatever the step."""
    make = partial(stand, robots.load("solo12"), duration=8 * step)
    solution = assert_outcome(Solved(open_loop=None), make, intervals=8)
    weight = robots.load("solo12").weight
    pushed = solution.f[solution.collocation][:, :, 2].sum(axis=1).mean() / weight
    assert_allclose(pushed, 1.0, atol=1e-3)


def test_too_few_intervals_are_refused():
    assert_outcome(Refused("2 intervals for 3 phases"), partial(problems.load, "solo12-jump"), intervals=2)


@pytest.mark.parametrize("duration", [0.0, -1.0, float("nan"), float("inf")])
def test_an_invalid_horizon_is_refused(duration):
    assert_outcome(Refused("duration"), partial(timed_reach, duration), intervals=5)


def test_reach_faster_than_the_motors_is_infeasible():
    assert_outcome(
        Failed(Status.INFEASIBLE, block="frame_pose"),
        partial(problems.load, "ur5-reach", duration=0.05),
        intervals=10,
    )
