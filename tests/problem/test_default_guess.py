"""What a problem need not say: the guess, goals at their moments, ground, start, directions of rest."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import trajopt
from tests.support.problems import one_phase
from trajopt import FlatGround, Phase, Problem, Robot, Schedule, end_of, middle_of, terms
from trajopt.dynamics import STANDARD_GRAVITY
from trajopt.problem import Periodicity, PosturePath, default_guess
from trajopt.robot import contact_positions, edge_contacts, frame_pose, with_edges
from trajopt.schedule import footholds_at
from trajopt.solving.solving import solve
from trajopt.terms import TerminalRest
from trajopt.terrain import Ramp, SmoothTerrain
from trajopt_library import robots
from trajopt_library.problems.bipeds import biped

# Of inverse kinematics, m.
REACHED = 1e-6
# Of heels that land below the path of postures, which bends the legs along joint angles, rad and m.
LANDED = 1e-3
# Central differences over this step, s, of polynomials of order one.
STEP, DIFFERENCE = 1e-5, 1e-8
FORWARD = np.array([0.06, 0.0, 0.0])
TIMES = np.linspace(0.0, 1.0, 21)
EFFORT = terms.TorqueCost(weight=1.0)


def leap(robot: Robot, *, by: float = FORWARD[0], landed: bool = True) -> Problem:
    """All contacts, none, and all again on footholds ahead."""
    feet = tuple(contact.name for contact in robot.contacts)
    goal = robot.reference.copy()
    goal[0] += by
    footholds = footholds_at(robot, goal) if landed else {}
    phases = (
        Phase(name="push", duration=0.4, contacts=feet),
        Phase(name="flight", duration=0.2),
        Phase(name="landing", duration=0.4, contacts=feet, footholds=footholds),
    )
    return Problem(
        name="leap", robot=robot, schedule=Schedule(phases), terms=(EFFORT, terms.TerminalState(q=goal))
    )


def feet_of(robot: Robot) -> dict[str, np.ndarray]:
    """Positions of the contacts that stand in the reference posture; hands are higher."""
    places = contact_positions(robot, robot.reference)
    lowest = min(place[2] for place in places.values())
    return {name: place for name, place in places.items() if place[2] < lowest + 0.01}


def step(robot: Robot) -> Problem:
    """The first foot is put forward, then the second one is lifted and put down where it was."""
    first, second, *others = feet_of(robot)
    there = {first: footholds_at(robot, robot.reference)[first] + FORWARD}
    phases = (
        Phase(name="first", duration=0.5, contacts=(second, *others)),
        Phase(name="second", duration=0.3, contacts=(first, *others), footholds=there),
        Phase(name="end", duration=0.2, contacts=(first, second, *others)),
    )
    return Problem(name="step", robot=robot, schedule=Schedule(phases), terms=(EFFORT,))


@pytest.mark.parametrize("name", ["solo12", "anymal_c", "talos"])
def test_feet_stand_still_on_their_footholds_and_swing_above_the_ground(name: str) -> None:
    robot = robots.load(name)
    problem, here = step(robot), feet_of(robot)
    first, second, *others = here
    for t in TIMES:
        places = contact_positions(robot, problem.guess_at(t))
        for contact in others:
            assert_allclose(places[contact], here[contact], atol=REACHED)
        if t <= 0.5 or t >= 0.8:
            assert_allclose(places[second], here[second], atol=REACHED)
        if t >= 0.5:
            assert_allclose(places[first], here[first] + FORWARD, atol=REACHED)
    lifted = contact_positions(robot, problem.guess_at(0.25))[first]
    assert lifted[2] > here[first][2] + 0.1 * robot.length


@pytest.mark.parametrize("name", ["solo12", "solo12 with a virtual base", "hopper"])
def test_flight_is_a_free_fall_for_base_and_feet(name: str) -> None:
    robot = robots.load(name.split()[0])
    robot = robot.with_virtual_base() if "virtual" in name else robot
    problem = leap(robot)
    before, apex, after = (problem.guess_at(t) for t in (0.4, 0.5, 0.6))
    height = 2 if robot.base != "planar" else 1
    rise = apex[height] - 0.5 * (before[height] + after[height])
    assert rise == pytest.approx(STANDARD_GRAVITY * 0.2**2 / 8, rel=1e-3)
    ground = contact_positions(robot, robot.reference)
    for contact, place in contact_positions(robot, apex).items():
        assert place[2] > ground[contact][2] + 0.9 * rise


def test_goals_are_reached_at_their_moments() -> None:
    robot = robots.load("ur5")
    first, second = np.array([0.45, 0.25, 0.55]), np.array([0.55, -0.05, 0.35])
    turned = pin.rpy.rpyToMatrix(0.3, 0.2, 0.1) @ frame_pose(robot, robot.reference, "tool0").rotation
    problem = Problem(
        name="waypoints",
        robot=robot,
        schedule=Schedule((Phase(name="first", duration=0.7), Phase(name="second", duration=0.3))),
        terms=(
            terms.FramePose(frame="tool0", position=first, at=end_of("first")),
            terms.FramePose(frame="tool0", position=second, rotation=turned),
        ),
    )
    assert_allclose(problem.guess_at(0.0), robot.reference)
    assert_allclose(frame_pose(robot, problem.guess_at(0.7), "tool0").translation, first, atol=REACHED)
    end = frame_pose(robot, problem.guess_at(1.0), "tool0")
    assert_allclose(end.translation, second, atol=REACHED)
    assert_allclose(end.rotation, turned, atol=REACHED)
    assert_allclose(problem.guess_at(1.2), problem.guess_at(1.0))


def test_a_rotation_alone_is_reached_in_place() -> None:
    robot = robots.load("ur5")
    here = frame_pose(robot, robot.reference, "tool0")
    turned = here.rotation @ pin.rpy.rpyToMatrix(0.0, 0.0, 0.4)
    schedule = Schedule((Phase(name="all", duration=1.0),))
    guess = default_guess(robot, schedule, [terms.FramePose(frame="tool0", rotation=turned)])
    end = frame_pose(robot, guess(1.0), "tool0")
    assert_allclose(end.rotation, turned, atol=REACHED)
    assert_allclose(end.translation, here.translation, atol=REACHED)


def test_a_base_is_carried_to_where_its_feet_land() -> None:
    robot = robots.load("solo12")
    schedule = leap(robot, by=0.3).schedule
    base = robot.reference[:3] + np.array([0.3, 0.0, 0.02])
    guess = default_guess(robot, schedule, [terms.FramePose(frame="base_link", position=base)])
    assert_allclose(guess(1.0)[:3], base, atol=REACHED)


def test_a_landing_without_foothold_is_on_the_ground_below() -> None:
    robot, hill = robots.load("solo12"), SmoothTerrain(shapes=(Ramp(rise=0.05, length=0.3, at=(0.4, 0.0)),))
    goal = robot.reference.copy()
    goal[:3] += [0.8, 0.0, 0.05]
    schedule = leap(robot, landed=False, by=0.0).schedule
    guess = default_guess(robot, schedule, [terms.TerminalState(q=goal)], terrain=hill)
    radius = robot.contacts[0].radius
    for x, y, z in contact_positions(robot, guess(0.7)).values():
        assert z - radius == pytest.approx(float(hill.height(x, y)), abs=1e-3)


def test_a_frame_is_raised_to_its_height_in_mid_phase_and_heels_turn_about_standing_toes() -> None:
    robot = with_edges(biped("g1"))
    toes, corners = [], [contact.name for contact in robot.contacts]
    for sole in ("left", "right"):
        toes += edge_contacts(sole, "toe")
    phases = (
        Phase(name="flat", duration=0.5, contacts=corners),
        Phase(name="toes", duration=0.5, contacts=toes),
        Phase(name="down", duration=0.5, contacts=corners),
    )
    base, height = str(robot.model.names[1]), float(robot.reference[2]) + 0.03
    goals = (
        terms.FrameHeight(frame=base, height=height, at=middle_of("toes")),
        terms.TerminalState(q=robot.reference),
    )
    guess = default_guess(robot, Schedule(phases), goals)
    assert guess(0.75)[2] == pytest.approx(height, abs=REACHED)
    assert_allclose(guess(1.5), robot.reference, atol=LANDED)
    here = contact_positions(robot, robot.reference)
    for name, place in contact_positions(robot, guess(0.75)).items():
        if name in toes:
            assert_allclose(place, here[name], atol=REACHED)
        else:
            assert place[2] > here[name][2] + 0.005


def test_a_periodic_motion_ends_at_the_image_of_its_start() -> None:
    robot = robots.load("solo12")
    feet = tuple(contact.name for contact in robot.contacts)
    phases = Phase(name="stance", duration=0.5, contacts=feet), Phase(name="flight", duration=0.1)
    problem = Problem(
        name="cycle",
        robot=robot,
        schedule=Schedule(phases),
        terms=(EFFORT,),
        periodicity=Periodicity(velocity=(0.5, 0.0, 0.0)),
    )
    assert_allclose(problem.guess_at(0.6)[:3] - problem.guess_at(0.0)[:3], [0.3, 0.0, 0.0], atol=REACHED)


def test_posture_path_rests_at_every_posture_and_stays_at_the_last() -> None:
    model = robots.load("ur5").model
    start, middle, end = np.random.default_rng(0).uniform(-1.0, 1.0, (3, model.nq))
    path = PosturePath(model=model, postures=(start, middle, end), durations=(2.0, 1.0))
    half = (start + middle) / 2
    for t, q in ((-1.0, start), (0.0, start), (1.0, half), (2.0, middle), (3.0, end), (4.0, end)):
        assert_allclose(path(t), q, atol=1e-15)
    for t, fastest in ((0.0, 0.0), (1.0, 1.875 / 2.0), (2.0, 0.0), (3.0, 0.0)):
        rate = (path(t + STEP) - path(t - STEP)) / (2 * STEP)
        assert_allclose(rate, fastest * (middle - start), atol=DIFFERENCE)


def test_an_arm_finds_its_way_without_a_guess() -> None:
    robot = robots.load("ur5")
    goal = terms.FramePose(frame="tool0", position=np.array([0.45, 0.25, 0.55]))
    effort = terms.AccelerationCost(weight=1.0), terms.TorqueLimits()
    problem = one_phase(robot, *effort, goal, terms.TerminalRest())
    assert trajopt.solve(problem).statistics.success


@pytest.mark.long
@pytest.mark.parametrize("name", ["solo12", "go2"])
def test_a_quadruped_leaps_without_a_guess(name: str) -> None:
    problem = leap(robots.load(name), by=0.2)
    limits = terms.TorqueLimits(), terms.PositionLimits(), terms.VelocityLimits(), terms.FrictionPyramid()
    costs = terms.effort_costs(acceleration=1e-2)
    goal = problem.terms[1]
    problem = replace(problem, terms=(*costs, *limits, goal, terms.TerminalRest()))
    found = trajopt.solve(problem)
    assert found.statistics.success, trajopt.check(found).failures()


# Two solves of one optimum, whose rows of rest are taken at different postures.
SAME_OBJECTIVE = 1e-5
# Velocity at rest, m/s and rad/s: what contacts hold is an acceleration, whose integral drifts a little.
REST = 2e-4


@pytest.fixture(scope="module", params=["ur5-reach", "solo12-jump"])
def problem(request: pytest.FixtureRequest) -> Problem:
    return trajopt.load(request.param)


@pytest.mark.long
def test_ground_and_start_have_defaults(problem):
    needed = {name: getattr(problem, name) for name in ("name", "robot", "schedule", "terms", "guess")}
    if problem.robot.base == "fixed":
        needed["guess"] = lambda t: problem.robot.reference
        needed["terms"] = [term for term in problem.terms if not term.targets()]
    made = Problem(**needed)
    assert made.terrain == FlatGround()
    assert_array_equal(made.initial_q, problem.robot.reference)
    assert_array_equal(made.initial_v, np.zeros(problem.robot.nv))


@pytest.mark.long
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
