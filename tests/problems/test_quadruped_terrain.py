"""Quadrupeds over terrain: where feet are planned, how the base follows the ground, what is solved."""

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.refusals import refusals
from trajopt import FlatGround, InputError, Problem, Schedule
from trajopt.certify.report import AT_POINTS
from trajopt.dynamics import gravity_of
from trajopt.reduced import Pace, plan_over_terrain
from trajopt.reduced.over_terrain import standing_on
from trajopt.robot import contact_positions, quadruped_legs
from trajopt.schedule import gait_of, transition
from trajopt.terrain import PiecewiseTerrain, SmoothTerrain
from trajopt.terrain.swing_paths import swing_profile
from trajopt_library import problems, robots
from trajopt_library.problems.gait_common import STYLES

pytestmark = pytest.mark.long

FAMILIES = [f"quadruped-{name}" for name in ("slope", "stairs", "steps", "stepping-stones", "waves")]
# Closed forms, m and rad.
ROUNDING = 1e-9
# Out of reach by less than this part of the robot's length is what a guess may be; the solver mends it.
REACHED = 1e-3
# Times at which a guess is looked at.
SAMPLES = 60
# A solver that stops at 1e-6 in natural units leaves this, m.
SOLVED = 1e-5
# What feet may slide in a stance on this grid, m: the check's own limit.
DRIFT = 1e-3
# Intervals of a phase that let a swing rise, pass a tread and sink.
LEAST_GRID = 8


def starts_of(schedule: Schedule) -> np.ndarray:
    return np.cumsum([0.0, *(phase.duration for phase in schedule.phases)])


def stances(problem: Problem) -> list[tuple[str, int, float]]:
    """Contact, phase in which it lands, and the middle of that phase in s, for all landings."""
    begins = starts_of(problem.schedule)
    return [
        (name, i, float(begins[i] + phase.duration / 2))
        for i, phase in enumerate(problem.schedule.phases)
        for name in problem.schedule.new_contacts(i)
    ]


def base_of(q: np.ndarray) -> pin.SE3:
    return pin.XYZQUATToSE3(q[:7])


@pytest.mark.parametrize(
    ("name", "robot"),
    [*((name, "solo12") for name in FAMILIES), ("quadruped-stairs", "anymal_c"), ("quadruped-steps", "go1")],
)
def test_feet_of_the_guess_stand_on_the_ground_and_never_swing_below_it(name: str, robot: str) -> None:
    problem = problems.load(name, robot=robot)
    body, ground = problem.robot, problem.terrain
    near = REACHED * body.length
    for t in np.linspace(0.0, problem.schedule.duration, SAMPLES):
        q = problem.guess(float(t))
        for foot, place in contact_positions(body, q).items():
            height = height_under(ground.offset(body.contact(foot).radius), place)
            index = min(
                int(np.searchsorted(starts_of(problem.schedule), t, "right")) - 1,
                len(problem.schedule.phases) - 1,
            )
            over = place[2] - height
            assert over > -near, (foot, t)
            if foot in problem.schedule.phases[index].contacts:
                assert over < near, (foot, t)


def height_under(ground: object, place: np.ndarray) -> float:
    if isinstance(ground, FlatGround):
        x, y, z = ground.normal
        return float(ground.height - x * place[0] - y * place[1]) / z
    return float(ground.height(place[0], place[1]))


@pytest.mark.parametrize("rise", [0.04, -0.04])
@pytest.mark.parametrize("gait", ["trot", "walk"])
def test_planned_footholds_are_on_the_treads_and_off_their_edges(gait: str, rise: float) -> None:
    problem = problems.load(
        "quadruped-stairs", gait=gait, rise=rise, run=0.15, steps=3, footholds="planned", margin=0.02
    )
    first = float(problem.terrain.face("step1").vertices[:, 0].min())
    risers = first + 0.15 * np.arange(3)
    for foot, index, _ in stances(problem):
        place = problem.schedule.phases[index].footholds[foot]
        assert place[2] == pytest.approx(rise * np.sum(place[0] > risers), abs=ROUNDING)
        assert np.abs(place[0] - risers).min() >= 0.02 - ROUNDING


@pytest.mark.parametrize("name", FAMILIES[1:4])
def test_feet_start_before_and_end_behind_all_edges(name: str) -> None:
    problem = problems.load(name)
    start, end = (
        contact_positions(problem.robot, problem.guess(t)) for t in (0.0, problem.schedule.duration)
    )
    faces = problem.terrain
    before, beyond = faces.face("before").vertices[:, 0].max(), faces.face("beyond").vertices[:, 0].min()
    assert max(place[0] for place in start.values()) < before
    assert min(place[0] for place in end.values()) > beyond


@pytest.mark.parametrize("robot", ["solo12", "anymal_b", "b1"])
def test_base_goes_the_way_at_no_more_than_the_gaits_speed(robot: str) -> None:
    problem = problems.load("quadruped-waves", robot=robot, way=0.5)
    body, total = problem.robot, problem.schedule.duration
    way = problem.guess(total)[:2] - problem.guess(0.0)[:2]
    assert_allclose(way, [0.5, 0.0], atol=ROUNDING)
    times = np.linspace(0.0, total, 400)
    speeds = np.diff([problem.guess(float(t))[0] for t in times]) / np.diff(times)
    froude = speeds.max() ** 2 / (gravity_of(body.model) * body.length)
    # The path is a cubic through points of the pace: a twentieth faster between them at most.
    assert froude < 1.1 * STYLES["trot"].froude


@pytest.mark.parametrize("gait", ["trot", "walk"])
def test_cycles_are_as_many_as_asked_or_derived(gait: str) -> None:
    derived = problems.load("quadruped-waves", gait=gait)
    given = problems.load("quadruped-waves", gait=gait, cycles=derived.parameters["cycles"])
    assert given.schedule.duration == pytest.approx(derived.schedule.duration)
    longer = problems.load("quadruped-waves", gait=gait, cycles=derived.parameters["cycles"] + 1)
    style, body = STYLES[gait], derived.robot
    assert longer.schedule.duration - given.schedule.duration == pytest.approx(
        style.period(body, style.speed(body))
    )


@pytest.mark.parametrize("normal", [(-0.2, 0.0, 1.0), (0.1, -0.15, 1.0)])
@pytest.mark.parametrize("robot", ["solo12", "hyq", "laikago"])
def test_standing_on_a_plane_leans_the_base_as_the_plane(
    robot: str, normal: tuple[float, float, float]
) -> None:
    body, ground = robots.load(robot), FlatGround(normal=normal)
    q = standing_on(body, ground)
    up = np.array(normal) / np.linalg.norm(normal)
    reference, base = base_of(body.reference), base_of(q)
    assert_allclose(base.rotation @ reference.rotation.T @ [0.0, 0.0, 1.0], up, atol=ROUNDING)
    rise = (-up[0] * base.translation[0] - up[1] * base.translation[1]) / up[2]
    feet = np.mean([place[2] for place in contact_positions(body, body.reference).values()])
    over = reference.translation[2] - feet + body.contacts[0].radius / up[2]
    assert base.translation[2] - rise == pytest.approx(over, abs=1e-4)
    for name, place in contact_positions(body, q).items():
        assert up @ place == pytest.approx(body.contact(name).radius, abs=1e-6 * body.length)
        assert_allclose(place[:2], contact_positions(body, body.reference)[name][:2], atol=1e-6)


def test_base_pitches_by_the_slope_while_all_feet_are_on_it() -> None:
    problem = problems.load("quadruped-slope", slope=0.2, length=0.8)
    body = problem.robot
    on_slope = [
        base_of(problem.guess(float(t))).rotation[:, 0]
        for t in np.linspace(0.0, problem.schedule.duration, SAMPLES)
        if all(
            problem.terrain.face_at(*place[:2]).name == "slope"
            for place in contact_positions(body, problem.guess(float(t))).values()
        )
    ]
    assert len(on_slope) > 3
    pitches = [math.atan2(x[2], x[0]) for x in on_slope]
    # Where the last foot has just come onto the slope, the base is still on its way to the slope's angle.
    assert np.median(pitches) == pytest.approx(0.2, abs=0.02)


def test_free_footholds_are_faces_that_the_planned_ones_lie_in() -> None:
    free = problems.load("quadruped-stepping-stones")
    planned = problems.load("quadruped-stepping-stones", footholds="planned")
    faces = set()
    last = {foot: index for foot, index, _ in stances(free)}
    for foot, index, _ in stances(free):
        assert (foot in free.schedule.phases[index].footholds) == (last[foot] == index)
        patch = free.schedule.phases[index].patches[foot]
        place = planned.schedule.phases[index].footholds[foot]
        assert patch.inside(place) >= patch.margin - ROUNDING
        faces.add(patch.name)
    assert len([name for name in faces if name.startswith("stone")]) >= 4


def test_stones_are_in_two_rows_under_the_feet_with_holes_between() -> None:
    problem = problems.load("quadruped-stepping-stones", stones=3, size=0.08, spacing=0.12, uneven=0.0)
    body, ground = problem.robot, problem.terrain
    legs, feet = quadruped_legs(body), contact_positions(body, body.reference)
    stones = [face for face in ground.faces if face.name.startswith("stone")]
    assert len(stones) == 6
    for foot in (legs.front_left, legs.front_right):
        row = [face for face in stones if face.inside(feet[foot] * [0, 1, 0] + face.centre * [1, 0, 0]) > 0]
        assert len(row) == 3
        assert_allclose(np.diff(sorted(face.centre[0] for face in row)), 0.12, atol=ROUNDING)
    x, y, _ = stones[0].centre
    assert ground.height(x + 0.06, y) == -np.inf


def test_lengths_scale_with_the_robot() -> None:
    small, large = (problems.load("quadruped-stairs", robot=name) for name in ("solo12", "hyq"))
    ratio = large.robot.length / small.robot.length
    for name in ("rise", "run", "clearance"):
        assert large.parameters[name] / small.parameters[name] == pytest.approx(ratio)
    assert large.parameters["margin"] == pytest.approx(0.05 * large.robot.length)
    assert small.parameters["margin"] == small.robot.contacts[0].radius  # a ball beside a riser


def test_any_ground_can_be_planned_over() -> None:
    body = robots.load("go1")
    gait = gait_of(body, "walk")
    schedule = Schedule(transition(gait, 0.8, cycles=2, stand=0.3, rest=0.3))
    feet = contact_positions(body, body.reference)
    box = PiecewiseTerrain.box(0.05, 0.4, 0.3, at=(max(p[0] for p in feet.values()) + 0.3, 0.1))
    pace = Pace(velocity=(0.25, 0.0), starts=(0.0, 0.5), stops=(schedule.duration - 0.5, schedule.duration))
    plan = plan_over_terrain(body, schedule, pace, box, clearance=0.05, free=True)
    assert_allclose(plan.start, plan.guess(0.0), atol=1e-6)
    names = {patch.name for phase in plan.schedule.phases for patch in phase.patches.values()}
    assert "box" in names
    assert len(names) > 1


test_bad_values_are_refused_in_one_line = refusals(
    lambda name, values: problems.load(name, **values),
    ("quadruped-stairs", {"cycles": 2.5}, "cycles is 2.5"),
    ("quadruped-stairs", {"steps": 1.5}, "steps is 1.5"),
    ("quadruped-stairs", {"margin": 0.2}, "margin of patch"),
    ("quadruped-stairs", {"gait": "gallop"}, "gait='gallop'"),
    ("quadruped-stairs", {"robot": "ur5"}, "ur5"),
    ("quadruped-stepping-stones", {"size": 0.2, "spacing": 0.1}, "stones of 0.2 m"),
    ("quadruped-slope", {"length": 5.0, "ground": "endless", "gait": "walk"}, "more than 20 strides"),
    ("quadruped-waves", {"amplitude": 0.5, "wavelength": 0.3}, "does not reach"),
    ("quadruped-waves", {"margin": 0.1}, "no parameter 'margin'"),
)


def test_gaits_with_flights_and_starts_over_holes_are_refused() -> None:
    problem = problems.load("quadruped-stairs")
    body, pace = problem.robot, Pace(velocity=(0.1, 0.0))
    phases = problem.schedule.phases
    flown = Schedule((phases[0], replace(phases[1], name="flight", contacts=(), footholds={}, patches={})))
    with pytest.raises(InputError, match="flies"):
        plan_over_terrain(body, flown, pace, problem.terrain, clearance=0.02)
    hole = PiecewiseTerrain.stepping_stones([(5.0, 0.0)], 0.1)
    with pytest.raises(InputError, match="no face"):
        standing_on(body, hole)


@pytest.mark.slow
def test_a_walk_over_waves_lands_on_them_and_swings_over_them() -> None:
    problem = problems.load("quadruped-waves", gait="walk", cycles=2, way=0.15)
    ground = problem.terrain
    assert isinstance(ground, SmoothTerrain)
    solution = trajopt.solve(problem, fixed_mesh=True)
    assert solution.converged, solution.statistics.advice
    report = trajopt.check(solution)
    assert report.within(AT_POINTS), report.failures(AT_POINTS)
    lift = problem.parameters["clearance"]
    assert isinstance(lift, float)
    begins, checked = starts_of(problem.schedule), 0
    for t, index, q in zip(solution.t, solution.phase, solution.q, strict=True):
        for foot, place in contact_positions(problem.robot, q).items():
            span = swing_around(problem.schedule, foot, int(index))
            if span is None or not is_node(t, begins, int(index), solution.meta["intervals"], problem):
                continue
            s = (t - begins[span[0]]) / (begins[span[1]] - begins[span[0]])
            over = place[2] - float(ground.height(place[0], place[1]))
            assert over >= lift * swing_profile(s) - SOLVED, (foot, t)
            checked += 1
    assert checked > 20


def swing_around(schedule: Schedule, foot: str, index: int) -> tuple[int, int] | None:
    """Phases from the beginning of a swing to its touchdown; None where the foot stands."""
    on = [foot in phase.contacts for phase in schedule.phases]
    if on[index]:
        return None
    first = max(i for i in range(index) if on[i]) + 1
    return first, min(i for i in range(index, len(on)) if on[i])


def is_node(t: float, begins: np.ndarray, index: int, counts: list[int], problem: Problem) -> bool:
    steps = (t - begins[index]) / problem.schedule.phases[index].duration * counts[index]
    return abs(steps - round(steps)) < 1e-6


@pytest.mark.slow
def test_a_trot_up_stairs_keeps_off_edges() -> None:
    problem = problems.load("quadruped-stairs", steps=2)
    solution = trajopt.solve(problem, intervals=LEAST_GRID * len(problem.schedule.phases))
    assert solution.converged, solution.statistics.advice
    report = trajopt.check(solution)
    assert report.within(AT_POINTS), report.failures(AT_POINTS)
    assert report.patch_margin >= problem.parameters["margin"] - DRIFT
