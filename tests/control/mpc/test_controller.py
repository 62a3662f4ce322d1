"""The controller on an integrator that is not MuJoCo: numeric Pinocchio, contacts by their KKT conditions."""

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import pytest

from trajopt.certify.contact.contact_dynamics import forward_dynamics
from trajopt.certify.contact.contact_set import ContactSet
from trajopt.control.mpc.commands import Command
from trajopt.control.mpc.controller import Controller
from trajopt.control.mpc.receding import ControllerSettings
from trajopt.errors import InputError
from trajopt.robot import Robot
from trajopt_library import robots

pytestmark = pytest.mark.long

TICK, SUBSTEPS = 2e-3, 2
# A foot holds from this height on, m: what it has left when its stance begins.
TOUCHED = 2e-3


@dataclass
class Walk:
    """States (n, nq), (n, nv) and torques (n, nu) at ticks."""

    q: np.ndarray
    v: np.ndarray
    torque: np.ndarray


def walked(robot: Robot, controller: Controller, command: Command, duration: float) -> Walk:
    """Feet hold while the plan in use has them stand, once they have reached the ground."""
    model, q, v = robot.model, robot.reference.copy(), np.zeros(robot.nv)
    data, frames = model.createData(), [robot.model.getFrameId(c.frame) for c in robot.contacts]
    held, rows = np.ones(len(frames), dtype=bool), ([], [], [])
    for k in range(round(duration / TICK)):
        torque = controller.step(k * TICK, q, v, held, command if k * TICK > 0.1 else Command())
        pin.framesForwardKinematics(model, data, q)
        heights = [data.oMf[i].translation[2] for i in frames]
        low = np.array([h <= c.radius + TOUCHED for h, c in zip(heights, robot.contacts, strict=True)])
        assert controller.plans.motion is not None
        planned = controller.plans.motion.sample(k * TICK).active
        landed, held = planned & low & ~held, planned & (held | low)
        contacts = ContactSet.of(model, [(robot.contacts[i].frame, 3) for i in np.flatnonzero(held)])
        if landed.any():
            v = stopped(robot, q, v, held)
        for values, value in zip(rows, (q, v, torque), strict=True):
            values.append(value)
        whole = np.concatenate([np.zeros(6), torque])
        for _ in range(SUBSTEPS):
            v = v + TICK / SUBSTEPS * forward_dynamics(model, q, v, whole, contacts).acceleration
            q = pin.integrate(model, q, TICK / SUBSTEPS * v)
    return Walk(*(np.array(values) for values in rows))


def stopped(robot: Robot, q: np.ndarray, v: np.ndarray, held: np.ndarray) -> np.ndarray:
    """The velocity after an inelastic impact, by which the feet that hold come to rest."""
    names = [c.name for c, holds in zip(robot.contacts, held, strict=True) if holds]
    model, data = robot.model, robot.model.createData()
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    frames = [model.getFrameId(robot.contact(name).frame) for name in names]
    jacobian = np.vstack([pin.getFrameJacobian(model, data, i, pin.LOCAL_WORLD_ALIGNED)[:3] for i in frames])
    mass = pin.crba(model, data, q)
    spread = np.linalg.solve(mass, jacobian.T)
    return np.asarray(v - spread @ np.linalg.solve(jacobian @ spread, jacobian @ v))


@pytest.fixture(scope="module")
def robot() -> Robot:
    return robots.load("go2")


@pytest.mark.slow
def test_it_trots_on_a_second_integrator(robot: Robot) -> None:
    controller = Controller(robot, ("trot",))
    walk = walked(robot, controller, Command(gait="trot", speed=0.3, lateral=0.1), 2.5)
    since = round(1.5 / TICK)
    way = walk.q[-1, :2] - walk.q[since, :2]
    assert way == pytest.approx([0.3, 0.1], abs=0.05)
    assert np.ptp(walk.q[since:, 2]) < 0.1 * robot.length
    assert robot.torque_limit is not None
    assert (np.abs(walk.torque) <= robot.torque_limit + 1e-9).all()
    assert controller.report.anew == 0
    assert controller.report.ticks[0] == len(walk.q)


def test_plans_made_by_a_thread_are_used_when_they_are_ready(robot: Robot) -> None:
    controller = Controller(robot, ("trot",), ControllerSettings(live=True))
    q, v, touching = robot.reference, np.zeros(robot.nv), np.ones(4, dtype=bool)
    for k in range(200):
        torque = controller.step(k * TICK, q, v, touching, Command())
        assert np.isfinite(torque).all()
    controller.plans.close()
    assert len(controller.report.planning) >= 2
    assert controller.report.missed >= 0


def test_a_gait_that_was_not_prepared_and_states_that_are_none_are_refused(robot: Robot) -> None:
    controller = Controller(robot, ("trot",))
    q, v, touching = robot.reference, np.zeros(robot.nv), np.ones(4, dtype=bool)
    with pytest.raises(InputError, match=r"gait is 'pace'.*trot"):
        controller.step(0.0, q, v, touching, Command(gait="pace"))
    with pytest.raises(InputError, match="q of a state"):
        controller.step(0.0, q[:-1], v, touching, Command())
    with pytest.raises(InputError, match=r"v\[3\] of a state is nan"):
        controller.step(0.0, q, np.where(np.arange(robot.nv) == 3, math.nan, 0.0), touching, Command())
    with pytest.raises(InputError, match="contacts"):
        controller.step(0.0, q, v, touching[:2], Command())
    with pytest.raises(InputError, match="time"):
        controller.step(math.nan, q, v, touching, Command())


def test_what_it_counts_on_must_be_possible(robot: Robot) -> None:
    controller = Controller(robot)
    for mass, place, words in (
        (-1.0, (0.0, 0.0, 0.0), "mass on the base is -1"),
        (math.nan, (0.0, 0.0, 0.0), "mass on the base is nan"),
        (1.0, (0.0, math.inf, 0.0), "place on the base is"),
        (1.0, (0.0, 0.0), "place on the base is"),
    ):
        with pytest.raises(InputError, match=words):
            controller.carry(mass, place)
    for friction in (0.0, -0.5, math.nan):
        with pytest.raises(InputError, match="friction is"):
            controller.count_on(friction)
    assert not controller.planner.payload.any()
    assert controller.planner.friction == controller.settings.friction


def test_robots_that_cannot_walk_are_refused() -> None:
    with pytest.raises(InputError, match="fixed base"):
        Controller(robots.load("panda"), ("trot",))
    with pytest.raises(InputError, match="gait 'trot' is unknown"):
        Controller(robots.load("g1"), ("trot",))


def test_no_horizon_is_made_in_the_loop(robot: Robot) -> None:
    """Whatever is asked for, and when: the patterns of all changes are there from the start."""
    controller = Controller(robot, ("trot", "pronk"))
    made, generator = set(controller.planner.horizons), np.random.default_rng(0)
    clock, feet = controller.clock, dict.fromkeys(controller.clock.contacts, False)
    controller.planner.clock = clock
    for _ in range(2000):
        clock.advance(float(generator.uniform(0.0, 0.05)), feet)
        if generator.uniform() < 0.1:
            clock.request(str(generator.choice(["stand", "trot", "pronk"])))
        controller.planner.horizon()
    assert set(controller.planner.horizons) == made
