"""Receding-horizon control: plans from the measured state, and torques that follow them."""

from __future__ import annotations

import copy
import math
import time as clocks
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Generic, Self, TypeVar

import numpy as np
from typing_extensions import override

from trajopt.arguments import NonNegative, Positive, checked
from trajopt.control.mpc.clock import ModeClock
from trajopt.control.mpc.follow import Follower, FollowerGains
from trajopt.control.mpc.motion import FollowedSample, HorizonMotion, predicted, require_state
from trajopt.control.mpc.payload import payload_numbers
from trajopt.control.mpc.planner import HorizonPlanner, PlannerSettings
from trajopt.control.mpc.plans import ControllerReport, Make, Plans
from trajopt.control.mpc.reference import Reference
from trajopt.errors import InputError, require_positive
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units

# A contact that is lost for less than this, over sqrt(l / g), still counts as transmitting forces.
CHATTER = 0.05
# Time constant with which durations of modes follow those of plans, over sqrt(l / g).
ADAPTED = 0.15
AnyClock = TypeVar("AnyClock", bound=ModeClock)


@checked
@dataclass(frozen=True, kw_only=True)
class ControllerSettings:
    """Settings of a controller.

    Args:
        period: time between plans, s.
        delay: time after which a plan takes effect, s; the initial state is predicted over it.
        measured: whether plans start from the measured state; if not, each continues the last one, for
            comparison.
        live: whether a thread makes the plans, which are used when ready; if not, ticks wait for them.
        planner: settings of the plans.
        gains: gains of the feedback that follows the plans.
        friction: Coulomb's coefficient that plans and feedback assume.
        lift: swing height of point feet in gaits, over the robot's length.
        sole_lift: swing height of soles in gaits, over the robot's length.
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


class RecedingHorizon:
    """Control of a robot by plans that are made anew while it moves.

    Args:
        robot: the robot.
        plans: the plan in use and the next one.
    """

    def __init__(self, robot: Robot, plans: Plans) -> None:
        self.robot, self.plans = robot, plans

    def fresh(self) -> Self:
        """A controller as new, with the same horizons; this one must not have run."""
        twin = copy.copy(self)
        twin.plans = self.plans.fresh()
        return twin

    @property
    def report(self) -> ControllerReport:
        """Times and counts of all ticks so far."""
        return self.plans.report

    def _tick(
        self, time: float, maker: Callable[[], Make], torque: Callable[[FollowedSample], np.ndarray]
    ) -> np.ndarray:
        """Torques (nu,) at ``time`` s: ``torque`` of a sample of the plan, which ``maker`` makes when due."""
        motion = self.plans.update(time, maker)
        begun = clocks.perf_counter()
        followed = torque(motion.sample(time))
        self.report.following.append(clocks.perf_counter() - begun)
        return followed


class LegsController(RecedingHorizon, Generic[AnyClock]):
    """Whole-body receding-horizon control of a legged robot with a clock of contact modes.

    Args:
        robot: a robot with a free base.
        clock: clock of its contact modes.
        settings: settings of the plans and of the feedback.
    """

    def __init__(self, robot: Robot, clock: AnyClock, settings: ControllerSettings) -> None:
        super().__init__(robot, Plans(settings.period, settings.delay, live=settings.live))
        self.clock, self.settings = clock, settings
        self.unit = Units(robot).time
        self.planner = HorizonPlanner(robot, clock, settings.planner, friction=settings.friction)
        self.planner.prepare()
        self.follower = Follower(robot, settings.gains, friction=settings.friction)
        self.planner.report = self.follower.report = self.plans.report
        self._now = 0.0
        self._touched = np.full(len(robot.contacts), -math.inf)
        self._feet = [robot.contacts.index(robot.contact(name)) for name in clock.contacts]

    @override
    def fresh(self) -> Self:
        twin = super().fresh()
        twin.clock, twin.planner = self.clock.copy(), copy.copy(self.planner)
        twin.follower = Follower(self.robot, self.settings.gains, friction=self.settings.friction)
        twin.planner.report = twin.follower.report = twin.plans.report
        return twin

    def carry(self, mass: float, place: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0)) -> None:
        """Set the payload: a mass in kg on the base, at a place (3,) in its axes, m.

        Raises:
            InputError: for numbers that are not finite, or a negative mass.
        """
        payload = payload_numbers(mass, place)
        self.planner.payload = payload
        self.follower.carry(payload)

    def count_on(self, friction: float) -> None:
        """Set Coulomb's coefficient of the ground, > 0, for later plans and ticks. Raises `InputError`."""
        require_positive("friction", friction)
        self.planner.friction = self.follower.friction = friction

    def _passed(
        self, time: float, q: np.ndarray, v: np.ndarray, contacts: np.ndarray | Sequence[bool]
    ) -> float:
        """Advance clock and contacts to ``time``; returns the elapsed time, s. Raises `InputError`."""
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
        reference_maker: Callable[[], Callable[[AnyClock, np.ndarray], Reference]],
    ) -> np.ndarray:
        """Torques (nu,) of the present tick, ``passed`` s after the last one.

        When a new plan is due, ``reference_maker`` returns a function that makes its reference from the clock
        and the configuration (nq,) at its start.
        """

        def torque(wanted: FollowedSample) -> np.ndarray:
            self.clock.stretch(self.planner.stretch, passed / (ADAPTED * self.unit))
            lately = self._now - self._touched <= CHATTER * self.unit
            return self.follower.torque(wanted, q, v, wanted.active & lately)

        return self._tick(self._now, lambda: self._maker(q, v, reference_maker()), torque)

    def _maker(
        self, q: np.ndarray, v: np.ndarray, reference_at: Callable[[AnyClock, np.ndarray], Reference]
    ) -> Make:
        """A function that makes a plan from the present state; it uses a copy of the clock, for threads."""
        time, clock, motion = self._now, self.clock.copy(), self.plans.motion

        def make(begin: float) -> HorizonMotion:
            clock.advance(begin - time, dict.fromkeys(clock.contacts, False))
            self.planner.clock = clock
            state = self._predicted(motion, time, q, v, begin - time)
            return self.planner.plan(begin, *state, reference_at(clock, state[0]), motion)

        return make

    def _predicted(
        self, motion: HorizonMotion | None, time: float, q: np.ndarray, v: np.ndarray, delay: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """The state after a delay: that of the plan, plus the error that the feedback leaves by then."""
        if motion is None:
            return q, v
        if not self.settings.measured:
            planned = motion.sample(time + delay)
            return planned.q, planned.v
        if not delay:
            return q, v
        return predicted(motion, time, delay, (q, v), self.follower.bandwidths(motion.sample(time).active))
