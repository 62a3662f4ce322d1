"""Carried bodies keep clear of obstacles, ground and links in the phases that carry them, and only there."""

from dataclasses import replace

import numpy as np
import pytest

import trajopt
from tests.support.models import placement
from tests.support.swings import DURATION, LINK, MARGIN, START, past, rods, swing
from trajopt import Contact, InputError, Moment, Phase, Problem, Schedule
from trajopt.collision.shapes import BoxObstacle, SphereObstacle
from trajopt.problem.bodies import GAP_SLACK, POINT, bodies_of, shapes_of
from trajopt.robot import Payload
from trajopt.solving.graded import solve as solve_graded
from trajopt.terms import FramePose

SIDE = 0.2  # m
CENTRE = np.array([0.0, 0.0, LINK + SIDE / 2])
CUBE = Payload(contact="hand", mass=0.5, centre=CENTRE, inertia=0.5 * SIDE**2 / 6 * np.eye(3))
PHASES = ("first", "second")
LOOKS = 400


def carrying(during: int, *obstacles: BoxObstacle | SphereObstacle, payload: Payload = CUBE) -> Problem:
    """The swing in two equal phases, with a payload at the tip in one of them."""
    halves = tuple(Phase(name=name, duration=DURATION / 2) for name in PHASES)
    robot = replace(rods(), contacts=(Contact(frame="joint2", name="hand"),))
    problem = swing(robot=robot, schedule=Schedule(halves), payloads={PHASES[during]: payload})
    return past(problem, *obstacles)


def beyond(angle: float) -> SphereObstacle:
    """A ball at an angle of the arm, beyond the links' reach of 1.54 m and within that of the cube."""
    return SphereObstacle(name="ball", centre=[1.75 * np.sin(angle), 0.0, 1.75 * np.cos(angle)], radius=0.1)


def away(solution: trajopt.Solution, ball: SphereObstacle) -> tuple[np.ndarray, np.ndarray]:
    """Distance (K,) in m of the cube from a ball, in closed form, and the phases of the samples."""
    times = np.linspace(0.0, solution.t[-1], LOOKS)
    distances = []
    for q in solution.sample(times=times).q:
        centre = placement(solution.model, q, "joint2").actInv(ball.centre) - CENTRE
        distances.append(np.linalg.norm(np.maximum(np.abs(centre) - SIDE / 2, 0.0)) - ball.radius)
    return np.array(distances), (times > DURATION / 2).astype(int)


@pytest.mark.parametrize(("during", "angle"), [(0, 0.1), (1, 0.9)])
def test_a_carried_body_keeps_clear_where_it_is_carried_and_only_there(during, angle):
    ball = beyond(angle)
    solution = solve_graded(carrying(during, ball))
    assert solution.converged, solution.statistics.advice
    distances, phases = away(solution, ball)
    assert MARGIN - GAP_SLACK < distances[phases == during].min() < MARGIN + 2e-3
    report = trajopt.check(solution)
    assert report.within()
    assert report.clearance_margin is not None
    assert -GAP_SLACK < report.clearance_margin < 2e-3
    elsewhere = solve_graded(carrying(1 - during, ball))
    assert elsewhere.converged
    distances, phases = away(elsewhere, ball)
    assert distances[phases == during].min() < -0.05
    assert trajopt.check(elsewhere).within()


def test_the_check_finds_a_carried_body_in_an_obstacle(tmp_path):
    ball = beyond(0.9)
    free = solve_graded(carrying(1))
    solution = trajopt.Solution.load(free.with_description(obstacles=(ball,)).save(tmp_path / "inside.npz"))
    distances, phases = away(solution, ball)
    report = trajopt.check(solution)
    assert report.obstacle_distance == pytest.approx(distances[phases == 1].min(), abs=2e-3)
    assert "payload 1 and ball" in str(report.places["obstacle_distance"])
    bodies = solution.description.bodies
    assert bodies is not None
    assert bodies.carried["payload 1"].phases == (1,)


@pytest.mark.parametrize(
    ("payload", "points", "radius"),
    [
        (CUBE, 8, 0.0),
        (Payload(contact="hand", mass=1.0, centre=CENTRE), 1, POINT),
        (Payload(contact="hand", mass=1.0, points=[CENTRE], radius=0.15), 1, 0.15),
    ],
)
def test_the_shape_of_a_carried_body_is_its_own_or_that_of_its_inertia(payload, points, radius):
    shape = shapes_of(carrying(1, payload=payload)).shapes[-1]
    assert (len(shape.points), shape.radius) == (points, radius)
    np.testing.assert_allclose(shape.points.mean(axis=0), CENTRE, atol=1e-12)
    if points > 1:
        np.testing.assert_allclose(np.ptp(shape.points, axis=0), SIDE)


def test_a_body_rests_on_what_it_is_put_down_on():
    problem = carrying(1)
    tip = placement(problem.robot.model, problem.guess_at(DURATION), "joint2")
    down = FramePose(
        frame="joint2", position=tip.translation, rotation=tip.rotation, at=Moment("second", 1.0)
    )
    table = BoxObstacle(
        name="table",
        sides=[0.4, 0.4, 0.3],
        position=tip.act(np.array([0.0, 0.0, LINK + SIDE + 0.15 + 0.001])),
        rotation=tip.rotation,
    )
    problem = past(replace(problem, terms=(*swing().terms, down)), table, beyond(-1.0))
    margin = bodies_of(problem).margin_of
    assert margin["payload 1", "table"] == 0.0
    assert margin["payload 1", "ball"] == margin["joint2", "table"] == MARGIN
    into = replace(
        problem, payloads={"second": Payload(contact="hand", mass=1.0, points=[CENTRE], radius=0.2)}
    )
    with pytest.raises(InputError, match=r"'payload 1' .* from 'table' .*allowed: at least 0 m"):
        bodies_of(into)


def test_a_body_that_begins_or_ends_inside_another_is_refused():
    inside = SphereObstacle(
        name="ball", centre=placement(rods().model, START, "joint2").act(CENTRE), radius=0.03
    )
    with pytest.raises(InputError, match=r"'payload 1' starts .* from 'ball'"):
        bodies_of(carrying(0, inside))
    assert bodies_of(carrying(1, inside)).present[:, -1].tolist() == [False, True]
