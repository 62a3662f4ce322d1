"""Contacts with a radius: their centres keep it from the ground, their footholds are points of the ground."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.support.balls import RADIUS, WAVES, ball_hopper, ground_slope, landing_on, raised
from tests.support.ground import HILLS, STAIRS
from tests.support.problems import FOOT, hop, hopper
from tests.support.synthetic_motions import with_meta
from trajopt.certify.check import check
from trajopt.errors import InputError
from trajopt.motion.solution import Solution
from trajopt.problem.problem import Problem
from trajopt.robot.contact import Contact
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.robot import Robot
from trajopt.schedule.placing import footholds_at, placed_on
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.solving.solving import prepare, solve
from trajopt.terms import SwingClearance
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.patch import Patch
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.surface import Surface

ROUNDING = 1e-12  # metres, after a few products of numbers near one
SOLVED = 1e-6  # what a solver leaves of a constraint, in its unit and in m
# Drift of the foot on 24 intervals, and what a grid of 1.5 mm misses of the nearest point's distance, m.
DRIFTED = 1e-4
SLOPE = FlatGround(height=0.1, normal=(-0.2, 0.1, 1.0))
STEP = PiecewiseTerrain.stairs(0.1, 0.4, 1, at=(0.1, 0.0))
RAMP = PiecewiseTerrain.slope(0.2, 0.5, at=(-0.2, 0.0))


# The contact


@pytest.mark.parametrize("radius", [-0.01, np.nan, np.inf, "0.01", True])
def test_a_radius_is_a_length(radius):
    with pytest.raises(InputError, match=r"radius of Contact( 'toe')? is .*>= 0"):
        Contact(frame="toe", radius=radius)


def test_a_sole_has_no_radius():
    with pytest.raises(InputError, match="surface contact 'sole' has a radius"):
        Contact(frame="sole", kind="surface", half_length=0.1, half_width=0.05, radius=0.01)


def test_a_reference_posture_stands_on_the_ball():
    model = hopper().model
    robot = Robot.from_model(model, contacts=[Contact(frame=FOOT, radius=RADIUS)])
    point = Robot.from_model(model, contacts=[FOOT])
    assert contact_positions(robot, robot.reference)[FOOT][2] == pytest.approx(RADIUS, abs=ROUNDING)
    assert contact_positions(point, point.reference)[FOOT][2] == pytest.approx(0.0, abs=ROUNDING)
    assert robot.length == pytest.approx(point.length)


# Footholds and surfaces


@pytest.mark.parametrize("ground", [FlatGround(), SLOPE, HILLS, WAVES, PiecewiseTerrain.slope(0.2, 0.5)])
def test_a_foothold_is_the_point_of_the_ground_under_the_centre(ground):
    robot, q = ball_hopper(), ball_hopper().reference.copy()
    foot = contact_positions(robot, q)[FOOT]
    q[2] -= float(ground.offset(RADIUS).surface_at(foot).distance(foot)) / ground_slope(ground, foot)
    centre, foothold = contact_positions(robot, q)[FOOT], footholds_at(robot, q, ground)[FOOT]
    assert_allclose(ground.surface_at(foothold).distance(foothold), 0.0, atol=SOLVED)
    assert np.linalg.norm(centre - foothold) == pytest.approx(RADIUS)
    phase = Phase(name="landing", duration=0.3, contacts=(FOOT,), footholds={FOOT: foothold})
    assert_allclose(phase.centre(robot.contact(FOOT), ground), centre, atol=SOLVED)


def test_a_foothold_on_a_surface_or_patch_is_a_point_of_it():
    wall = Surface(point=np.array([0.5, 0.0, 0.0]), normal=np.array([-1.0, 0.0, 0.0]))
    ball, place = Contact(frame=FOOT, radius=RADIUS), np.array([0.5, 0.1, 0.3])
    own = {"name": "touch", "duration": 0.3, "contacts": (FOOT,), "footholds": {FOOT: place}}
    touch = Phase(**own, surfaces={FOOT: wall})
    assert_allclose(touch.centre(ball, FlatGround()), [0.5 - RADIUS, 0.1, 0.3], atol=ROUNDING)
    assert touch.surface(FOOT, FlatGround(), RADIUS).same_plane(wall.offset(RADIUS))
    patch = Patch.rectangle((0.5, 0.1, 0.3), (0.2, 0.2))
    stand = Phase(**own, patches={FOOT: patch})
    assert_allclose(stand.centre(ball, FlatGround()), [0.5, 0.1, 0.3 + RADIUS], atol=ROUNDING)
    assert Phase(name="fly", duration=0.1).centre(ball, FlatGround()) is None


def test_a_schedule_placed_on_terrain_has_its_footholds_on_the_ground():
    phase = Phase(name="landing", duration=0.3, contacts=(FOOT,), footholds={FOOT: np.array([0.4, 0.0, 0.0])})
    (placed,) = placed_on(Schedule((phase,)), STAIRS).phases
    assert placed.footholds[FOOT][2] == pytest.approx(0.2)
    assert placed.centre(Contact(frame=FOOT, radius=RADIUS), STAIRS)[2] == pytest.approx(0.2 + RADIUS)


def test_contacts_of_a_problem_lie_on_the_parallel_surface_and_its_file_has_the_ground():
    robot = ball_hopper()
    problem = landing_on(STEP, robot, footholds={FOOT: np.array([0.2, 0.0, 0.1])})
    assert problem.surfaces_of(0)[FOOT].height == pytest.approx(RADIUS)
    assert problem.surfaces_of(2)[FOOT].height == pytest.approx(0.1 + RADIUS)
    place = problem.contact_place(FOOT, 2)
    assert place is not None
    assert place[2] == pytest.approx(0.1 + RADIUS)


# Motions


def test_on_level_ground_a_radius_moves_the_whole_problem_up():
    problem = hop(terms=(*hop().terms, SwingClearance(height=0.03, terrain=FlatGround())))
    point, ball = (prepare(one) for one in (problem, raised(problem, RADIUS)))
    assert len(point.guess) == len(ball.guess)
    noise = 0.05 * np.random.default_rng(1).normal(size=len(point.guess))
    for shift in (0.0, noise):
        values = [
            (one.nlp.engine.f(one.guess + shift), one.nlp.engine.g(one.guess + shift))
            for one in (point, ball)
        ]
        bounds = [(one.transcription.lower_g, one.transcription.upper_g) for one in (point, ball)]
        assert values[0][0] == pytest.approx(values[1][0], rel=1e-9)
        for own, other in zip(*bounds, strict=True):
            limited = np.isfinite(own)
            assert np.array_equal(limited, np.isfinite(other))
            left = [
                np.asarray(g)[limited] - b[limited] for (_, g), b in zip(values, (own, other), strict=True)
            ]
            assert_allclose(left[0], left[1], atol=1e-9)


def solved(problem: Problem) -> Solution:
    solution = solve(problem)
    assert solution.converged, solution.statistics.advice
    return solution


def depth_of_ball(solution: Solution, ground) -> np.ndarray:
    """How deep the ball is in the ground at the samples (K,), m: its centre's distance from points of it."""
    at = np.linspace(-RADIUS, RADIUS, 41)
    x, y = (grid.ravel() for grid in np.meshgrid(at, at))
    found = []
    for q in solution.q:
        centre = contact_positions(ball_hopper(), q)[FOOT]
        points = np.column_stack([centre[0] + x, centre[1] + y, ground.height(centre[0] + x, centre[1] + y)])
        found.append(RADIUS - np.linalg.norm(points - centre, axis=1).min())
    return np.array(found)


@pytest.mark.long
@pytest.mark.parametrize("ground", [WAVES, STEP, RAMP])
def test_a_ball_touches_uneven_ground_and_does_not_sink_into_it(ground):
    place = {}
    if isinstance(ground, PiecewiseTerrain):
        place = {"footholds": {FOOT: np.array([0.2, 0.0, float(ground.height(0.2, 0.0))])}}
    problem = replace(landing_on(ground, ball_hopper(), **place), default_intervals=24)
    solution = solved(problem)
    depth, report = depth_of_ball(solution, ground), check(solution)
    assert np.abs(depth[solution.active[:, 0]]).max() < DRIFTED
    assert report.penetration > max(depth.max(), 0.0) - DRIFTED  # it looks between samples, too
    assert report.landing_height < SOLVED
    assert report.friction_margin > -SOLVED


def test_the_file_has_radii_and_one_without_them_has_points():
    solution = solved(raised(hop(), RADIUS))
    assert solution.meta["contact_radius"] == [RADIUS]
    assert check(solution).landing_height < SOLVED
    older = with_meta(solution, drop=("contact_radius",))
    assert check(older).landing_height == pytest.approx(RADIUS, abs=SOLVED)
