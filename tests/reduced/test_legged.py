"""The guess of legged motions: the base is smooth and ballistic, feet are where the schedule has them."""

import math
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from trajopt.dynamics import STANDARD_GRAVITY
from trajopt.errors import InputError
from trajopt.reduced import BaseWaypoint, WaypointPath, legged_guess
from trajopt.reduced.base_path import flights
from trajopt.reduced.legged import LeggedPosture
from trajopt.robot import contact_poses, contact_positions
from trajopt.schedule import Phase, Schedule, footholds_at
from trajopt.terrain import FlatGround, PiecewiseTerrain
from trajopt_library import robots

# Feet by inverse kinematics, m.
REACHED = 1e-8
# Central differences over STEP s of motions of order one: their error, and a jump that is none.
STEP, DIFFERENCE = 1e-5, 1e-6
# Second differences over a hundredth of a second of polynomials: rounding over the step squared.
SECOND_STEP, SECOND = 1e-2, 1e-8
# Rounding of a height, m; the way of a foot in a millisecond, m.
ROUNDING, MOST_WAY = 1e-6, 0.02
WHOLE = 2 * math.pi


def hop(contacts, *, footholds=None, times=(0.3, 0.4, 0.3)):
    stance, flight, landing = times
    return Schedule(
        (
            Phase(name="stance", duration=stance, contacts=contacts),
            Phase(name="flight", duration=flight),
            Phase(name="landing", duration=landing, contacts=contacts, footholds=footholds or {}),
        )
    )


def somersault(base, turns=1.0, ahead=0.1):
    """Rest, take-off a little up, a turn of the nose upwards in flight, rest."""
    up, end = np.array([0.0, 0.0, 0.02]), base + np.array([ahead, 0.0, 0.0])
    return (
        BaseWaypoint(time=0.0, position=base),
        BaseWaypoint(time=0.3, position=base + up, turn=(0.0, -0.1, 0.0)),
        BaseWaypoint(time=0.7, position=end + up, turn=(0.0, 0.2 - turns * WHOLE, 0.0)),
        BaseWaypoint(time=1.0, position=end, turn=(0.0, -0.1, 0.0)),
    )


@pytest.fixture(scope="module")
def solo():
    return robots.load("solo12")


@pytest.fixture(scope="module")
def names(solo):
    return tuple(contact.name for contact in solo.contacts)


def rates(path, t, step=STEP):
    before, after = path(t - step), path(t + step)
    velocity = (after.translation - before.translation) / (2 * step)
    return velocity, pin.log3(after.rotation @ before.rotation.T) / (2 * step)


def test_path_is_a_parabola_at_a_constant_rate_in_flight(solo, names):
    path = WaypointPath(hop(names), somersault(solo.reference[:3]))
    for t in (0.35, 0.5, 0.65):
        before, now, after = (path(t + s * SECOND_STEP).translation for s in (-1, 0, 1))
        acceleration = (before - 2 * now + after) / SECOND_STEP**2
        assert_allclose(acceleration, [0.0, 0.0, -STANDARD_GRAVITY], atol=SECOND)
        assert_allclose(rates(path, t)[1], [0.0, (0.2 - WHOLE) / 0.4, 0.0], atol=DIFFERENCE)


def test_path_goes_all_the_way_around(solo, names):
    path = WaypointPath(hop(names), somersault(solo.reference[:3], turns=2.0))
    turned = 0.0
    times = np.linspace(0.0, 1.0, 201)
    for before, after in pairwise(times):
        turned += pin.log3(path(after).rotation @ path(before).rotation.T)[1]
    assert_allclose(turned, -2 * WHOLE, atol=DIFFERENCE)
    assert_allclose(path(1.0).rotation, np.eye(3), atol=DIFFERENCE)


def test_rates_are_continuous_where_phases_meet(solo, names):
    path = WaypointPath(hop(names), somersault(solo.reference[:3]))
    for t in (0.3, 0.7):
        before, after = rates(path, t - 2 * STEP), rates(path, t + 2 * STEP)
        # Over four steps a smooth motion changes its rates by its acceleration, below 1e3 per s.
        for first, second in zip(before, after, strict=True):
            assert_allclose(first, second, atol=1e3 * 4 * STEP)


def test_rates_about_a_turning_axis_are_continuous(names):
    """Turns about different axes while feet stand: the end's rate is a true angular velocity."""
    points = (
        BaseWaypoint(time=0.0, position=np.zeros(3), rate=np.array([0.5, 0.0, 0.0])),
        BaseWaypoint(time=0.5, position=np.ones(3), turn=(1.0, -2.0, 0.5), rate=np.array([1.0, 2.0, -3.0])),
        BaseWaypoint(time=1.0, position=np.ones(3), turn=(-0.3, 0.4, 2.0)),
    )
    path = WaypointPath(Schedule((Phase(name="stand", duration=1.0, contacts=names),)), points)
    for t in (0.5 - 2 * STEP, 0.5 + 2 * STEP):
        assert_allclose(rates(path, t)[1], [1.0, 2.0, -3.0], atol=1e3 * 4 * STEP)
    assert_allclose(rates(path, 2 * STEP)[1], [0.5, 0.0, 0.0], atol=1e3 * 4 * STEP)


def test_path_does_not_overshoot_a_waypoint_between_supports(names):
    heights = [0.3, 0.2, 0.25]
    points = [BaseWaypoint(time=t, position=[0, 0, z]) for t, z in zip((0.0, 0.4, 1.0), heights, strict=True)]
    path = WaypointPath(Schedule((Phase(name="stand", duration=1.0, contacts=names),)), points)
    lowest = min(path(t).translation[2] for t in np.linspace(0, 1, 501))
    assert_allclose(lowest, 0.2, atol=1e-9)


def test_flights_of_several_phases_are_one(names):
    schedule = Schedule(
        (
            Phase(name="up", duration=0.2),
            Phase(name="down", duration=0.3),
            Phase(name="stand", duration=0.1, contacts=names),
        )
    )
    assert_allclose(flights(schedule), [(0.0, 0.5)])


@pytest.mark.parametrize(
    ("times", "what"),
    [((0.0, 0.7, 1.0), "flies"), ((0.1, 0.3, 0.7, 1.0), "waypoints"), ((0.0, 0.3, 0.5, 0.7), "flies")],
)
def test_waypoints_that_miss_a_flight_are_refused(names, times, what):
    points = [BaseWaypoint(time=t, position=np.zeros(3)) for t in times]
    with pytest.raises(InputError, match=what):
        WaypointPath(hop(names), points)


def test_bad_waypoints_are_refused(solo, names):
    with pytest.raises(InputError, match="finite"):
        BaseWaypoint(time=math.nan, position=np.zeros(3))
    with pytest.raises(InputError, match="position"):
        BaseWaypoint(time=0.0, position=[0.0, 1.0])
    stand = Schedule((Phase(name="stand", duration=1.0, contacts=names),))
    around = [
        BaseWaypoint(time=0.0, position=np.zeros(3)),
        BaseWaypoint(time=1.0, position=np.zeros(3), turn=(0.0, WHOLE, 0.0)),
    ]
    with pytest.raises(InputError, match="while feet stand"):
        WaypointPath(stand, around)
    for options in ({"clearance": -0.1}, {"tuck": math.inf}):
        with pytest.raises(InputError):
            legged_guess(solo, hop(names), somersault(solo.reference[:3]), **options)
    with pytest.raises(InputError, match="free-flyer"):
        legged_guess(robots.load("ur5"), stand, around[:1])


def test_feet_stand_where_the_schedule_has_them(solo, names):
    way = np.array([0.12, 0.01, 0.0])
    places = {name: place + way for name, place in _feet(solo).items()}
    footholds = {name: place + way for name, place in footholds_at(solo, solo.reference).items()}
    guess = legged_guess(solo, hop(names, footholds=footholds), somersault(solo.reference[:3]))
    for t in (0.0, 0.1, 0.3):
        _assert_feet(solo, guess(t), _feet(solo))
    for t in (0.7, 0.8, 1.0):
        _assert_feet(solo, guess(t), places)


def test_feet_without_foothold_land_under_the_base(solo, names):
    schedule, points = hop(names), somersault(solo.reference[:3], ahead=0.3)
    guess = legged_guess(solo, schedule, points, terrain=FlatGround(height=0.01))
    # The middle of the landing is at 0.85 s.
    ahead = WaypointPath(schedule, points)(0.85).translation[0]
    moved = {
        name: np.array([place[0] + ahead, place[1], place[2] + 0.01]) for name, place in _feet(solo).items()
    }
    for t in (0.7, 0.85, 1.0):
        _assert_feet(solo, guess(t), moved)


@pytest.mark.long
def test_legs_do_not_wind_around(solo, names):
    """Bent so far that the solver's first step from the reference would take a hip around by a turn."""
    schedule, points = hop(names), somersault(solo.reference[:3], ahead=0.3)
    guess = legged_guess(solo, schedule, points)
    joints = np.array([guess(t)[7:] for t in np.linspace(0.0, 1.0, 201)])
    assert np.abs(joints - solo.reference[7:]).max() < math.pi
    # Another branch is a radian or more away; a body at 15 rad/s moves joints by 50 rad/s, 0.25 rad a step.
    assert np.abs(np.diff(joints, axis=0)).max() < 0.5


def test_guess_follows_the_base_and_is_a_function_of_time_alone(solo, names):
    schedule, points = hop(names), somersault(solo.reference[:3])
    guess, again = (legged_guess(solo, schedule, points, tuck=0.05) for _ in range(2))
    path = WaypointPath(schedule, points)
    times = (0.9, 0.2, 0.5, 0.35)
    for t in times:
        assert_allclose(pin.XYZQUATToSE3(guess(t)[:7]).homogeneous, path(t).homogeneous, atol=1e-12)
    for t in reversed(times):
        np.testing.assert_array_equal(guess(t), again(t))


def test_feet_do_not_jump_and_stay_above_the_ground_in_flight(solo, names):
    schedule = hop(names)
    guess = legged_guess(solo, schedule, somersault(solo.reference[:3]), tuck=0.05)
    times = np.linspace(0.3, 0.7, 161)
    track = np.array([list(_feet(solo, guess(t)).values()) for t in times])
    assert track[..., 2].min() > -REACHED
    # Feet of a body that turns once in 0.4 s, at most 0.5 m from its middle: below 10 m/s and some for legs.
    assert np.linalg.norm(np.diff(track, axis=0), axis=-1).max() / np.diff(times).max() < 15.0


def test_a_swing_while_others_stand_is_an_arc_or_the_given_path(solo, names):
    lifted, held = names[0], names[1:]
    way = np.array([0.05, 0.0, 0.0])
    goal, foothold = _feet(solo)[lifted] + way, footholds_at(solo, solo.reference)[lifted] + way
    schedule = Schedule(
        (
            Phase(name="all", duration=0.2, contacts=names),
            Phase(name="three", duration=0.4, contacts=held),
            Phase(name="again", duration=0.2, contacts=names, footholds={lifted: foothold}),
        )
    )
    still = [BaseWaypoint(time=0.0, position=solo.reference[:3])]
    start = _feet(solo)[lifted]
    for options, height in (({"clearance": 0.04}, 0.04), ({"swing": _straight}, 0.0)):
        guess = legged_guess(solo, schedule, still, **options)
        middle = _feet(solo, guess(0.4))
        assert_allclose(middle[lifted], (start + goal) / 2 + [0, 0, height], atol=REACHED)
        for name in held:
            assert_allclose(middle[name], _feet(solo)[name], atol=REACHED)
        assert_allclose(_feet(solo, guess(0.7))[lifted], goal, atol=REACHED)


def test_soles_land_flat_and_turned_with_the_base():
    talos = robots.load("talos")
    soles = tuple(contact.name for contact in talos.contacts if contact.kind == "surface")
    schedule, base = hop(soles), talos.reference[:3]
    points = (
        BaseWaypoint(time=0.0, position=base),
        BaseWaypoint(time=0.3, position=base - [0, 0, 0.05], turn=(0.0, 0.0, 0.05)),
        BaseWaypoint(time=0.7, position=base - [0, 0, 0.05], turn=(0.0, 0.0, 0.3)),
        BaseWaypoint(time=1.0, position=base, turn=(0.0, 0.0, 0.05)),
    )
    posture = legged_guess(talos, schedule, points).motion
    assert isinstance(posture, LeggedPosture)
    before, reference = posture.base(0.85).rotation, contact_poses(talos, talos.reference)
    for name in soles:
        landed = posture.contacts.stances[name][-1].pose
        assert_allclose(landed.rotation, before @ reference[name].rotation, atol=1e-12)
        assert_allclose(landed.translation[2], 0.0, atol=1e-12)


def _straight(name, start, end, s):
    return (1 - s) * start + s * end


def _feet(robot, q=None):
    return contact_positions(robot, robot.reference if q is None else q)


def _assert_feet(robot, q, places, tolerance=REACHED):
    for name, place in _feet(robot, q).items():
        assert_allclose(place, places[name], atol=tolerance)


@pytest.mark.long
@pytest.mark.parametrize("turn", [0.0, math.pi])
def test_feet_pass_the_edge_of_a_box_that_the_robot_leaps_onto(solo, names, turn):
    """All of them are outside the box at all times, and their paths have no jumps."""
    box = PiecewiseTerrain.box(0.12, 0.8, 0.8, at=(0.7, 0.0))
    goal = solo.reference.copy()
    goal[:3] += [0.6, 0.0, 0.12]
    goal[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(0.0, 0.0, turn)).coeffs()
    schedule = hop(names, footholds=footholds_at(solo, goal, box))
    base, up = solo.reference[:3], np.array([0.0, 0.0, 0.12])
    path = (
        BaseWaypoint(time=0.0, position=base),
        BaseWaypoint(time=0.3, position=base),
        BaseWaypoint(time=0.7, position=goal[:3] - 0.2 * up, turn=(0.0, 0.0, turn)),
        BaseWaypoint(time=1.0, position=goal[:3]),
    )
    guess = legged_guess(solo, schedule, path, terrain=box, clearance=0.03)
    before = None
    for t in np.linspace(0.3, 0.7, 401):
        now = contact_positions(solo, guess(float(t)))
        for name, place in now.items():
            radius = solo.contact(name).radius
            assert place[2] - radius > box.height(place[0], place[1]) - ROUNDING
            if before is not None:
                assert np.linalg.norm(place - before[name]) < MOST_WAY
        before = now
