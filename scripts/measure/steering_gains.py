"""Torques of a plan with feedback gains of its optimum, beside the follower's quadratic program."""

from functools import partial
from typing import Any

import click
import numpy as np
import pinocchio as pin

from scripts.measure.shared import head, row
from scripts.measure.steering import START, straight, survived, usual_speed
from trajopt.mpc import (
    Controller,
    ControllerSettings,
    Follower,
    HorizonMotion,
    HorizonPlanner,
    PlannerSettings,
    drive,
)
from trajopt.mpc.motion import FollowedSample
from trajopt.robot import Robot
from trajopt.robot.natural_units import NaturalUnits
from trajopt_library import robots

# Changes of the start, rad or m and over natural times, and steps of the solver after each.
CHANGE, STEPS = 1e-3, 3


class GainPlanner(HorizonPlanner):
    """A planner that differentiates each plan's first torques by its start.

    gains: (nu, 2 nv) of plans by their begin, s.
    """

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self.gains: dict[float, np.ndarray] = {}

    def plan(self, time: float, q: np.ndarray, v: np.ndarray, *others: Any) -> HorizonMotion:
        """The plan of `HorizonPlanner`, whose gains are kept."""
        motion = super().plan(time, q, v, *others)
        if self._last is not None:
            self.gains[motion.begin] = self._gains(time, q, v)
        return motion

    def _gains(self, time: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Forward differences of optima, each with a few steps from that of the start."""
        nv, unit = self.robot.nv, NaturalUnits.of(self.robot.model).time
        sizes = np.concatenate([np.full(nv, CHANGE), np.full(nv, CHANGE / unit)])
        changed = [self._torque(time, q, v)]
        for k in range(2 * nv):
            away = np.zeros(2 * nv)
            away[k] = sizes[k]
            moved = pin.integrate(self.robot.model, q, away[:nv]), v + away[nv:]
            changed.append(self._torque(time, *moved))
        return np.asarray((np.array(changed[1:]) - changed[0]).T / sizes)

    def _torque(self, time: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """First torques (nu,) of the last horizon from a start nearby."""
        assert self._last is not None
        horizon, iterate = self._last
        again = {name: np.copy(value) for name, value in iterate.items()}
        held = self._held(q, v, horizon.pattern.contacts[0])
        start = horizon.layout.coordinates.node_from_pinocchio(q, held)
        start[:4] *= 1.0 if start[:4] @ iterate["x"][:4] >= 0 else -1.0
        horizon.set_start(start)
        solved, _ = self.settings.solver.solve(horizon, again, STEPS)
        return HorizonMotion(horizon, solved["x"], time).sample(time).torque


class GainFollower(Follower):
    """Torques of the plan, with its gains on errors of the state, within the limits."""

    controller: Controller

    def torque(self, wanted: FollowedSample, q: np.ndarray, v: np.ndarray, active: np.ndarray) -> np.ndarray:
        """Torques (nu,) for a measured state; contacts that are late are not pressed down."""
        planner, motion = self.controller.planner, self.controller.plans.motion
        assert isinstance(planner, GainPlanner)
        assert motion is not None
        error = np.concatenate([pin.difference(self.robot.model, wanted.q, q), v - wanted.v])
        torque = wanted.torque + planner.gains[motion.begin] @ error
        return np.clip(torque, self._low, self._high)


def controller_of(robot: Robot, word: str) -> Controller:
    """A controller by the quadratic program, or by gains."""
    planner = PlannerSettings(timing=0.0)
    controller = Controller(robot, settings=ControllerSettings(planner=planner))
    if word == "gains":
        made = controller.planner
        controller.planner = GainPlanner(robot, controller.clock, made.settings, friction=made.friction)
        controller.planner.horizons, controller.planner.report = made.horizons, made.report
        follower = GainFollower(robot, controller.settings.gains, friction=controller.settings.friction)
        follower.controller = controller
        controller.follower = follower
    return controller


@click.command("gains")
@click.option("--robots", "names", default="go2,anymal_c", metavar="A,B", show_default=True)
@click.option("--sizes", default="0.1,0.2,0.3,0.4,0.5,0.6", show_default=True, help="Natural units.")
def gains(names: str, sizes: str) -> None:
    """Largest push before the first fall, trotting, and errors of speed without one."""
    head("robot", "torques by", "speed, m/s", "from behind", "from the right", "from the front")
    for name in names.split(","):
        robot = robots.load(name)
        for word in ("program", "gains"):
            make = partial(controller_of, robot, word)
            script, time = straight("trot", usual_speed(robot)), START + 1.0
            alone = drive(robot, script, duration=3.0, controller=make())
            errors = alone.report.mean_errors
            error = "fell" if alone.report.fell or errors is None else f"{errors.speed:.3f}"
            numbers = [float(size) for size in sizes.split(",")]
            lasts = time + 6 * NaturalUnits.of(robot.model).time
            largest = [survived(robot, angle, numbers, time, lasts, make) for angle in (0, 90, 180)]
            row(name, word, error, *(f"{size:.1f}" for size in largest))
