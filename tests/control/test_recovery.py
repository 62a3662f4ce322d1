"""Recovery steps: supports, the falling mass and legs against closed forms, and a robot that is pushed."""

import math

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.synthetic_motions import sampled, standing
from trajopt import Solution
from trajopt.control import Tracker
from trajopt.control.recovery import (
    DEEPEST,
    LIFT,
    SWING,
    FallingMass,
    Recovery,
    SupportPolygon,
    diagonal_pairs,
    swing_height,
    swing_leg,
)
from trajopt.robot.mujoco_package import muted_mujoco
from trajopt.robot.natural_units import NaturalUnits
from trajopt.simulation.push import PushTrials
from trajopt_library import robots

SQUARE = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [0.2, 0.3]])
# Differences of heights over this step of a swing give its rates to this relative accuracy.
STEP, SLOPE = 1e-4, 1e-3
# Solo12 standing falls at this push to the left, in natural units, with its feet in place (control.md).
FELL = 0.9


@pytest.fixture(scope="module")
def stand() -> Solution:
    robot = robots.load("solo12")
    return sampled(robot, [standing(robot, 0.1)], 4)


@pytest.mark.parametrize(
    ("point", "outside", "nearest"),
    [
        ((0.0, 0.0), -1.0, (0.0, 0.0)),
        ((0.7, 0.2), -0.3, (0.7, 0.2)),
        ((3.0, 0.5), 2.0, (1.0, 0.5)),
        ((4.0, 5.0), 5.0, (1.0, 1.0)),
    ],
)
def test_the_distance_from_a_square_is_that_of_its_edges_and_corners(
    point: tuple[float, float], outside: float, nearest: tuple[float, float]
) -> None:
    found = SupportPolygon(SQUARE)
    assert len(found.corners) == 4
    assert found.outside(np.array(point)) == pytest.approx(outside)
    assert_allclose(found.nearest(np.array(point)), nearest)


def test_a_line_and_a_point_are_polygons_without_an_inside() -> None:
    line = SupportPolygon(np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 0.0]]))
    assert line.outside(np.array([1.0, 0.5])) == pytest.approx(0.5)
    assert_allclose(line.nearest(np.array([3.0, 1.0])), [2.0, 0.0])
    point = SupportPolygon(np.array([[1.0, 1.0]]))
    assert point.outside(np.array([4.0, 5.0])) == pytest.approx(5.0)


def test_a_falling_mass_is_that_of_the_integrated_pendulum() -> None:
    """Ten thousand steps of dd c = w^2 (c - p) end where the closed form says."""
    pressure, time, steps = np.array([0.05, -0.02]), 0.2, 10_000
    mass = FallingMass(np.array([0.01, 0.02]), np.array([0.4, -0.3]), 5.0)
    place, velocity = mass.place, mass.velocity
    for _ in range(steps):
        velocity = velocity + time / steps * 25.0 * (place - pressure)
        place = place + time / steps * velocity
    found = mass.after(time, pressure)
    assert_allclose(found.place, place, atol=1e-4)
    assert_allclose(found.velocity, velocity, atol=1e-3)
    assert_allclose(found.capture - pressure, (mass.capture - pressure) * math.e)
    assert_allclose(mass.after(time, None).place, [0.09, -0.04])


def test_over_its_capture_point_a_mass_comes_to_rest_there() -> None:
    mass = FallingMass(np.array([0.0, 0.0]), np.array([0.5, 0.2]), 5.0)
    assert_allclose(mass.capture, [0.1, 0.04])
    assert_allclose(mass.after(0.2, mass.capture).capture, mass.capture)
    assert_allclose(mass.acceleration(mass.capture), -5.0 * mass.velocity)
    assert_allclose(mass.holding(mass.capture, 2.0), mass.capture)
    # dxi = w (xi - p) = -gain w (xi - middle)
    assert_allclose(mass.capture - mass.holding(np.zeros(2), 2.0), -2.0 * mass.capture)


def test_the_longest_leg_is_the_stretched_one() -> None:
    robot = robots.load("solo12")
    foot = robot.contacts[0].frame
    leg = swing_leg(robot.model, robot.model.getFrameId(foot), robot.actuated_rows)
    way = [0.0, 0.0]
    for joint in list(robot.model.supports[robot.model.frames[robot.model.getFrameId(foot)].parentJoint])[3:]:
        way.append(float(np.linalg.norm(robot.model.jointPlacements[joint].translation)))
    last = robot.model.frames[robot.model.getFrameId(foot)].placement.translation
    assert robot.model.joints[leg.hip].idx_v >= robot.n_unactuated
    assert leg.reach <= sum(way) + float(np.linalg.norm(last)) + 1e-9
    assert leg.reach > 0.9 * (sum(way) + float(np.linalg.norm(last)))


def test_pairs_are_the_diagonals_whatever_the_order_of_feet() -> None:
    places = np.array([[1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]])
    found = diagonal_pairs(np.array([3, 5, 6, 8]), places)
    assert {frozenset(pair) for pair in found} == {frozenset({3, 5}), frozenset({6, 8})}


def test_a_swing_leaves_and_lands_at_rest() -> None:
    units = NaturalUnits.of(robots.load("solo12").model)
    assert swing_height(0.0, units)[:2] == (0.0, 0.0)
    assert swing_height(0.5, units)[0] == pytest.approx(LIFT * units.length)
    assert swing_height(1.0, units)[0] == 0.0
    assert swing_height(100.0, units)[0] == -DEEPEST * units.length
    duration = SWING * units.time
    before, now, after = (swing_height(0.3 + side * STEP, units) for side in (-1, 0, 1))
    assert (after[0] - before[0]) / (2 * STEP * duration) == pytest.approx(now[1], rel=SLOPE)
    assert (after[1] - before[1]) / (2 * STEP * duration) == pytest.approx(now[2], rel=SLOPE)


def recovering(plan: Solution, speed: float, ticks: int) -> tuple[Tracker, list[Recovery]]:
    """A tracker that is told, for some ticks at the plan's end, that the base moves to the left."""
    tracker, states = Tracker(plan), []
    v = np.zeros(plan.model.nv)
    v[1] = speed
    for k in range(ticks):
        tracker.torque(0.05 + k * 1e-3, plan.q[-1], v, np.ones(4, dtype=bool))
        states.append(tracker._recovery.copy())
    return tracker, states


def test_steps_begin_where_the_capture_point_leaves_the_feet(stand: Solution) -> None:
    data = stand.model.createData()
    pin.framesForwardKinematics(stand.model, data, stand.q[-1])
    feet = np.array([data.oMf[stand.model.getFrameId(name)].translation for name in stand.contact_frames])
    com = pin.centerOfMass(stand.model, data, stand.q[-1])
    rate = math.sqrt(9.81 / (com - feet.mean(axis=0))[2])
    edge = (feet[:, 1].max() - com[1]) * rate
    assert not recovering(stand, 0.6 * edge, 5)[1][-1].engaged
    assert recovering(stand, 1.1 * edge, 1)[1][-1].engaged


def test_a_pair_swings_and_the_state_of_a_copy_is_its_own(stand: Solution) -> None:
    tracker, states = recovering(stand, 3.0, 1)
    assert states[0]._swinging in states[0]._groups
    other = tracker.copy()
    lifted = stand.q[-1].copy()
    lifted[2] += 0.02
    for k in range(5):
        other.torque(0.06 + k * 1e-3, lifted, np.zeros(stand.model.nv), np.zeros(4, dtype=bool))
    assert_allclose(tracker._recovery._offsets.offset, states[0]._offsets.offset)
    assert (tracker._recovery._landed == states[0]._landed).all()
    assert (tracker._recovery._lifted == states[0]._lifted).all()
    assert (other._recovery._lifted != states[0]._lifted).any()


@pytest.mark.long
def test_solo12_survives_a_push_by_steps_that_it_does_not_survive_without(
    stand: Solution, monkeypatch: pytest.MonkeyPatch
) -> None:
    with muted_mujoco():
        assert PushTrials.of(stand, None, None).with_controller("whole-body")(90.0, FELL)
        monkeypatch.setattr(Recovery, "step", lambda *_: None)
        assert not PushTrials.of(stand, None, None).with_controller("whole-body")(90.0, FELL)
