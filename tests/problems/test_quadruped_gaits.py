"""Gaits and leaps of quadrupeds: what is commanded, planned and guessed, and what is solved."""

import math
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.refusals import refused_calls
from tests.support.solved_problems import motion
from trajopt import InputError, Schedule, check
from trajopt.certify.report import AT_POINTS
from trajopt.collision import robot_shapes
from trajopt.dynamics import contact_jacobian, gravity_of
from trajopt.reduced import Pace, plan_of_cycle
from trajopt.reduced.gaits import base_pose
from trajopt.robot import contact_positions, frame_pose, leg_joints, quadruped_legs
from trajopt.robot.mirror import find_mirror, mirrored_configuration
from trajopt.schedule import QUADRUPED, footholds_at, transition
from trajopt.solving.solving import solve
from trajopt.terms import FrameDirection, FramesAbove, TerminalVelocity
from trajopt_library import problems, robots
from trajopt_library.problems import (
    common,
    leaping,
    pushing,
    quadruped_box,
    quadruped_flip,
    quadruped_jump,
    quadruped_stand_up,
)
from trajopt_library.problems.gait_common import STYLES

# Iterations within which every example is to solve from its own guess.
MOST_ITERATIONS = 60
# Closed forms and inverse kinematics, m and rad.
ROUNDING = 1e-9
# States in which plans of a start and a stop meet, rad, and rad/s or m/s: equal but for a flight of a gallop
# whose first part is within the time in which the pace grows.
MEETING, MEETING_RATE = 1e-5, 1e-3
# A solver that stops at 1e-6 in natural units leaves this of equal states, m, rad and their rates.
SOLVED = 1e-4
# The same motion as a whole cycle and as half of one: a robot that is symmetric to 1e-3 of its size.
SAME_OPTIMUM = 1e-3
# Second differences over 1 ms, m/s^2: rounding of positions of 1e-10 m.
BALLISTIC = 1e-2

OTHER_SIDE = {
    f"{end}_{side}": f"{end}_{other}"
    for end in ("front", "hind")
    for side, other in (("left", "right"), ("right", "left"))
}


@pytest.mark.parametrize("turn_rate", [0.0, 0.7])
def test_a_pace_is_the_integral_of_its_velocity(turn_rate: float) -> None:
    pace = Pace(velocity=(0.6, -0.2), turn_rate=turn_rate, starts=(0.1, 0.5), stops=(0.8, 1.3))
    steps = 20000
    times = (np.arange(steps) + 0.5) / steps * 1.5
    position, angle = np.zeros(2), 0.0
    for t in times:
        part = pace.part(t) * 1.5 / steps
        middle = angle + turn_rate * part / 2
        turned = np.array([[math.cos(middle), -math.sin(middle)], [math.sin(middle), math.cos(middle)]])
        position += turned @ np.array(pace.velocity) * part
        angle += turn_rate * part
    found, turned_by = pace.pose(1.5)
    assert_allclose(found, position, atol=1e-7)
    assert_allclose(turned_by, angle, atol=1e-7)
    assert [pace.part(t) for t in (0.0, 0.6, 1.4)] == [0.0, 1.0, 0.0]


def test_default_speeds_are_froude_numbers_and_strides_those_of_mammals() -> None:
    for name in ("solo12", "anymal_c"):
        robot = robots.load(name)
        for style, own in STYLES.items():
            speed = own.speed(robot)
            froude = speed**2 / (gravity_of(robot.model) * robot.length)
            assert_allclose(froude, own.froude)
            stride = own.period(robot, speed) * speed / robot.length
            symmetric = QUADRUPED[style].is_symmetric(OTHER_SIDE)
            expected = 2.4 * froude**0.34 if symmetric else 1.9 * froude**0.40
            assert_allclose(stride, expected)
            assert_allclose(own.period(robot, 0.0), own.period(robot, speed))


@pytest.mark.parametrize("style", list(STYLES))
def test_planned_feet_are_under_their_hips_in_mid_stance(style: str) -> None:
    """Against v (touchdown + duty / 2) from the gait's own numbers, straight ahead."""
    problem = problems.load(f"quadruped-{style}", footholds="planned")
    robot, period, speed = problem.robot, problem.schedule.duration, problem.parameters["speed"]
    gait = QUADRUPED[style].on(quadruped_legs(robot).by_role)
    nominal = footholds_at(robot, robot.reference)
    begin, origin = 0.0, min(gait.offsets.values())
    landed = set()
    for phase in problem.schedule.phases:
        for name, place in phase.footholds.items():
            middle = begin + gait.duty_of(name) * period / 2
            assert_allclose(place, nominal[name] + [speed * middle, 0.0, 0.0], atol=ROUNDING)
            periods = begin / period + origin - gait.offsets[name]
            assert_allclose(periods, np.round(periods), atol=ROUNDING)
            landed.add(name)
        begin += phase.duration
    assert landed == set(gait.feet)


def test_guess_is_periodic_and_its_stance_feet_stand() -> None:
    for style in ("walk", "gallop"):
        problem = problems.load(f"quadruped-{style}", turn_rate=0.4)
        robot, period = problem.robot, problem.schedule.duration
        first, last = problem.guess(0.0), problem.guess(period)
        assert_allclose(first[7:], last[7:], atol=ROUNDING * 10)
        pace = Pace(velocity=(problem.parameters["speed"], 0.0), turn_rate=0.4)
        step = base_pose(robot, pace, period) * base_pose(robot, pace, 0.0).inverse()
        moved = step * pin.XYZQUATToSE3(first[:7])
        assert_allclose(pin.SE3ToXYZQUAT(moved)[:3], last[:3], atol=ROUNDING)
        begin = 0.0
        for phase in problem.schedule.phases:
            edge = 1e-6 * period
            places = [
                contact_positions(robot, problem.guess(t))
                for t in (begin + edge, begin + phase.duration / 2, begin + phase.duration - edge)
            ]
            for name in phase.contacts:
                for place in places:
                    assert_allclose(place[name], places[0][name], atol=1e-6)
            begin += phase.duration


def test_base_of_the_guess_falls_freely_in_flight() -> None:
    problem = problems.load("quadruped-pronk")
    stance, flight = problem.schedule.phases
    middle, step = stance.duration + flight.duration / 2, 1e-3
    before, now, after = (problem.guess(middle + offset)[:3] for offset in (-step, 0.0, step))
    assert_allclose((before - 2 * now + after) / step**2, [0, 0, -9.81], atol=BALLISTIC)


def test_states_of_a_plan_have_their_contacts_at_rest() -> None:
    robot = robots.load("go2")
    gait = QUADRUPED["trot"].on(quadruped_legs(robot).by_role)
    cycle = Schedule(gait.phases(0.5))
    plan = plan_of_cycle(robot, cycle, Pace(velocity=(0.6, 0.0)), clearance=0.04)
    q, v = plan.state(robot, 0.0, gait.feet)
    rates = contact_jacobian(robot.model, q, [(c.frame, c.rows) for c in robot.contacts]) @ v
    assert_allclose(rates, 0.0, atol=ROUNDING)
    assert_allclose(v[:3], [0.6, 0.0, 0.0], atol=1e-3)


def test_transitions_lift_feet_when_they_are_due_and_leave_them_where_they_land() -> None:
    trot = QUADRUPED["trot"]
    go = transition(trot, 0.5, cycles=2, stand=0.3, rest=0.2)
    assert [phase.name for phase in go] == ["stand", "double_1", "double_2", "double_3", "double_4", "rest"]
    assert_allclose([phase.duration for phase in go], [0.3, 0.25, 0.25, 0.25, 0.25, 0.2])
    assert set(go[0].contacts) == set(go[-1].contacts) == set(trot.feet)
    start = transition(trot, 0.5, cycles=2, stand=0.3)
    assert [phase.contacts for phase in start[1:]] == [phase.contacts for phase in trot.phases(0.5, cycles=2)]
    stop = transition(trot, 0.5, cycles=2, rest=0.2)
    assert [phase.contacts for phase in stop[:-1]] == [phase.contacts for phase in trot.phases(0.5, cycles=2)]
    pronk = transition(QUADRUPED["pronk"], 0.5, cycles=1, stand=0.3, rest=0.2)
    assert [phase.name for phase in pronk] == ["stand", "flight_1", "rest"]


@pytest.mark.parametrize("style", list(QUADRUPED))
@pytest.mark.parametrize("ends", [(0.3, None), (None, 0.3), (0.3, 0.3)])
def test_transitions_keep_swings_whole_and_the_gaits_stances(
    style: str, ends: tuple[float | None, float | None]
) -> None:
    gait, period = QUADRUPED[style], 1.0
    phases = transition(gait, period, cycles=3, stand=ends[0], rest=ends[1])
    schedule = Schedule(phases)
    begins = np.cumsum([0.0, *(phase.duration for phase in phases)])
    for foot in gait.feet:
        swings = []
        for i, phase in enumerate(phases):
            if foot not in phase.contacts:
                lifted = i and foot in phases[i - 1].contacts
                swings = [*swings, [begins[i], begins[i + 1]]] if lifted or not i else swings
                swings[-1][1] = begins[i + 1]
        whole = [s for s in swings if s[0] > 0 and s[1] < schedule.duration - ROUNDING]
        assert whole
        for begin, end in whole:
            assert_allclose(end - begin, 1 - gait.duty_of(foot), atol=ROUNDING)


def test_footholds_of_a_transition_are_where_its_guess_lands() -> None:
    problem = problems.load("quadruped-go", gait="walk")
    begin = 0.0
    for phase in problem.schedule.phases:
        places = footholds_at(problem.robot, problem.guess(begin + 1e-9))
        for name, foothold in phase.footholds.items():
            assert_allclose(places[name], foothold, atol=1e-6)
        begin += phase.duration


@pytest.mark.parametrize("style", ["trot", "walk", "gallop", "pronk"])
def test_a_start_is_to_end_where_the_stop_of_the_same_gait_begins(style: str) -> None:
    start, stop = (problems.load(f"quadruped-{kind}", gait=style) for kind in ("start", "stop"))
    end = next(term for term in start.terms if isinstance(term, TerminalVelocity))
    assert_allclose(end.q[2:], stop.initial_q[2:], atol=MEETING)
    assert_allclose(end.v, stop.initial_v, atol=MEETING_RATE)
    speed = start.parameters["speed"]
    assert_allclose(stop.initial_v[[0, 1, 3, 4, 5]], [speed, 0, 0, 0, 0], atol=1e-2 * speed)


def test_what_cannot_be_commanded_is_refused() -> None:
    for name, values in (
        ("quadruped-trot", {"robot": "talos"}),
        ("quadruped-trot", {"robot": "ur5"}),
        ("quadruped-trot", {"cycle": "half", "turn_rate": 0.2}),
        ("quadruped-trot", {"cycle": "half", "lateral": 0.2}),
        ("quadruped-bound", {"cycle": "half"}),
        ("quadruped-trot", {"duty": 0.503}),
        ("quadruped-trot", {"goal": "transport", "speed": 0.0}),
        ("quadruped-trot", {"period": 0.0}),
        ("quadruped-start", {"cycles": 1}),
        ("quadruped-stop", {"cycles": 1}),
        ("quadruped-start", {"cycles": 2.5}),
        ("quadruped-stop", {"gait": "moonwalk"}),
        ("quadruped-stop", {"stand": 0.0}),
    ):
        with pytest.raises(InputError, match="allowed"):
            problems.load(name, **values)
    with pytest.raises(InputError, match="more cycles"):
        transition(QUADRUPED["walk"], 1.0, cycles=1, stand=0.3, rest=0.3)
    with pytest.raises(InputError, match="allowed"):
        Pace(velocity=(math.nan, 0.0))
    with pytest.raises(InputError, match="allowed"):
        Pace(velocity=(0.1, 0.0), starts=(0.5, 0.5))


@pytest.mark.slow
def test_trot_solves_as_a_whole_cycle_and_as_half_of_one() -> None:
    problem = problems.load("quadruped-trot")
    whole = trajopt.solve(problem, fixed_mesh=True)
    half = trajopt.solve(problems.load("quadruped-trot", cycle="half"), fixed_mesh=True)
    for solution in (whole, half):
        assert solution.converged, solution.statistics.advice
        assert solution.statistics.iterations <= MOST_ITERATIONS
        assert not trajopt.check(solution).failures(AT_POINTS)
    period, speed = problem.parameters["period"], problem.parameters["speed"]
    assert_allclose(whole.q[-1][:3] - whole.q[0][:3], [speed * period, 0.0, 0.0], atol=SOLVED)
    assert_allclose(whole.q[-1][3:], whole.q[0][3:], atol=SOLVED)
    assert_allclose(whole.v[-1], whole.v[0], atol=SOLVED)
    assert_allclose(2 * half.statistics.objective, whole.statistics.objective, rtol=SAME_OPTIMUM)
    image = mirrored_configuration(problem.robot, find_mirror(problem.robot), half.q[0], half.q[0][1])
    assert_allclose(half.q[-1][7:], image[7:], atol=SOLVED)
    assert_allclose(half.q[-1][0] - half.q[0][0], speed * period / 2, atol=SOLVED)


@pytest.mark.slow
def test_start_and_stop_solve_and_meet_in_one_state() -> None:
    start, stop = (problems.load(f"quadruped-{kind}") for kind in ("start", "stop"))
    solutions = [trajopt.solve(problem, fixed_mesh=True) for problem in (start, stop)]
    for solution in solutions:
        assert solution.converged, solution.statistics.advice
        assert solution.statistics.iterations <= MOST_ITERATIONS
        assert not trajopt.check(solution).failures(AT_POINTS)
    first, second = solutions
    assert_allclose(first.q[-1][2:], second.q[0][2:], atol=SOLVED)
    assert_allclose(first.v[-1], second.v[0], atol=SOLVED)
    assert_allclose(first.v[-1][0], start.parameters["speed"], atol=1e-2)
    assert_allclose(second.v[-1], 0.0, atol=SOLVED)


FAMILIES = (
    *(family.name for family in quadruped_jump.FAMILIES),
    *(family.name for family in quadruped_box.FAMILIES),
    *(family.name for family in quadruped_flip.FAMILIES),
    quadruped_stand_up.FAMILY.name,
)
# What a solver leaves that stops at 1e-6 in natural units.
JUMP_SOLVED = 1e-5
# Feet drift between collocation points by less than the check allows, and the body with them: m, rad.
DRIFT = 1e-3
# The same in a fifth of a second, m/s and rad/s.
DRIFT_RATE = 5e-3
# Finite differences of inverse kinematics at 1e-10 over steps of 1e-4: their error.
DIFFERENCE = 1e-4


@lru_cache
def takeoff(name: str) -> pushing.Takeoff:
    return pushing.takeoff(robots.load(name))


@pytest.mark.long
@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.parametrize("robot", ["solo12", "laikago"])
def test_every_leap_is_made_for_any_quadruped(name, robot):
    problem = problems.load(name, robot=robot)
    assert problem.robot.name == robot
    start, end = problem.guess(0.0), problem.guess(problem.schedule.duration)
    assert_allclose(pin.difference(problem.robot.model, start, problem.initial_q), 0.0, atol=JUMP_SOLVED)
    lower, upper = problem.robot.position_lower, problem.robot.position_upper
    assert np.all(end >= lower - JUMP_SOLVED)
    assert np.all(end <= upper + JUMP_SOLVED)


@pytest.mark.parametrize("name", FAMILIES)
def test_robots_that_are_no_quadrupeds_are_refused(name):
    with pytest.raises(InputError):
        problems.load(name, robot="talos" if name != FAMILIES[0] else "ur5")


@pytest.mark.parametrize("name", ["go2", "anymal_c"])
def test_speed_at_takeoff_is_within_joint_rates_by_finite_differences(name):
    found = takeoff(name)
    robot, step = found.robot, 1e-4
    q, above = (pushing.raised(robot, found.rise + d).q for d in (0.0, step))
    rates = np.abs(above - q)[7:] / step * found.speed
    use = (rates / robot.velocity_limit[6:]).max()
    assert use < 1 + 100 * DIFFERENCE
    # Both robots are limited by the rates of their knees, not by torques.
    assert_allclose(use, 1.0, rtol=100 * DIFFERENCE)


def test_speed_at_takeoff_is_what_weak_torques_can_work():
    """Torques that hold 1.3 times the weight at the lowest point of the push: slower than with twice."""
    robot = robots.load("solo12")
    lowest = pushing.raised(robot, -pushing.SINK_PART * robot.length).q
    strength = pushing.strongest(robot, lowest, np.ones(12))
    weak, strong = (pushing.takeoff(robot, torque_limit=share / strength) for share in (1.3, 2.0))
    assert 0.0 < weak.speed < strong.speed < math.inf
    # No push does more work than the largest force along the whole way.
    force = pushing.strongest(robot, weak.posture, np.full(12, 1.3 / strength)) - 1
    way = pushing.SINK_PART * robot.length + weak.rise
    assert weak.speed**2 / (2 * 9.81) < force * way
    assert math.isinf(pushing.strongest(robot, robot.reference, None))


def test_extension_is_where_the_first_leg_is_straight():
    robot = robots.load("a1")
    left = pushing.extension_left(robot)
    assert pushing.raised(robot, left).error < pushing.REACHED
    assert pushing.raised(robot, left + 2 * pushing.EXTENSION_ERROR * robot.length).error > pushing.REACHED


def test_defaults_are_smaller_where_joints_are_slow():
    slow, fast = (problems.load("quadruped-jump-up", robot=name) for name in ("anymal_c", "anymal_b"))
    assert slow.parameters["height"] / slow.robot.length < 0.5 * fast.parameters["height"] / fast.robot.length
    rise = fast.parameters["height"] - takeoff("anymal_b").rise
    assert_allclose(fast.parameters["flight"], 2 * math.sqrt(2 * rise / 9.81), rtol=1e-3)


@pytest.mark.long
def test_guess_of_a_flip_turns_all_around_and_lands_where_it_lifted():
    problem = problems.load("quadruped-backflip", robot="solo12")
    times = np.linspace(0.0, problem.schedule.duration, 400)
    rotations = [pin.XYZQUATToSE3(problem.guess(t)[:7]).rotation for t in times]
    turned = sum(pin.log3(b @ a.T) for a, b in pairwise(rotations))
    assert_allclose(turned, [0.0, -2 * math.pi, 0.0], atol=JUMP_SOLVED)
    legs, feet = quadruped_legs(problem.robot), contact_positions(problem.robot, problem.initial_q)
    landed = contact_positions(problem.robot, problem.guess(problem.schedule.duration))
    assert_allclose(landed[legs.front_left], feet[legs.hind_left], atol=JUMP_SOLVED)


@pytest.mark.parametrize(("robot", "height"), [("go2", 0.1), ("go2", 0.25), ("a1", 0.2), ("solo12", 0.15)])
def test_flight_onto_a_box_ends_in_a_fall_from_its_apex(robot, height):
    """So the feet have time to pass the edge: a flight that ends at its apex has none."""
    problem = problems.load("quadruped-box-up", robot=robot, height=height)
    flight = problem.parameters["flight"]
    begin = problem.schedule.phases[0].duration
    heights = [problem.guess(begin + s * flight)[2] for s in np.linspace(0.01, 0.99, 99)]
    assert max(heights) - heights[-1] > 0.8 * quadruped_box.FALL * problem.robot.length


@pytest.mark.parametrize(("kind", "posture"), [("box-up", "initial_q"), ("box-down", None)])
def test_robot_beside_a_box_stays_clear_of_it_with_its_base_sunk(kind, posture):
    problem = problems.load(f"quadruped-{kind}", robot="go2", height=0.25)
    robot = problem.robot
    place = problem.initial_q if posture else problem.guess(problem.schedule.duration)
    sunk = pushing.raised(robot, -pushing.sink_of(robot)).q
    sunk[:3] += place[:3] - robot.reference[:3]
    distances = robot_shapes(robot).scene(robot.model, problem.terrain).distances(sunk)[0]
    assert distances.min() > -JUMP_SOLVED


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "height"), [("go2", 0.2), ("go2", 0.25), ("solo12", 0.15)])
def test_leap_onto_a_high_box_holds_at_any_time(robot, height):
    solution = motion("quadruped-box-up", robot=robot, height=height)
    assert solution.success, solution.statistics.advice


test_leaps_beyond_what_legs_can_do_are_refused = refused_calls(
    (lambda: problems.load("quadruped-box-up", robot="solo12", height=0.2, rise=0.1), "rise"),
    (lambda: problems.load("quadruped-stand-up", robot="go2", depth=0.3), "fold"),
)


def test_bad_terms_of_frames_are_refused():
    with pytest.raises(InputError):
        FramesAbove(frames=(), height=0.0)
    good = {"frame": "base_link", "axis": (0, 0, 1), "direction": (0, 0, 1), "angle": 1.0, "phase": "flight"}
    for bad in (
        {"axis": (0, 0, 0)},
        {"direction": (0, 0)},
        {"angle": 0.0},
        {"angle": 4.0},
        {"fraction": 2.0},
    ):
        with pytest.raises(InputError):
            FrameDirection(**(good | bad))


def test_leg_joints_are_hips_and_knees():
    assert leg_joints(robots.load("solo12"))[:2] == ("FL_HAA", "FL_KFE")
    assert len(leg_joints(robots.load("anymal_c"))) == 8


def solved(name, **parameters):
    problem = problems.load(name, **parameters)
    solution = solve(problem)
    assert solution.converged, solution.statistics.advice
    report = check(solution)
    assert report.within(AT_POINTS), report.table()
    return problem, solution


@pytest.mark.long
def test_jump_turns_and_lands_at_rest():
    problem, solution = solved("quadruped-jump-turn", robot="solo12")
    end = common.displaced(problem.robot, (0, 0, 0), problem.parameters["yaw"])
    assert_allclose(pin.difference(problem.robot.model, solution.q[-1], end), 0.0, atol=DRIFT)
    assert_allclose(solution.v[-1], 0.0, atol=DRIFT_RATE)
    flight = solution.phase == 1
    assert solution.q[flight, 2].max() >= problem.initial_q[2] + problem.parameters["height"] - JUMP_SOLVED


@pytest.mark.slow
@pytest.mark.parametrize("name", ["quadruped-backflip", "quadruped-barrel-roll"])
def test_flip_turns_all_around_about_its_axis(name):
    problem, solution = solved(name, robot="solo12")
    turn = np.zeros(3)
    for v, dt in zip(solution.v[:-1], np.diff(solution.t), strict=True):
        turn += v[3:6] * dt  # about the body's own axes, along which it turns
    axis = 1 if name == "quadruped-backflip" else 0
    assert abs(turn[axis]) > 0.9 * 2 * math.pi
    down = [pin.XYZQUATToSE3(q[:7]).rotation[2, 2] for q in solution.q]
    assert min(down) < -0.9
    for frame in leaping.hips_and_knees(problem.robot):
        heights = [frame_pose(problem.robot, q, frame).translation[2] for q in solution.q]
        assert min(heights) > 0.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["quadruped-box-up", "quadruped-gap"])
def test_feet_clear_the_edge(name):
    problem, solution = solved(name, robot="solo12")
    for q in solution.q:
        for place in contact_positions(problem.robot, q).values():
            assert place[2] > problem.terrain.height(place[0], place[1]) - 1e-3


@pytest.mark.long
def test_robot_stands_up_in_least_time_faster_than_with_least_effort():
    _, slow = solved("quadruped-stand-up", robot="solo12")
    _, fast = solved("quadruped-stand-up", robot="solo12", goal="time")
    assert fast.t[-1] < 0.5 * slow.t[-1]
