"""What the tracker says that a tick asked for: forces of its program, goals of its tasks."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.synthetic_motions import sampled, standing
from trajopt.control import Tracker
from trajopt.motion.solution import Solution
from trajopt_library import robots

RATE, WEIGHT = 1000.0, 1e-3
STANCE, LIFTED = 0.2, 0.1  # s


@pytest.fixture(scope="module")
def stepping() -> Solution:
    """Solo12 stands, has its first foot in the air without moving it, and stands again."""
    robot = robots.load("solo12")
    stance = standing(robot, STANCE)
    lifted = replace(stance, duration=LIFTED, contacts=stance.contacts[1:])
    return sampled(robot, [stance, lifted, stance], 3)


def asked(plan: Solution, t: float, touching: list[bool], shift: float = 0.0) -> Tracker:
    """A tracker after one tick at ``t`` s, with the base ``shift`` m off along x."""
    tracker, q = Tracker(plan, rate=RATE), plan.q[0].copy()
    q[0] += shift
    tracker.torque(t, q, np.zeros(plan.model.nv), np.array(touching))
    return tracker


def test_forces_are_those_of_the_program_by_contact(stepping: Solution) -> None:
    standing_tick = asked(stepping, 0.1, [True] * 4)
    weight = standing_tick.units.weight
    assert_allclose(standing_tick.request.forces[:, 2].sum(), weight, rtol=WEIGHT)
    swinging = asked(stepping, STANCE + LIFTED / 2, [False, True, True, True])
    assert swinging.last is not None
    assert not swinging.request.forces[0].any()
    assert_allclose(swinging.request.forces[1:], swinging.last.forces)


def test_goals_are_those_of_the_plan_not_of_the_measured_state(stepping: Solution) -> None:
    data = stepping.model.createData()
    planned = pin.centerOfMass(stepping.model, data, stepping.q[0]).copy()
    request = asked(stepping, 0.1, [True] * 4, shift=0.01).request
    assert_allclose(request.com, planned, atol=1e-9)
    assert np.isnan(request.feet).all()


def test_a_foot_in_the_air_has_a_goal_and_the_others_have_none(stepping: Solution) -> None:
    request = asked(stepping, STANCE + LIFTED / 2, [False, True, True, True]).request
    data = stepping.model.createData()
    pin.framesForwardKinematics(stepping.model, data, stepping.q[0])
    foot = data.oMf[stepping.model.getFrameId(stepping.contact_frames[0])].translation
    assert_allclose(request.feet[0], foot, atol=1e-3)  # and beside its foothold by rounding of the plan
    assert np.isnan(request.feet[1:]).all()


def test_a_tick_without_a_program_asks_for_nothing(stepping: Solution) -> None:
    tracker, v = Tracker(stepping, rate=RATE), np.zeros(stepping.model.nv)
    tracker.torque(0.0, stepping.q[0], v, np.ones(4, dtype=bool))
    assert tracker.request.forces.any()
    v[3] = 1e6  # it flew away
    tracker.torque(1 / RATE, stepping.q[0], v, np.ones(4, dtype=bool))
    assert not tracker.request.forces.any()
    assert np.isnan(tracker.request.com).all()
