"""The exchange of rows until bodies are clear: none where a motion is, only for what is near."""

from dataclasses import replace
from functools import lru_cache

import coal
import numpy as np
import pinocchio as pin
import pytest

import trajopt
from tests.support.problems import FOOT, hop, landing
from tests.support.swings import BALL, DURATION, END, FAR, MARGIN, POLE, START, avoided, past, rods, swing
from trajopt import InputError, Problem, Robot, Solution, check
from trajopt.certify.report import PENETRATION
from trajopt.collision.shapes import LinkShape, SphereObstacle
from trajopt.motion.configurations import SolutionMotion
from trajopt.problem import PosturePath
from trajopt.solving.exchange import GAP_SLACK, INTERVAL_LOOKS, LOOK_STEP, MOST_SLIPS, Exchange, Look, along
from trajopt.solving.graded import solve as solve_graded
from trajopt.solving.solving import prepare, solve
from trajopt.terms import Clearance
from trajopt.terms.moments import PlaneSide
from trajopt_library import problems

pytestmark = pytest.mark.long

ROUNDING = 1e-9  # of interpolants, in natural units
PAIR = ("joint2", "ball")


@lru_cache
def straight() -> Solution:
    return solve(past(swing(), BALL, FAR))


def begun(problem: Problem, solution: Solution) -> tuple[Exchange, Look]:
    """The exchange after its first look at a solution."""
    exchange = Exchange(problem)
    look = exchange.look(solution)
    exchange.add(look)
    return exchange, look


def planes(problem: Problem) -> list[PlaneSide]:
    return [term for term in problem.terms if isinstance(term, PlaneSide)]


def test_clear_motion_has_no_rows():
    problem = past(swing(), FAR)
    exchange, look = begun(problem, straight())
    assert exchange.missing(look) == ()
    assert exchange.moments == {}
    assert not exchange.add(look)
    assert exchange.constrained(along(straight())).terms == problem.terms


def test_only_pairs_that_came_too_near_have_rows_and_only_where_they_are_near():
    problem = past(swing(), BALL, FAR)
    exchange, look = begun(problem, straight())
    assert exchange.missing(look) == (PAIR,)
    assert set(exchange.moments) == {PAIR}
    short = (look.distances - exchange.bodies.margins)[:, exchange.bodies.pairs.index(PAIR)]
    near = {moment for moment, own in zip(look.moments, short, strict=True) if own < exchange.band}
    assert exchange.moments[PAIR] <= near
    assert 0 < len(near) < len(look.moments)
    regular = {m for m, own in zip(look.moments, look.regular, strict=True) if own}
    assert near & regular <= exchange.moments[PAIR]
    (term,) = planes(exchange.constrained(along(straight())))
    assert {(0, float(f)) for f in term.fractions} == exchange.moments[PAIR]


def test_moment_between_points_where_a_pair_is_nearest_has_a_row():
    problem = past(swing(), POLE)
    exchange, look = begun(problem, solve(problem))
    regular = {m for m, own in zip(look.moments, look.regular, strict=True) if own}
    short = (look.distances - exchange.bodies.margins)[:, exchange.bodies.pairs.index(("joint2", "pole"))]
    assert look.moments[int(np.argmin(short))] in exchange.moments["joint2", "pole"]
    inner = exchange.moments["joint2", "pole"] - regular
    rows = dict(zip(look.moments, short, strict=True))
    assert all(rows[moment] < -GAP_SLACK for moment in inner)


def test_distances_of_a_look_are_those_along_the_motion():
    exchange, look = begun(past(swing(), BALL, FAR), straight())
    motion = SolutionMotion(straight())
    phases, fractions = (np.array(each) for each in zip(*look.moments, strict=True))
    q = motion.in_phase(phases, fractions, 0.5).q
    true = exchange.bodies.scene.distances(q)
    near = true < exchange.band + MARGIN
    assert look.distances[near] == pytest.approx(true[near], abs=ROUNDING)
    assert (look.distances[~near] >= exchange.band + MARGIN).all()
    assert look.regular.sum() == 3 * straight().n_intervals + 1  # a node, two points, and the end


def test_a_look_is_also_at_times_that_are_asked_for():
    exchange = Exchange(past(swing(), BALL, FAR))
    end = float(straight().t[-1])
    plain, more = exchange.look(straight()), exchange.look(straight(), [0.123 * end, 0.0, end])
    (added,) = set(more.moments) - set(plain.moments)
    assert set(plain.moments) <= set(more.moments)
    assert added == (0, pytest.approx(0.123))
    assert not more.regular[more.moments.index(added)]


def test_without_rows_the_last_motion_starts_and_then_the_guess():
    problem = past(swing(), FAR)
    assert list(Exchange(problem).starts(straight())) == [(problem, straight()), (problem, None)]


def test_every_node_is_looked_at_once():
    problem = landing(free=True)
    solution = solve(problem, transcription="radau:2", intervals=9)
    moments = Exchange(problem).look(solution).moments
    bounds = [solution.interval_t[solution.intervals_of(phase)][[0, -1], [0, 1]] for phase in range(3)]
    times = [bounds[phase] @ [1 - fraction, fraction] for phase, fraction in moments]
    assert np.diff(times).min() > 1e-4
    assert {phase for phase, _ in moments} == {0, 1, 2}
    assert (2, 1.0) in moments
    assert (0, 1.0) not in moments


def test_faster_intervals_are_looked_at_more_often():
    counts = [len(Exchange(past(swing(), FAR)).look(solve(swing(), intervals=n)).moments) for n in (3, 100)]
    assert counts[0] > float(np.abs(END - START).max()) / LOOK_STEP
    assert counts[1] == pytest.approx(100 * (INTERVAL_LOOKS + 3), rel=0.02)


def test_rows_stay_when_the_motion_has_left():
    exchange, _ = begun(past(swing(), BALL, FAR), straight())
    moments = set(exchange.moments[PAIR])
    aside = exchange.constrained(lambda phases, fractions: np.tile([-2.0, 0.0, 0.0], (len(phases), 1)))
    (term,) = planes(aside)
    assert {(0, float(f)) for f in term.fractions} == moments
    exchange.add(exchange.look(avoided()[1]))
    assert exchange.moments[PAIR] >= moments


def test_a_pair_that_slips_through_time_and_again_has_rows_wherever_it_was_seen_too_near():
    exchange, look = begun(past(swing(), BALL, FAR), straight())
    column = exchange.bodies.pairs.index(PAIR)
    lacking = look.distances[:, column] < exchange._least[column]
    seen = {moment for moment, missed in zip(look.moments, lacking, strict=True) if missed}
    for _ in range(MOST_SLIPS):
        exchange.add(look)
        assert not seen <= exchange.moments[PAIR]
    exchange.add(look)
    assert seen <= exchange.moments[PAIR]


def test_a_foot_that_stands_in_the_ground_may_get_no_deeper_than_the_check_allows():
    exchange = Exchange(problems.load("biped-run", robot="talos"))
    column = exchange.bodies.pairs.index(("leg_left_6_link", "ground"))
    margin = exchange.bodies.margins[column]
    assert -PENETRATION < margin < -PENETRATION + GAP_SLACK
    found = [exchange.depth(touching(exchange, column, depth)) for depth in (-margin, 1.1 * PENETRATION)]
    assert found == pytest.approx([0.0, 0.1 * PENETRATION])


def touching(exchange: Exchange, column: int, depth: float) -> Look:
    """A look at one moment with one pair so deep, m, and all others apart."""
    distances = np.full((1, len(exchange.bodies.pairs)), np.inf)
    distances[0, column] = -depth
    return Look(distances=distances, moments=((0, 0.0),), regular=np.array([True]))


def test_corners_stay_once_they_have_a_row():
    exchange, _ = begun(past(swing(), BALL, FAR), straight())
    before, again, once = (
        np.concatenate([term.parameters for term in planes(exchange.constrained(motion))])
        for motion in (exchange.guess, along(avoided()[1]), along(avoided()[1]))
    )
    assert len(again) >= len(before)
    assert once == pytest.approx(again)


def test_guess_is_clear_where_it_is_apart_at_the_rows():
    up = np.array([0.4, 0.0, 0.0])  # the guess stays short of the ball
    problem = past(swing(), BALL, FAR)
    aside = replace(
        problem, guess=PosturePath(model=rods().model, postures=(START, -up, START), durations=(0.75, 0.75))
    )
    for given, clear in ((problem, False), (aside, True)):
        exchange = Exchange(given)
        assert exchange.guess_is_clear()  # without rows
        exchange.add(exchange.look(straight()))
        assert exchange.guess_is_clear() is clear


def test_guess_is_taken_at_the_time_of_its_phase():
    exchange = Exchange(past(swing(), BALL))
    assert exchange.guess(np.array([0]), np.array([0.25]))[0] == pytest.approx(
        swing().guess_at(0.25 * DURATION)
    )
    legged = Exchange(hop())
    assert legged.guess(np.array([0, 2]), np.array([0.1, 0.5]))[1] == pytest.approx(
        hop().guess_at(0.3 + 0.2 + 0.15)
    )


def test_what_may_be_passed_on_several_sides_is_no_ground_and_no_fitted_links():
    robot = replace(rods(), reference=np.array([0.0, 1.0, 1.0]))
    ahead = np.array([0.6, 0.0, 0.0])
    exchange = Exchange(past(swing(end=ahead, robot=robot), BALL, self_collision=True))
    pairs = exchange.bodies.pairs
    deep = Look(
        distances=-1e-3 * np.arange(1.0, len(pairs) + 1)[None], moments=((0, 0.5),), regular=np.ones(1)
    )
    sided = [number for number, (_, other) in enumerate(pairs) if other == "ball"]
    assert exchange.depth(deep) == pytest.approx(1e-3 * len(pairs), abs=2 * MARGIN)
    least = exchange.bodies.margins[sided] - GAP_SLACK
    deepest = np.max(least + 1e-3 * (np.array(sided) + 1))
    assert exchange.sideless_depth(deep, known=False) == pytest.approx(deepest)
    exchange.moments.update({pair: set() for pair in pairs})
    assert exchange.sideless_depth(deep, known=False) == 0
    assert exchange.sideless_depth(deep, known=True) == pytest.approx(deepest)


def test_multipliers_of_fitted_distances_go_on_to_the_next_round():
    robot = replace(rods(), reference=np.array([0.0, 1.0, 1.0]))
    folding = swing(np.array([0.0, 1.2, 2.7]), np.array([0.0, 2.6, 1.4]), robot=robot)
    problem = past(folding, self_collision=True, margin=0.028)
    exchange, _ = begun(problem, solve(problem))
    solution = solve(exchange.constrained(along(solve(problem))))
    exchange.take_up(solution)
    (pair,) = exchange.moments
    assert exchange.fits.joints(pair) == (2, 3)
    again = exchange.constrained(along(solution))
    finer = prepare(again, transcription="legendre:3", intervals=37, start=solution)
    rows, name = finer.transcription.rows, "clearance by joint1, joint2"
    before, after = (
        multipliers[block == names.index(name)].sum()
        for names, block, multipliers in (
            (solution.statistics.row_names, solution.row_place[:, 0], solution.row_multiplier),
            (rows.names, rows.block, finer.warm.lam_g),
        )
    )
    assert before < -1e-6
    assert after == pytest.approx(before)


def test_rows_move_to_a_problem_with_other_parameters():
    exchange, _ = begun(past(swing(), BALL, FAR), straight())
    exchange.constrained(along(straight()))
    nearer = replace(BALL, radius=0.12)
    moved = exchange.moved_to(past(swing(), nearer, FAR))
    assert moved.moments == exchange.moments
    assert moved.bodies.scene.obstacles[0].radius == 0.12
    assert moved.corners
    assert all(frame is not None for _, _, frame, _ in moved.corners)
    moved.moments.clear()
    assert exchange.moments
    assert exchange.moved_to(past(swing(), FAR)).moments == {}  # its pairs are no pairs there


def test_depth_is_how_much_too_near_the_worst_pair_is():
    exchange, look = begun(past(swing(), BALL, FAR), straight())
    short = (look.distances - exchange.bodies.margins).min()
    assert exchange.depth(look) == pytest.approx(-GAP_SLACK - short)
    assert exchange.depth(exchange.look(avoided()[1])) == 0.0
    assert Exchange(swing()).depth(Exchange(swing()).look(straight())) == 0.0  # no bodies


def test_corners_of_the_motion_that_was_too_near_have_rows_too():
    exchange, _ = begun(past(swing(), BALL, FAR), straight())
    alone = planes(exchange.constrained(exchange.guess, exchange.guess))
    both, _ = begun(past(swing(), BALL, FAR), straight())
    more = planes(both.constrained(both.guess, along(straight())))
    assert len(more[0].fractions) >= len(alone[0].fractions)
    assert set(both.corners) >= set(exchange.corners)


def test_bodies_of_a_hopper_have_rows_in_the_phases_where_they_are_near():
    free, solution = hop(), solve(hop())
    data, places = free.robot.model.createData(), []
    for q in solution.q:
        pin.framesForwardKinematics(free.robot.model, data, q)
        places.append(data.oMf[free.robot.model.getFrameId(FOOT)].translation.copy())
    top = max(places, key=lambda place: place[2])
    above = SphereObstacle(name="above", centre=top + 0.3 * np.eye(3)[2], radius=0.3)
    shape = LinkShape.sphere("toe", FOOT, np.zeros(3), 0.01)
    problem = replace(free, terms=(*free.terms, Clearance(obstacles=(above,), shapes=(shape,))))
    exchange, look = begun(problem, solution)
    assert ("toe", "above") in exchange.missing(look)
    terms = planes(exchange.constrained(along(solution)))
    assert "flight" in {term.during for term in terms}
    assert {(term.frame, term.body) for term in terms} == {(FOOT, None)}


def test_a_foot_that_its_contact_holds_on_the_ground_has_no_rows_there():
    free, solution = hop(), solve(hop())
    toe = LinkShape.sphere("toe", FOOT, np.zeros(3), 0.01)  # it stands 1 cm deep
    shank = LinkShape.capsule("shank", FOOT, np.zeros(3), 0.1 * np.eye(3)[2], 0.01)  # and may lie down
    problem = replace(free, terms=(*free.terms, Clearance(shapes=(toe, shank))))
    exchange = Exchange(problem)
    look = exchange.look(solution)
    columns = {pair[0]: column for column, pair in enumerate(exchange.bodies.pairs) if pair[1] == "ground"}
    standing = np.array([bool(problem.schedule.phases[phase].contacts) for phase, _ in look.moments])
    assert standing.any()
    assert not standing.all()
    assert np.isinf(look.distances[standing, columns["toe"]]).all()
    assert np.isfinite(look.distances[~standing, columns["toe"]]).all()
    assert np.isfinite(look.distances[:, columns["shank"]]).all()


BETWEEN = 2e-3  # m; what one more round would gain
EQUAL = 1e-6  # of the objective; the solver's tolerance
# A link may be this deep in the ground, m; looked at this many times a second.
DEPTH, RATE = 1e-3, 1000


def least(problem: Problem, solution: Solution) -> float:
    """Least distance less the margin along a motion, m."""
    exchange = Exchange(problem)
    return float((exchange.look(solution).distances - exchange.bodies.margins).min())


def test_clear_motion_is_solved_once():
    problem = past(swing(), FAR)
    solution = solve_graded(problem, fixed_mesh=True)
    assert solution.statistics.constraints == solve(swing()).statistics.constraints
    assert check(solution).obstacle_distance > 1


def test_motion_through_the_ball_is_led_past_it_at_the_margin():
    problem, solution = avoided()
    assert least(problem, solve(problem)) < -0.05
    assert solution.success
    report = check(solution)
    assert report.ok, report.failures()
    assert -GAP_SLACK < least(problem, solution) < BETWEEN
    assert report.obstacle_distance == pytest.approx(MARGIN, abs=BETWEEN)
    assert report.self_distance is None


def test_pole_is_not_passed_between_points():
    problem = past(swing(), POLE)
    slipped = solve(problem)
    assert least(problem, slipped) < -0.1
    solution = solve_graded(problem, fixed_mesh=True)
    assert solution.success
    assert least(problem, solution) > -GAP_SLACK
    assert check(solution).ok


@pytest.mark.parametrize("side", [1, -1])
def test_obstacle_in_the_way_is_passed_on_the_side_of_the_guess(side):
    bent = np.array([0.45, 1.2 * side, 0.0])
    guess = PosturePath(model=rods().model, postures=(START, bent, END), durations=(0.75, 0.75))
    problem = past(swing(guess=guess), POLE)
    solution = solve_graded(problem, fixed_mesh=True)
    assert solution.success
    assert least(problem, solution) > -GAP_SLACK
    elbow = solution.q[:, 1]
    assert side * elbow[np.abs(elbow).argmax()] > 0.3


def test_links_keep_clear_of_each_other():
    """Folding from one side to the other: the straight way dips below the margin, both ends do not."""
    robot = replace(rods(), reference=np.array([0.0, 1.0, 1.0]))
    problem = past(
        swing(np.array([0.0, 1.2, 2.7]), np.array([0.0, 2.6, 1.4]), robot=robot),
        self_collision=True,
        margin=0.028,
    )
    assert least(problem, solve(problem)) < -5 * GAP_SLACK
    solution = solve_graded(problem, fixed_mesh=True)
    assert solution.success
    assert -GAP_SLACK < least(problem, solution) < BETWEEN
    report = check(solution)
    assert report.self_distance == pytest.approx(0.028, abs=BETWEEN)
    assert report.obstacle_distance is None


def test_without_self_collision_links_may_come_near():
    robot = replace(rods(), reference=np.array([0.0, 1.0, 1.0]))
    ends = np.array([0.0, 1.2, 2.7]), np.array([0.0, 2.6, 1.4])
    problem = past(swing(*ends, robot=robot), self_collision=False, margin=0.028)
    solution = solve_graded(problem, fixed_mesh=True)
    assert solution.statistics.objective == pytest.approx(
        solve(swing(*ends, robot=robot)).statistics.objective, rel=EQUAL
    )


def test_motion_that_is_not_solved_is_returned_as_it_is():
    problem = past(swing(), BALL)
    solution = solve_graded(problem, fixed_mesh=True, max_iterations=0)
    assert not solution.success


def test_goal_in_an_obstacle_is_refused_before_anything_is_solved():
    over = replace(BALL, centre=np.array([1.3, 0.0, 0.5]))
    iterations = []
    with pytest.raises(InputError, match=r"'joint2' in q of terminal_state is .* m from 'ball'"):
        solve_graded(past(swing(), over), progress=iterations.append)
    assert not iterations


def test_way_that_is_barred_is_returned_with_what_is_missing():
    """A ball in the way of the first link, which turns about a fixed axis."""
    barred = replace(BALL, centre=np.array([0.15, 0.0, 0.3]))
    problem = past(swing(), barred)
    solution = solve_graded(problem, fixed_mesh=True, max_iterations=60)
    exchange = Exchange(problem)
    assert ("joint0", "ball") in exchange.missing(exchange.look(solution))
    assert "obstacle_distance" in check(solution).failures()
    assert not solution.success


def depth_in_ground(robot: Robot, solution: Solution) -> float:
    """Largest depth, m, of the description's own collision geometry in level ground, by Coal at 1 kHz."""
    geometry = robot.visual.geometry(robot.model, pin.GeometryType.COLLISION)
    for entry in geometry.geometryObjects:
        if isinstance(entry.geometry, coal.BVHModelBase):
            entry.geometry.buildConvexHull(True, "Qt")
            entry.geometry = entry.geometry.convex
    ground, still = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0), coal.Transform3s()
    motion, data, deepest = SolutionMotion(solution), robot.model.createData(), -np.inf
    places = pin.GeometryData(geometry)
    for t in np.arange(solution.t[0], solution.t[-1], 1 / RATE):
        pin.updateGeometryPlacements(robot.model, data, geometry, places, motion(float(t)))
        for entry, place in zip(geometry.geometryObjects, places.oMg, strict=True):
            at = coal.Transform3s(place.rotation, place.translation)
            request, result = coal.DistanceRequest(), coal.DistanceResult()
            deepest = max(deepest, -coal.distance(entry.geometry, at, ground, still, request, result))
    return deepest


@pytest.mark.slow
def test_knees_of_a_far_jump_stay_out_of_the_ground():
    problem = trajopt.load("solo12-jump", distance=0.8)
    grid = {"transcription": "legendre:3", "intervals": 20}
    assert depth_in_ground(problem.robot, solve(problem, **grid)) > 0.1
    solution = solve_graded(problem, **grid)
    assert solution.converged
    assert least(problem, solution) > -GAP_SLACK
    assert {"link_depth", "self_distance"}.isdisjoint(check(solution).failures())
    assert depth_in_ground(problem.robot, solution) < DEPTH
