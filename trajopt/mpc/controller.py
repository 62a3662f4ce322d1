"""The controller: measured state and command in, torques out, at each tick; it knows no simulator."""

from __future__ import annotations

import math
import time as clocks
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

from trajopt.arguments import NonNegative, Positive, checked
from trajopt.errors import InputError
from trajopt.mpc.clock import GaitClock
from trajopt.mpc.commands import STAND, Command
from trajopt.mpc.follow import Follower, FollowerGains
from trajopt.mpc.ground import GroundEstimate
from trajopt.mpc.motion import HorizonMotion, predicted, require_state
from trajopt.mpc.planner import HorizonPlanner, PlannerSettings
from trajopt.mpc.plans import ControllerReport, Make, Plans
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.legs import feet_in_base
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.schedule.gaits import Gait, gait_of

# Periods of gaits over sqrt(l / g).
PERIODS = {"trot": 2.6, "walk": 4.0, "pace": 1.6, "bound": 1.8, "pronk": 2.4}
# Duty factors other than those of `trajopt.schedule.gaits`: a bound without flight.
DUTIES = {"bound": 0.5}
# A contact that is lost for less than this part of sqrt(l / g) goes on transmitting forces.
CHATTER = 0.05
# Speeds follow commands at this part of g, and turns at this over l / g.
FASTEST, FASTEST_TURN = 0.3, 0.4
# What speeds lack is integrated at this rate over sqrt(l / g), where it is less than a part of sqrt(g l).
STEADY, SMALL, MOST = 0.3, 0.2, 0.15
# The commanded heading leads that of the base by at most so much, rad.
FARTHEST = 0.3


@checked
@dataclass(frozen=True, kw_only=True)
class ControllerSettings:
    """Settings of a controller.

    Args:
        period: of plans, s.
        delay: after which a plan is ready, s; the state is predicted over it.
        measured: plans begin from the measured state; otherwise each goes on from the last one, for
            comparison.
        live: plans are made by a thread, and used when they are ready; otherwise each tick waits for its own.
        planner: settings of plans.
        gains: of what follows them.
        friction: Coulomb's coefficient that it counts on.
    """

    period: Positive = 0.01
    delay: NonNegative = 0.01
    measured: bool = True
    live: bool = False
    planner: PlannerSettings = field(default_factory=PlannerSettings)
    gains: FollowerGains = field(default_factory=FollowerGains)
    friction: Positive = 0.6


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
        periods = {name: (_gait(robot, name), PERIODS.get(name, 2.6) * self.unit) for name in gaits}
        names = list(feet_in_base(robot))
        self.clock = GaitClock(names, periods)
        self.planner = HorizonPlanner(
            robot, self.clock, self.settings.planner, friction=self.settings.friction
        )
        self.planner.prepare()
        self.follower = Follower(robot, self.settings.gains, friction=self.settings.friction)
        self.plans = Plans(self.settings.period, self.settings.delay, live=self.settings.live)
        self.planner.report = self.plans.report
        self._heading: float | None = None
        self._asked = Command()
        self._lacking = np.zeros(2)
        self._now = 0.0
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
            InputError: for a gait that was not named, a time that is not finite or runs back, and a state
                that is not finite or has another shape.
        """
        require_state(self.robot, time, q, v)
        if not time >= self._now:
            raise InputError(f"time is {time:g} s after {self._now:g} s", "allowed: increasing")
        if command.gait != STAND and command.gait not in self.clock.gaits:
            allowed = ", ".join((STAND, *self.clock.gaits))
            raise InputError(f"gait is '{command.gait}'", f"allowed: {allowed}")
        touching = np.asarray(contacts, dtype=bool)
        if touching.shape != (len(self.robot.contacts),):
            allowed = f"allowed: ({len(self.robot.contacts)},), one for each contact"
            raise InputError(f"contacts have shape {touching.shape}", allowed)
        self._pass(time, q, v, touching, command)
        motion = self.plans.update(time, self._maker(time, q, v, self._corrected))
        begun = clocks.perf_counter()
        wanted = motion.sample(time)
        active = self._active(time, wanted.active, touching)
        torque = self.follower.torque(wanted, q, v, active)
        self.report.following.append(clocks.perf_counter() - begun)
        return torque

    def _pass(
        self, time: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray, command: Command
    ) -> None:
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
        turn = pin.Quaternion(w, x, y, z).toRotationMatrix()
        yaw = math.atan2(turn[1, 0], turn[0, 0])
        self._asked = self._nearer(self._asked, command, passed)
        self._integrate(passed, turn[:2] @ v[:3], yaw)
        if self._heading is None:
            self._heading = yaw
        self._heading += self._asked.turn_rate * passed
        away = math.remainder(self._heading - yaw, 2 * math.pi)
        self._heading = yaw + min(max(away, -FARTHEST), FARTHEST)

    def _integrate(self, passed: float, level: np.ndarray, yaw: float) -> None:
        """What the level velocity (2,) of a gait, world, lacks on average, by errors of the model."""
        turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
        lacks = np.array([self._asked.speed, self._asked.lateral]) - turn @ level
        unit = self.robot.length / self.unit
        if self.clock.gait == STAND:
            self._lacking[:] = 0.0
        elif np.linalg.norm(lacks) < SMALL * unit:
            moved = self._lacking + passed * STEADY / self.unit * lacks
            self._lacking = np.clip(moved, -MOST * unit, MOST * unit)

    @property
    def _corrected(self) -> Command:
        """What is asked for, with what was lacking."""
        speed, lateral = self._asked.speed + self._lacking[0], self._asked.lateral + self._lacking[1]
        return replace(self._asked, speed=float(speed), lateral=float(lateral))

    def _nearer(self, now: Command, command: Command, passed: float) -> Command:
        """What is asked for after some time on the way to a command: speeds change at bounded rates."""
        length = self.robot.length
        rates = {
            "speed": FASTEST * length / self.unit**2,
            "lateral": FASTEST * length / self.unit**2,
            "turn_rate": FASTEST_TURN / self.unit**2,
            "height": length / self.unit / 4,
        }
        moved = {}
        for name, rate in rates.items():
            before, wanted, most = getattr(now, name), getattr(command, name), rate * passed
            moved[name] = before + min(max(wanted - before, -most), most)
        return replace(command, **moved)

    @property
    def report(self) -> ControllerReport:
        """What happened until now."""
        return self.plans.report

    def _maker(self, time: float, q: np.ndarray, v: np.ndarray, command: Command) -> Make:
        """What makes a plan from the state at ``time`` s, apart from all that goes on meanwhile."""

        def make(begin: float) -> HorizonMotion:
            delay = begin - time
            clock.advance(delay, dict.fromkeys(clock.contacts, False))
            self.planner.clock = clock
            state = self._predicted(motion, time, q, v, delay)
            if motion is not None and not self.settings.measured:
                planned = motion.sample(begin)
                state = planned.q, planned.v
            return self.planner.plan(begin, *state, command, heading, ground, motion)

        clock, ground, motion = self.clock.copy(), self.ground.copy(), self.plans.motion
        heading = self._heading or 0.0
        return make

    def _predicted(
        self, motion: HorizonMotion | None, time: float, q: np.ndarray, v: np.ndarray, delay: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """The state after a delay: the plan's, with what the follower leaves of the error of now."""
        if motion is None or not delay:
            return q, v
        rates = self.follower.bandwidths(motion.sample(time).active)
        return predicted(motion, time, delay, (q, v), rates)

    def _active(self, time: float, planned: np.ndarray, touching: np.ndarray) -> np.ndarray:
        """Contacts that transmit forces: planned ones that touch or did lately."""
        lately = time - self._touched <= CHATTER * self.unit
        return np.asarray(planned & lately)


def _gait(robot: Robot, name: str) -> Gait:
    """A gait of a robot, with the duty factor that it has here."""
    gait = gait_of(robot, name)
    return gait.with_duty(DUTIES[name]) if name in DUTIES else gait
