"""The tracker on an integrator that is not MuJoCo: numeric Pinocchio, contacts by their KKT conditions."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.problems import hop
from tests.support.solved_problems import motion
from tests.support.synthetic_motions import sampled, tumbling_flight
from trajopt import Solution
from trajopt.certify.contact.contact_dynamics import forward_dynamics
from trajopt.certify.contact.contact_set import ContactSet
from trajopt.control import Tracker, TrackerGains
from trajopt.control.inverse_dynamics import RELAXED
from trajopt.control.reference import reference_of
from trajopt.errors import InputError
from trajopt_library import robots

pytestmark = pytest.mark.long

RATE = 500.0
SUBSTEPS = 4
# Contacts of the integrator are held by acceleration alone: they drift.
ENDED = 5e-3
# Of heights after 0.3 s by steps of first order: g T times a step, over four.
EULER = 4e-4
SEED = 5


def integrated(tracker: Tracker, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """States (n, nq), (n, nv) at the ticks of a plan whose contacts hold as planned."""
    reference, model = tracker.reference, tracker.reference.model
    step, states = reference.period / SUBSTEPS, []
    for k in range(reference.planned):
        active = reference.active[k]
        names = [(reference.contact_frames[i], 3) for i in np.flatnonzero(active)]
        contacts, whole = ContactSet.of(model, names), np.zeros(model.nv)
        states.append((q, v))
        whole[reference.n_unactuated :] = tracker.torque(reference.t[k] - reference.t[0], q, v, active)
        for _ in range(SUBSTEPS):
            v = v + step * forward_dynamics(model, q, v, whole, contacts).acceleration
            q = pin.integrate(model, q, step * v)
    states.append((q, v))
    return np.array([own for own, _ in states]), np.array([own for _, own in states])


@pytest.mark.parametrize("rate", [400.0, 430.0, 470.0])
def test_accelerations_of_periods_in_which_a_contact_lifts_give_their_change_of_velocity(rate: float) -> None:
    """Else a part of a period's contact force is given or lost; to second order in the period."""
    plan = motion("hopper-hop")
    found = reference_of(plan, rate)
    lifts = np.flatnonzero(found.active[:-1].any(axis=1) & ~found.active[1:].any(axis=1))
    assert len(lifts)
    for k in lifts:
        change = found.v[k + 1] - found.v[k]
        jump = np.abs(found.a[k + 1] - found.a[k - 1]).max() * found.period
        assert_allclose(found.a[k] * found.period, change, atol=0.05 * jump)


@pytest.fixture(scope="module")
def rising() -> Solution:
    return motion("quadruped-stand-up", robot="solo12")


def test_a_disturbed_start_is_taken_out(rising: Solution) -> None:
    """The base begins 10 mm and 0.05 rad off, with its feet where they are."""
    generator = np.random.default_rng(SEED)
    tracker, first = Tracker(rising, rate=RATE), rising.q[0]
    error = np.concatenate(
        [0.01 * generator.standard_normal(3), 0.03 * generator.standard_normal(3), np.zeros(12)]
    )
    moved = pin.integrate(rising.model, first, error)
    robot = robots.load("solo12")
    feet = {
        frame: trajopt.robot.frame_pose(robot, first, frame).translation for frame in rising.contact_frames
    }
    start = trajopt.robot.inverse_kinematics(robot, moved, feet).q
    q, v = integrated(tracker, start, np.zeros(rising.model.nv))
    assert np.linalg.norm(q[0, :3] - first[:3]) > 0.005
    assert_allclose(q[-1, :3], rising.q[-1, :3], atol=ENDED)
    assert np.linalg.norm(pin.difference(rising.model, rising.q[-1], q[-1])[3:6]) < 0.02
    assert np.abs(v[-1, :6]).max() < 0.05
    assert tracker.counts.relaxed[0] == tracker.counts.ticks


def test_momentum_and_energy_are_those_of_a_tracked_flight() -> None:
    """Torques change neither: with the planned start the flight is the planned one."""
    robot = robots.load("solo12")
    plan = sampled(robot, [tumbling_flight(robot)], 6)
    tracker = Tracker(plan, rate=RATE)
    q, v = integrated(tracker, plan.q[0], plan.v[0])
    data = plan.model.createData()
    momentum = [
        pin.computeCentroidalMomentum(plan.model, data, a, b).angular.copy()
        for a, b in zip(q, v, strict=True)
    ]
    assert_allclose(
        momentum, np.tile(momentum[0], (len(q), 1)), atol=2e-3 * np.linalg.norm(momentum[0]) + 1e-6
    )
    heights = np.array([pin.centerOfMass(plan.model, data, a)[2] for a in q])
    t = tracker.reference.period * np.arange(len(q))
    rise = pin.centerOfMass(plan.model, data, q[0], v[0]) is not None and data.vcom[0][2]
    fall = 9.81 * t * (t + tracker.reference.period / SUBSTEPS) / 2  # of the integrator's own steps
    assert_allclose(heights, heights[0] + rise * t - fall, atol=EULER)
    for planned, own in zip(tracker.reference.q, q, strict=False):
        assert np.abs(pin.difference(plan.model, planned, own)[6:]).max() < 5e-3


def test_without_contact_the_feet_are_pressed_down(rising: Solution) -> None:
    tracker = Tracker(rising, rate=RATE)
    none, all_ = np.zeros(4, dtype=bool), np.ones(4, dtype=bool)
    q, v = rising.q[0], np.zeros(rising.model.nv)
    tracker.torque(0.0, q, v, all_)
    assert tracker.last is not None
    assert len(tracker.last.forces) == 4
    for k in range(100):
        tracker.torque(k / RATE, q, v, none)
    assert len(tracker.last.forces) == 0
    downward = [
        (tracker._programs[0].state.frame(frame).jacobian[:3] @ tracker.last.acceleration)[2]
        for frame in tracker._contacts.frames
    ]
    assert max(downward) < 0.0


def test_solvers_and_gains_are_chosen_by_a_word(rising: Solution) -> None:
    tracker = Tracker(rising, rate=RATE, solver="piqp", gains=TrackerGains(body=3.0))
    torque = tracker.torque(0.0, rising.q[0], np.zeros(rising.model.nv), np.ones(4, dtype=bool))
    assert np.isfinite(torque).all()
    assert RELAXED[int(np.argmax(tracker.counts.relaxed))] == "nothing"


def test_a_model_without_frames_of_joints_is_tracked() -> None:
    plan = trajopt.solve(hop())
    assert plan.success
    tracker = Tracker(plan, rate=RATE)
    torque = tracker.torque(0.0, plan.q[0], plan.v[0], np.array([True]))
    assert tracker.last is not None
    assert RELAXED[tracker.last.relaxed] == "nothing"
    assert np.isfinite(torque).all()


def test_bad_input_is_one_line(rising: Solution, tmp_path: Path) -> None:
    tracker, feet = Tracker(rising, rate=RATE), np.ones(4, dtype=bool)
    q, v = rising.q[0], np.zeros(rising.model.nv)
    cases = {
        r"q\[0\] of a state is nan": lambda: tracker.torque(0.0, np.full_like(q, np.nan), v, feet),
        r"q of a state has shape \(3,\); allowed: \(19,\)": lambda: tracker.torque(0.0, np.zeros(3), v, feet),
        r"touching has shape \(2,\); allowed: \(4,\)": lambda: tracker.torque(0.0, q, v, feet[:2]),
        r"a tick of 10 s is longer than a phase": lambda: Tracker(rising, rate=0.1),
        r"solver of Tracker is 'qp'": lambda: Tracker(rising, solver="qp"),  # type: ignore[arg-type]
        r"cycles of Tracker is 0; allowed: a whole number >= 1": lambda: Tracker(rising, cycles=0),
        r"the solution is not periodic": lambda: Tracker(rising, cycles=2),
        r"none.npz does not exist": lambda: Tracker(tmp_path / "none.npz"),
        r"body of TrackerGains is -1; allowed: a finite number >= 0": lambda: TrackerGains(body=-1),
        r"the plan is of '.*', not of 'go2': it has no joint 'FL_HAA'; allowed: a plan with the joints": (
            lambda: Tracker(rising, robot=robots.load("go2"))
        ),
    }
    for message, call in cases.items():
        with pytest.raises(InputError, match=message) as refused:
            call()
        assert "\n" not in str(refused.value)


def test_a_robot_that_flew_away_is_held_without_a_program(rising: Solution) -> None:
    tracker, feet = Tracker(rising, rate=RATE, robot=robots.load("solo12")), np.ones(4, dtype=bool)
    v = np.zeros(rising.model.nv)
    v[3] = 1e6
    torque = tracker.torque(0.0, rising.q[0], v, feet)
    assert np.isfinite(torque).all()
    assert tracker.counts.relaxed[RELAXED.index("everything")] == tracker.counts.ticks == 1
    tracker.torque(1 / RATE, rising.q[0], np.zeros(rising.model.nv), feet)
    assert tracker.counts.relaxed[0] == 1
