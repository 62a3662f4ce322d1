"""The controller: measured state and command in, torques out, at the rate of the drives; it knows no simulator."""

from __future__ import annotations

import math
import time as clocks
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from trajopt.arguments import NonNegative, Positive, checked
from trajopt.errors import InputError
from trajopt.mpc.clock import GaitClock
from trajopt.mpc.commands import STAND, Command
from trajopt.mpc.follow import Follower, FollowerGains
from trajopt.mpc.ground import GroundEstimate
from trajopt.mpc.motion import HorizonMotion
from trajopt.mpc.planner import HorizonPlanner, PlannerSettings
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.legs import feet_in_base
from trajopt.robot.robot import Robot
from trajopt.schedule.gaits import gait_of
from trajopt.robot.units import Units

# Periods of gaits over sqrt(l / g).
PERIODS = {"trot": 2.6, "walk": 4.0, "pace": 2.6, "bound": 2.4, "pronk": 2.4}
# A contact that is lost for less than this part of sqrt(l / g) goes on transmitting forces.
CHATTER = 0.05
# The commanded heading leads that of the base by at most so much, rad.
FARTHEST = 0.3


@checked
@dataclass(frozen=True, kw_only=True)
class ControllerSettings:
    """Settings of a controller.

    Args:
        period: of plans, s.
        delay: after which a plan is ready, s; the state is predicted over it.
        planner: settings of plans.
        gains: of what follows them.
        friction: Coulomb's coefficient that it counts on.
    """

    period: Positive = 0.01
    delay: NonNegative = 0.01
    planner: PlannerSettings = PlannerSettings()
    gains: FollowerGains = FollowerGains()
    friction: Positive = 0.6


@dataclass
class ControllerReport:
    """Of all ticks: seconds of plans and of torques, plans begun anew, residuals of the rows of plans."""

    planning: list[float] = field(default_factory=list)
    solving: list[float] = field(default_factory=list)
    following: list[float] = field(default_factory=list)
    primal: list[float] = field(default_factory=list)
    anew: int = 0


class Controller:
    """Whole-body receding-horizon control of a robot on legs.

    Args:
        robot: with a free base and 1, 2 or 4 feet.
        gaits: names of the gaits that it may be asked for; their horizons are made here.
        settings: of plans and of what follows them.
    """

    def __init__(
        self, robot: Robot, gaits: tuple[str, ...] = ("trot",), settings: ControllerSettings | None = None
    ) -> None:
        self.robot, self.settings = robot, settings or ControllerSettings()
        self.unit = Units(robot).time
        periods = {name: (gait_of(robot, name), PERIODS.get(name, 2.6) * self.unit) for name in gaits}
        names = list(feet_in_base(robot))
        self.clock = GaitClock(names, periods)
        self.planner = HorizonPlanner(robot, self.clock, self.settings.planner, friction=self.settings.friction)
        self.planner.prepare()
        self.follower = Follower(robot, self.settings.gains, friction=self.settings.friction)
        self.report = ControllerReport()
        self.motion: HorizonMotion | None = None
        self._pending: HorizonMotion | None = None
        self._heading: float | None = None
        self._now, self._next_plan = 0.0, -math.inf
        self._touched = np.full(len(robot.contacts), -math.inf)
        self._feet = [robot.contacts.index(robot.contact(name)) for name in names]
        self.ground = GroundEstimate(len(names), robot.length)
        self._radius = np.array([robot.contact(name).radius for name in names])

    def step(
        self, time: float, q: np.ndarray, v: np.ndarray, contacts: np.ndarray, command: Command
    ) -> np.ndarray:
        """Torques (nu,) for a tick.

        Args:
            time: s, increasing.
            q: measured configuration (nq,).
            v: measured velocity (nv,).
            contacts: which touch (nc,), in the robot's order.
            command: from now on.

        Raises:
            InputError: for a gait that was not named, and a state that is not finite or has another shape.
        """
        if command.gait != STAND and command.gait not in self.clock.gaits:
            allowed = ", ".join((STAND, *self.clock.gaits))
            raise InputError(f"gait is '{command.gait}'", f"allowed: {allowed}")
        touching = np.asarray(contacts, dtype=bool)
        self._pass(time, q, touching, command)
        if self._pending is not None and time >= self._pending.begin - 1e-9:
            self.motion, self._pending = self._pending, None
        if time >= self._next_plan - 1e-9 and self._pending is None:
            self._plan(time, q, v, command)
            self._next_plan = time + self.settings.period
        assert self.motion is not None
        begun = clocks.perf_counter()
        wanted = self.motion.sample(time)
        active = self._active(time, wanted.active, touching)
        torque = self.follower.torque(wanted, q, v, active)
        self.report.following.append(clocks.perf_counter() - begun)
        return torque

    def torque(self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray) -> np.ndarray:
        """`step` with the command of `commands`, as a simulation asks for it."""
        return self.step(t, q, v, touching, self.commands.at(t))

    commands = None

    def _pass(self, time: float, q: np.ndarray, touching: np.ndarray, command: Command) -> None:
        """Let time pass for clock, heading and the estimate of the ground."""
        passed, self._now = time - self._now, time
        feet = touching[self._feet]
        self.clock.advance(passed, dict(zip(self.clock.contacts, feet.tolist(), strict=True)))
        self.clock.request(command.gait)
        self._touched = np.where(touching, time, self._touched)
        places = np.array(list(contact_positions(self.robot, q).values()))[self._feet]
        places[:, 2] -= self._radius
        self.ground.touch(places, feet)
        x, y, z, w = q[3:7]
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        if self._heading is None:
            self._heading = yaw
        self._heading += command.turn_rate * passed
        away = math.remainder(self._heading - yaw, 2 * math.pi)
        self._heading = yaw + min(max(away, -FARTHEST), FARTHEST)

    def _plan(self, time: float, q: np.ndarray, v: np.ndarray, command: Command) -> None:
        begun, delay = clocks.perf_counter(), self.settings.delay
        q, v = self._predicted(time, q, v)
        own = self.clock.copy()
        if self.motion is not None and delay:
            own.advance(delay, dict.fromkeys(own.contacts, False))
        self.planner.clock = own
        motion = self.planner.plan(
            time + (delay if self.motion is not None else 0.0), q, v, command, self._heading or 0.0, self.ground
        )
        if self.motion is None:
            self.motion = motion
        else:
            self._pending = motion
        self.report.planning.append(clocks.perf_counter() - begun)
        self.report.solving.append(self.planner.report.solver_seconds)
        self.report.primal.append(self.planner.report.primal)
        self.report.anew += self.planner.report.began_anew

    def _predicted(self, time: float, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The state after the delay: the plan's, with what the follower leaves of the error of now."""
        delay, model = self.settings.delay, self.robot.model
        if self.motion is None or not delay:
            return q, v
        now, then = self.motion.sample(time), self.motion.sample(time + delay)
        error, rate, w = pin.difference(model, now.q, q), v - now.v, self.follower.bandwidths(now.active)
        left, kept = rate + w * error, np.exp(-w * delay)
        return pin.integrate(model, then.q, kept * (error + delay * left)), then.v + kept * (rate - w * delay * left)

    def _active(self, time: float, planned: np.ndarray, touching: np.ndarray) -> np.ndarray:
        """Contacts that transmit forces: planned ones that touch or did lately."""
        lately = time - self._touched <= CHATTER * self.unit
        return np.asarray(planned & lately)
