"""Disturbances of one's own in a simulation: when they are applied, and on what."""

import math
from typing import Any

import numpy as np
import pytest

from tests.support.synthetic_motions import sampled, tumbling_flight
from trajopt import Solution
from trajopt.errors import InputError
from trajopt.simulation import Event
from trajopt.simulation.simulate import simulate
from trajopt_library import robots

FLIGHT = 0.1  # s
# Momentum, N s: MuJoCo integrates a constant force exactly, up to rounding and its solver's tolerance.
MOMENTUM = 1e-6


@pytest.fixture(scope="module")
def flight() -> Solution:
    robot = robots.load("solo12")
    return sampled(robot, [tumbling_flight(robot, FLIGHT)], 4)


class Lift:
    """A force on the base, N, and half of the friction from ``begin`` s; notes what it finds."""

    def __init__(self, force: float, begin: float) -> None:
        self.force, self.begin = force, begin
        self.found: list[tuple[float, float, float]] = []

    def apply(self, t: float, model: Any, data: Any) -> None:
        base = data.body("body1")
        self.found.append((t, float(base.xfrc_applied[2]), float(model.pair_friction[0, 0])))
        if t >= self.begin:
            base.xfrc_applied[2] += self.force
            model.pair_friction[:, :2] *= 0.5


def momentum(plan: Solution, **settings: Any) -> np.ndarray:
    """Linear momentum (3,) at the end of a simulation without feedback, N s."""
    found = simulate(plan, kp=0.0, kd=0.0, **settings)
    mujoco, model = pytest.importorskip("mujoco"), found.scene.compiled
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = found.record.qpos[-1], found.record.qvel[-1]
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    return np.asarray(data.subtree_linvel[0] * model.body_subtreemass[0])


def test_an_event_is_applied_at_every_tick_to_what_is_without_events(flight: Solution) -> None:
    lift = Lift(3.0, FLIGHT / 2)
    found = simulate(flight, events=[lift])
    assert isinstance(lift, Event)
    times, forces, friction = np.array(lift.found).T
    np.testing.assert_allclose(times, found.timeline.t)
    assert not forces.any()
    assert len(set(friction)) == 1


def test_a_force_of_an_event_is_the_momentum_that_the_robot_gains(flight: Solution) -> None:
    gained = momentum(flight, events=[Lift(3.0, FLIGHT / 2)]) - momentum(flight)
    np.testing.assert_allclose(gained, [0.0, 0.0, 3.0 * FLIGHT / 2], atol=MOMENTUM)


def test_events_add_up(flight: Solution) -> None:
    first, second = Lift(3.0, 0.0), Lift(-1.0, 0.0)
    gained = momentum(flight, events=[first, second]) - momentum(flight)
    np.testing.assert_allclose(gained, [0.0, 0.0, 2.0 * FLIGHT], atol=MOMENTUM)
    usual = first.found[0][2]
    assert math.isclose(second.found[0][2], usual / 2)


@pytest.mark.parametrize(
    ("events", "said"),
    [
        ([3], r"events\[0\] of SimulationSettings is 3; allowed: an Event \(an object with apply\(\)\)"),
        (Lift(1.0, 0.0), "events of SimulationSettings is a Lift; allowed: a sequence, each an Event"),
    ],
)
def test_what_is_no_event_is_refused(flight: Solution, events: Any, said: str) -> None:
    with pytest.raises(InputError, match=said):
        simulate(flight, events=events)
