"""Problems with obstacles: which pairs become rows, and how solutions are checked and shown."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from tests.support.replay_pages import objects_of, placements_of, shown
from tests.support.synthetic_motions import with_meta
from trajopt import solve
from trajopt.certify.check import check
from trajopt.certify.report import AT_POINTS
from trajopt.dynamics.manifold import Coordinates
from trajopt.errors import InputError
from trajopt.problem import Problem
from trajopt.robot import Robot
from trajopt.robot.collision.shapes import BoxObstacle, CapsuleObstacle, LinkShape, SphereObstacle
from trajopt.robot.units import Units
from trajopt.schedule import Phase, Schedule
from trajopt.solution.clearance import refined_configurations
from trajopt.solution.solution import Solution
from trajopt.solving.avoidance import missed_pairs, solve_clear, with_obstacles
from trajopt.terms import AccelerationCost, Clearance, Context, TerminalRest, TerminalState
from trajopt.terms.clearance import SMOOTHING, collision_scene
from trajopt.terrain.flat import FlatGround
from trajopt.transcription.stage_functions import point_function
from trajopt_library import robots
from trajopt_library.problems.common import PosturePath

MARGIN = 0.02
POLYNOMIAL = 1e-9  # a cubic through its own values and rates: rounding
BETWEEN = 0.01  # m; how far a motion of thirty intervals dips between its points
DISTANCE = 1e-6  # m; what Coal's iterations stop at
LINK = 0.5


def arm() -> Robot:
    """Three equal links that turn about parallel axes, upright at zero, without meshes."""
    model, parent = pin.Model(), 0
    for i in range(3):
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, LINK if i else 0.0]))
        parent = model.addJoint(parent, pin.JointModelRY(), place, f"joint{i}")
        rod = pin.Inertia.FromBox(1.0, 0.06, 0.06, LINK)
        rod.lever = np.array([0.0, 0.0, LINK / 2])
        model.appendBodyToJoint(parent, rod, pin.SE3.Identity())
        model.addJointFrame(parent)
    return Robot.from_model(model, name="rods", base="fixed")


BALL = SphereObstacle(name="ball", centre=[0.69, 0.0, 1.443], radius=0.1)
# In the middle of the way, where a link in a hurry may pass it between two points.
POLE = SphereObstacle(name="pole", centre=[0.55, 0.0, 1.15], radius=0.1)
FAR = CapsuleObstacle(name="far", start=[-3.0, 0.0, 0.0], end=[-3.0, 0.0, 1.0], radius=0.1)


def swing(**changes: object) -> Problem:
    """From upright to lying ahead, the links in line: through the ball if nothing forbids it."""
    robot, start, end, duration = arm(), np.array([-0.3, 0.0, 0.0]), np.array([1.2, 0.0, 0.0]), 1.5
    given = {
        "name": "swing",
        "robot": robot,
        "schedule": Schedule((Phase(name="swing", duration=duration),)),
        "terrain": FlatGround(),
        "initial_q": start,
        "initial_v": np.zeros(robot.nv),
        "terms": (
            AccelerationCost(weight=1.0),
            TerminalState(q=end),
            TerminalRest(q=end),
        ),
        "guess": PosturePath(model=robot.model, postures=(start, end), durations=(duration,)),
        "default_intervals": 30,
    }
    return Problem(**(given | changes))


@lru_cache
def avoided() -> tuple[Problem, Solution]:
    problem = with_obstacles(swing(), [BALL, FAR], margin=MARGIN)
    return problem, solve(problem, compile="none", fixed_mesh=True)


def test_only_what_comes_near_the_guess_becomes_rows():
    problem, _ = avoided()
    (term,) = (term for term in problem.terms if isinstance(term, Clearance))
    assert {second for _, second in term.pairs} == {"ball"}
    assert {second for _, second in term.scene.pairs} == {"ball", "far"}
    nothing = with_obstacles(swing(), [FAR])
    (term,) = (term for term in nothing.terms if isinstance(term, Clearance))
    assert term.pairs == ()
    assert check(solve(nothing, compile="none", max_iterations=0, fixed_mesh=True)).obstacle_distance > 1


def test_straight_motion_collides_and_the_solution_does_not():
    problem, solution = avoided()
    scene = collision_scene(problem.terms)
    straight = [problem.guess(t) for t in np.linspace(0, 1.5, 40)]
    assert scene.least_distances(straight).min() < -0.03
    assert solution.converged, solution.meta["advice"]
    points = solution.q[solution.collocation]
    assert scene.least_distances(points).min() > MARGIN - DISTANCE
    report = check(solution)
    assert report.within(AT_POINTS), report.failures(AT_POINTS)
    assert report.obstacle_distance == pytest.approx(
        scene.least_distances(refined_configurations(solution)).min()
    )
    assert report.obstacle_distance > MARGIN - BETWEEN
    assert report.self_distance is None


def test_constraint_binds_within_its_smoothing():
    problem, solution = avoided()
    least = collision_scene(problem.terms).least_distances(solution.q[solution.collocation]).min()
    assert least < MARGIN + SMOOTHING * problem.robot.length + DISTANCE


def test_check_finds_a_motion_that_collides():
    _, solution = avoided()
    moved = {**solution.meta["collision"], "obstacles": [replace(BALL, radius=0.2).describe()]}
    report = check(with_meta(solution, collision=moved))
    assert report.failures(AT_POINTS) == ("obstacle_distance",)
    assert report.obstacle_distance < -0.03


def test_missed_pairs_are_added_until_nothing_is_near():
    blind = with_obstacles(swing(), [BALL], margin=MARGIN, band=0.0)
    blind = replace(
        blind, terms=tuple(replace(t, pairs=()) if isinstance(t, Clearance) else t for t in blind.terms)
    )
    assert "obstacle_distance" in check(solve(blind, compile="none", fixed_mesh=True)).failures(AT_POINTS)
    solution, problem = solve_clear(blind, compile="none")
    assert solution.converged
    assert check(solution).within(AT_POINTS)
    remaining = missed_pairs(problem, solution).get("swing", ())
    (term,) = (term for term in problem.terms if isinstance(term, Clearance))
    assert term.pairs
    assert not set(remaining) & set(term.pairs)


def test_motion_that_slips_between_points_is_solved_on_a_finer_grid():
    problem = with_obstacles(swing(), [POLE], margin=MARGIN)
    slipped = solve(problem, compile="none", fixed_mesh=True)
    assert slipped.converged
    assert "obstacle_distance" in check(slipped).failures(AT_POINTS)
    solution, _ = solve_clear(problem, compile="none")
    assert solution.n_intervals > slipped.n_intervals
    assert check(solution).within(AT_POINTS) or not solution.success


def test_links_keep_clear_of_each_other():
    folded = np.array([0.0, 2.9, 0.0])
    robot = replace(arm(), reference=np.array([0.0, 1.0, 1.0]))
    start, end = np.array([0.0, 1.0, 1.0]), np.array([0.0, 2.0, 2.0])
    problem = swing(
        robot=robot,
        initial_q=start,
        guess=PosturePath(model=robot.model, postures=(start, end), durations=(1.5,)),
        terms=(AccelerationCost(weight=1.0), TerminalRest(q=folded)),
    )
    problem = with_obstacles(problem, [], margin=MARGIN, self_collision=True)
    assert collision_scene(problem.terms).pairs == (("joint0", "joint2"),)
    solution = solve(problem, compile="none", fixed_mesh=True)
    assert check(solution).self_distance > 0
    assert check(solution).obstacle_distance is None


@pytest.mark.long
def test_rows_of_a_free_robot_are_within_the_bound_of_coal():
    robot = robots.load("solo12")
    turn = pin.exp3(np.ones(3))
    box = BoxObstacle(name="box", sides=[0.1, 0.2, 0.3], position=[0.5, 0.1, 0.2], rotation=turn)
    post = CapsuleObstacle(name="post", start=[-0.3, 0.4, 0.0], end=[-0.3, 0.4, 0.5], radius=0.03)
    still, feet = np.zeros(robot.nv), tuple(contact.name for contact in robot.contacts)
    problem = Problem(
        name="stand",
        robot=robot,
        schedule=Schedule((Phase(name="stand", duration=1.0, contacts=feet),)),
        terrain=FlatGround(),
        initial_q=robot.reference,
        initial_v=still,
        terms=(),
        guess=lambda t: robot.reference,
    )
    problem = with_obstacles(problem, [box, post], margin=0.01, self_collision=True, band=1.0)
    (term,) = problem.terms
    coordinates, units = Coordinates(robot.model), Units(robot)
    context = Context(robot, coordinates, robot.contacts)
    rows = term.rows(context, units)
    function = point_function("rows", context, ca.SX(0), [rows.expression])
    for seed in range(3):
        step = np.random.default_rng(seed).uniform(-0.4, 0.4, robot.nv)
        q = pin.integrate(robot.model, robot.reference, step)
        values = _at(function, context, coordinates, q)
        true = dict(zip(term.scene.pairs, term.scene.distances(q)[0], strict=True))
        for pair, beyond in zip(term.pairs, values, strict=True):
            free = true[pair] - term.margin
            assert beyond < free + DISTANCE or true[pair] < 0
            if free > 3**0.5 * SMOOTHING * units.length + DISTANCE:
                assert beyond > 0


def _at(function: object, context: Context, coordinates: Coordinates, q: np.ndarray) -> np.ndarray:
    """Rows of a point function at rest at q."""
    node = coordinates.node_from_pinocchio(q, np.zeros(coordinates.nv))
    z = np.zeros(function.n_z)
    n4 = 4 * coordinates.n_rotations
    z[:n4] = node[:n4]
    z[n4 + coordinates.additive_index] = node[n4 : n4 + len(coordinates.additive_index)]
    value = ca.DM(z)
    for layer in function.layers:
        value = layer(value)
    return np.array(function.terms(z, value, context.parameter_values)[1]).ravel()


def test_cubics_between_samples_are_the_motion():
    _, solution = avoided()
    rows = solution.intervals[3]
    found = np.array(refined_configurations(solution, rows))
    times = np.concatenate(
        [np.linspace(solution.t[a], solution.t[a + 1], 6)[1 if a > rows[0] else 0 :] for a in rows[:-1]]
    )
    inner = np.polynomial.polynomial.polyfit(times, found, 3)  # one cubic over the whole interval
    assert np.abs(np.polynomial.polynomial.polyval(times, inner).T - found).max() < POLYNOMIAL


def test_start_too_near_an_obstacle_is_refused():
    near = SphereObstacle(name="near", centre=[-0.3, 0.0, 1.2], radius=0.1)
    with pytest.raises(InputError, match=r"starts .* m from 'near'; allowed: at least 0.02 m"):
        with_obstacles(swing(), [near], margin=MARGIN)


NOWHERE = LinkShape.sphere("c", "nose", np.zeros(3), 0.1)
BAD = {
    "margin": {"margin": -0.1},
    "nan": {"margin": np.nan},
    "band": {"band": -1.0},
    "frame": {"capsules": [NOWHERE]},
}


@pytest.mark.parametrize("case", BAD)
def test_bad_settings_are_refused(case):
    with pytest.raises(InputError, match=r"margin|band|nose") as caught:
        with_obstacles(swing(), [BALL], **BAD[case])
    assert "\n" not in str(caught.value)


WRONG = {
    "list": [],
    "capsules": {"capsules": None, "obstacles": [], "self_pairs": []},
    "obstacle": {"capsules": [], "obstacles": [{"kind": "cone"}], "self_pairs": []},
    "pair": {"capsules": [], "obstacles": [], "self_pairs": [["a"]]},
    "frame": {"capsules": [NOWHERE.describe()], "obstacles": [], "self_pairs": []},
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_description_in_a_file_is_refused_in_one_line(case, tmp_path):
    _, solution = avoided()
    with pytest.raises(InputError, match="collision of meta: ") as caught:
        check(with_meta(solution, collision=WRONG[case]))
    assert "\n" not in str(caught.value)
    path = solution.save(tmp_path / "good.npz")
    assert check(Solution.load(path)).to_dict() == check(solution).to_dict()


def test_replay_draws_obstacles_where_they_are(tmp_path):
    _, solution = avoided()
    page = shown(solution, tmp_path)
    drawn, places = objects_of(page), placements_of(page)
    found = {name.split("obstacles/")[1] for name in drawn if "obstacles/" in name}
    assert found == {"ball/start", "far/start", "far/end", "far/side"}
    (ball,) = (matrix for name, matrix in places.items() if name.endswith("ball/start"))
    assert ball[:3, 3] == pytest.approx(BALL.centre, abs=1e-6)
