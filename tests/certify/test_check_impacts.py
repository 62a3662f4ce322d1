"""The check of impacts, of jumps that are none, and of velocity sources."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

import trajopt
from tests.support.problems import landing, still
from tests.support.synthetic_motions import with_meta
from trajopt.certify.report import Tolerances
from trajopt.errors import InputError
from trajopt.solution.solution import Solution
from trajopt_library import problems

# What a solver leaves that stops at 1e-6 in units of weight and length.
MET = 1e-6
# Friction at the nodes of a coarse mesh, where its bound becomes inactive.
COARSE = Tolerances(between=0.05)


@lru_cache
def landed() -> Solution:
    solution = trajopt.solve(landing(impact=True), intervals=16, transcription="legendre:3")
    assert solution.converged
    return solution


def test_impact_of_a_solution_meets_its_law_and_loses_energy():
    report = trajopt.check(landed())
    assert report.within(COARSE)
    assert report.impact_residual < MET
    assert report.impact_velocity < MET
    assert report.impact_momentum_error < MET
    assert report.impact_friction_margin > -MET
    assert report.impact_energy_gain < 0


def test_figures_of_impacts_are_none_without_one():
    report = trajopt.check(trajopt.solve(landing(), intervals=10))
    assert report.impact_residual is None
    assert report.impact_friction_margin is None
    assert report.state_jump == 0.0


@pytest.mark.parametrize(
    ("factor", "failing"),
    [
        (1.1, {"impact_residual", "impact_momentum_error"}),
        (-1.0, {"impact_residual", "impact_momentum_error", "impact_friction_margin"}),
    ],
)
def test_impulse_that_is_not_the_impacts_is_found(factor, failing):
    wrong = trajopt.check(replace(landed(), impulse=factor * landed().impulse))
    assert set(wrong.failures(COARSE)) == failing


def test_velocity_that_jumps_without_an_impact_is_found():
    hidden = replace(landed(), impulse=None, impact_index=None)
    report = trajopt.check(hidden)
    assert report.state_jump > 1e-3
    assert report.failures(COARSE) == ("state_jump",)


def test_impact_at_a_sample_within_an_interval_is_refused():
    with pytest.raises(
        InputError, match="'impact_index' holds 3, which is not the first sample of an interval after"
    ):
        trajopt.check(replace(landed(), impact_index=np.array([3])))


def test_statics_of_a_velocity_source_are_judged_not_its_dynamics():
    solution = trajopt.solve(still(), intervals=10)
    assert solution.converged
    assert solution.description.actuation == "velocity"
    report = trajopt.check(solution)
    assert report.ok
    assert report.base_residual < MET
    assert not trajopt.check(with_meta(solution, actuation="torque")).ok


def test_open_loop_of_a_velocity_source_follows_its_rates():
    arm = problems.load("ur5-reach")
    keep = [term for term in arm.terms if type(term).__name__ in ("FramePose", "PositionLimits")]
    problem = replace(arm, actuation="velocity", terms=(trajopt.terms.VelocityCost(weight=1.0), *keep))
    coarse, fine = (
        trajopt.check(trajopt.solve(problem, intervals=n, transcription="legendre:3")) for n in (4, 8)
    )
    assert coarse.open_loop_joints < 1e-8
    assert fine.ok
