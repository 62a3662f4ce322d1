"""What every controller of a robot on legs does at a tick: plan ahead from the measured state, and follow."""

from __future__ import annotations

import math
import time as clocks
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from trajopt.arguments import NonNegative, Positive, checked
from trajopt.errors import InputError, require_positive
from trajopt.mpc.clock import ModeClock
from trajopt.mpc.follow import Follower, FollowerGains
from trajopt.mpc.motion import HorizonMotion, predicted, require_state
from trajopt.mpc.payload import payload_numbers
from trajopt.mpc.planner import HorizonPlanner, PlannerSettings
from trajopt.mpc.plans import ControllerReport, Make, Plans
from trajopt.mpc.reference import Reference
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units

# A contact that is lost for less than this part of sqrt(l / g) goes on transmitting forces.
CHATTER = 0.05
# Durations follow what plans want within this part of sqrt(l / g).
ADAPTED = 0.15
AnyClock = TypeVar("AnyClock", bound=ModeClock)


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
        lift: height of swings of point feet in gaits over the robot's length.
        sole_lift: likewise of soles.
    """

    period: Positive = 0.01
    delay: NonNegative = 0.01
    measured: bool = True
    live: bool = False
    planner: PlannerSettings = field(default_factory=PlannerSettings)
    gains: FollowerGains = field(default_factory=FollowerGains)
    friction: Positive = 0.6
    lift: Positive = 0.25
    sole_lift: Positive = 0.1


class LegsController(Generic[AnyClock]):
    """Whole-body receding-horizon control of a robot on legs by a clock of contact modes.

    Args:
        robot: with a free base.
        clock: of its contacts.
        settings: of plans and of what follows them.
    """

    def __init__(self, robot: Robot, clock: AnyClock, settings: ControllerSettings) -> None:
        self.robot, self.clock, self.settings = robot, clock, settings
        self.unit = Units(robot).time
        self.planner = HorizonPlanner(robot, clock, settings.planner, friction=settings.friction)
        self.planner.prepare()
        self.follower = Follower(robot, settings.gains, friction=settings.friction)
        self.plans = Plans(settings.period, settings.delay, live=settings.live)
        self.planner.report = self.plans.report
        self._now = 0.0
        self._touched = np.full(len(robot.contacts), -math.inf)
        self._feet = [robot.contacts.index(robot.contact(name)) for name in clock.contacts]

    def carry(self, mass: float, place: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0)) -> None:
        """Count on a mass in kg on the base, at a place (3,) in its axes, m, in place of the one before.

        Raises:
            InputError: for numbers that are not finite, and a negative mass.
        """
        payload = payload_numbers(mass, place)
        self.planner.payload = payload
        self.follower.carry(payload)

    def count_on(self, friction: float) -> None:
        """Count on Coulomb's coefficient of the ground from the next plan on, > 0. Raises `InputError`."""
        require_positive("friction", friction)
        self.planner.friction = self.follower.friction = friction

    @property
    def report(self) -> ControllerReport:
        """What happened until now."""
        return self.plans.report

    def _passed(
        self, time: float, q: np.ndarray, v: np.ndarray, contacts: np.ndarray | Sequence[bool]
    ) -> float:
        """Let time pass for the clock and what touches; returns how much, s. Raises `InputError`."""
        require_state(self.robot, time, q, v)
        if not time >= self._now:
            raise InputError(f"time is {time:g} s after {self._now:g} s", "allowed: increasing")
        touching, count = np.asarray(contacts, dtype=bool), len(self.robot.contacts)
        if touching.shape != (count,):
            raise InputError(
                f"contacts have shape {touching.shape}", f"allowed: ({count},), one for each contact"
            )
        passed, self._now = time - self._now, time
        self.clock.advance(passed, dict(zip(self.clock.contacts, touching[self._feet].tolist(), strict=True)))
        self._touched = np.where(touching, time, self._touched)
        return passed

    def _follow(
        self,
        passed: float,
        q: np.ndarray,
        v: np.ndarray,
        refer: Callable[[], Callable[[AnyClock, np.ndarray], Reference]],
    ) -> np.ndarray:
        """Torques (nu,) now, ``passed`` s after the last ones.

        Where a plan begins, ``refer`` is asked for what makes its reference, of the clock and the
        configuration (nq,) at its begin.
        """
        time = self._now
        motion = self.plans.update(time, lambda: self._maker(q, v, refer()))
        self.clock.stretch(self.planner.stretch, passed / (ADAPTED * self.unit))
        begun = clocks.perf_counter()
        wanted = motion.sample(time)
        lately = time - self._touched <= CHATTER * self.unit
        torque = self.follower.torque(wanted, q, v, wanted.active & lately)
        self.report.following.append(clocks.perf_counter() - begun)
        return torque

    def _maker(
        self, q: np.ndarray, v: np.ndarray, refer: Callable[[AnyClock, np.ndarray], Reference]
    ) -> Make:
        """What makes a plan from the state of now, apart from all that goes on meanwhile."""
        time, clock, motion = self._now, self.clock.copy(), self.plans.motion

        def make(begin: float) -> HorizonMotion:
            clock.advance(begin - time, dict.fromkeys(clock.contacts, False))
            self.planner.clock = clock
            state = self._predicted(motion, time, q, v, begin - time)
            return self.planner.plan(begin, *state, refer(clock, state[0]), motion)

        return make

    def _predicted(
        self, motion: HorizonMotion | None, time: float, q: np.ndarray, v: np.ndarray, delay: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """The state after a delay: the plan's, with what the follower leaves of the error of now."""
        if motion is None:
            return q, v
        if not self.settings.measured:
            planned = motion.sample(time + delay)
            return planned.q, planned.v
        if not delay:
            return q, v
        return predicted(motion, time, delay, (q, v), self.follower.bandwidths(motion.sample(time).active))
