"""Gaits of quadrupeds: what is commanded, planned and guessed, and what is solved."""

import math

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from trajopt.certify.report import AT_POINTS
from trajopt.dynamics.model_quantities import contact_jacobian, gravity_of
from trajopt.errors import InputError
from trajopt.reduced.gaits import Pace, base_pose, plan_of_cycle
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.legs import quadruped_legs
from trajopt.robot.mirror import find_mirror, mirrored_configuration
from trajopt.schedule.gait_transitions import transition
from trajopt.schedule.gaits import QUADRUPED
from trajopt.schedule.placing import footholds_at
from trajopt.schedule.schedule import Schedule
from trajopt.terms import TerminalVelocity
from trajopt_library import problems, robots
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
