"""What a solve says that did not succeed: causes by name, not a finer mesh or more iterations."""

from dataclasses import replace

import pytest

import trajopt
from tests.support.problems import hop
from tests.support.synthetic_motions import sampled, standing
from trajopt.certify.report import Tolerances
from trajopt.collision.description import robot_shapes
from trajopt.solvers.status import Status
from trajopt.solving.verdicts import judged_by
from trajopt.terms import FrameHeight
from trajopt.terms.costs import NodeCost
from trajopt.terms.interfaces import Cost

SUNK = 0.006  # m


@pytest.mark.long
def test_a_wheel_whose_shape_is_larger_than_its_ball_is_named_as_the_cause() -> None:
    robot = trajopt.robot("solo12:rolling")
    lower = robot.reference.copy()
    lower[2] -= SUNK
    solution = sampled(
        robot,
        [replace(standing(robot), q=lambda t: lower)],
        2,
        contact_rolling=[True] * 4,
        contact_radius=[contact.radius - SUNK for contact in robot.contacts],
        bodies=robot_shapes(robot).describe(),
    )
    judged = judged_by(solution, trajopt.check(solution, integrate=False), Tolerances())
    assert "the shape of a wheel is larger than the ball" in judged.statistics.advice
    assert "depth of links in the ground" in judged.statistics.advice
    assert "more intervals" not in judged.statistics.advice


@pytest.mark.long
def test_a_problem_without_a_cost_is_told_so_and_not_to_raise_a_limit() -> None:
    problem = trajopt.load("ur5-reach")
    rows = tuple(term for term in problem.terms if not isinstance(term, Cost | NodeCost))
    statistics = trajopt.solve(replace(problem, terms=rows), draft=True, max_iterations=1).statistics
    assert statistics.status == Status.ITERATION_LIMIT.word
    assert "the problem has no cost" in statistics.advice
    assert "max_iterations" not in statistics.advice
    kept = trajopt.solve(problem, draft=True, max_iterations=1).statistics
    assert "max_iterations" in kept.advice
    assert "no cost" not in kept.advice


@pytest.mark.long
def test_a_jump_too_high_for_its_flight_names_the_flight_and_its_duration() -> None:
    problem = hop()
    rows = tuple(
        replace(term, height=0.6) if isinstance(term, FrameHeight) else term for term in problem.terms
    )
    statistics = trajopt.solve(replace(problem, terms=rows), draft=True).statistics
    assert statistics.status == Status.INFEASIBLE.word
    words = "flight 'flight' of 0.2 s: a rise h and a fall f take sqrt(2 h / g) + sqrt(2 f / g)"
    assert words in statistics.advice
