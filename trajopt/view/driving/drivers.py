"""What a page steers: a robot on legs by its command, or the target of an arm's tool."""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from typing_extensions import override

from trajopt.collision import Obstacle
from trajopt.errors import InputError, not_among, shown
from trajopt.mpc.arm import ArmController, ArmSettings, ToolTarget
from trajopt.mpc.commands import STAND, Command
from trajopt.mpc.controller import Controller
from trajopt.mpc.follow import Follower
from trajopt.mpc.plans import Plans
from trajopt.mpc.receding import ControllerSettings
from trajopt.robot.kinematics import frame_pose
from trajopt.robot.natural_units import NaturalUnits
from trajopt.robot.robot import Robot
from trajopt.schedule.gaits import gait_names

# Gaits prepared by default, in seconds each; if a robot has none of them, its first MOST_GAITS.
USUAL_GAITS, MOST_GAITS = ("trot", "walk", "pace"), 2
# Largest commands in natural units: speed forward and sideways, turn rate, height. With fewer than FEET feet
# the speeds are scaled by CAREFUL.
SPEED, LATERAL, TURN, HEIGHT = 0.6, 0.25, 0.25, 0.15
FEET, CAREFUL = 4, 0.4
# Gaits that lift one of four feet at a time are limited to this fraction of the speeds: faster ones fall.
SLOW_GAITS, SLOW = ("walk", "amble"), 0.5
# Largest and initial push in units of weight times natural time.
MOST_PUSH, USUAL_PUSH = 0.5, 0.1
# Target of an arm: largest offset from its start over the robot's length, and speed in natural units.
FARTHEST, TARGET_SPEED = 0.35, 0.2
# Period and delay of plans, s. They are made in the loop: with Python's lock a separate thread is slower.
PERIOD, DELAY = 0.02, 0.01
# Names of the sliders of a push.
PUSH, DIRECTION = "push", "direction"
GAIT, SPEEDS = "gait", ("speed", "lateral", "turn_rate")
# A browser rounds the ends of a slider: values this far beyond them are clipped.
EDGE = 1e-9
# The value of a log entry.
Sent = TypeVar("Sent")


@dataclass(frozen=True, kw_only=True)
class Slider:
    """A number set by the page: bounds and initial value in ``unit``; keys that raise and lower it."""

    name: str
    label: str
    unit: str
    low: float
    high: float
    value: float = 0.0
    keys: tuple[str, str] = ("", "")


class PageController(ABC):
    """A robot steered from a page; the simulation uses it as its torque controller.

    Attributes:
        obstacles: avoided by the robot.
        sliders, gaits: what the page can set.
        values, gait: what is set now.
        offset: added to the time of the simulation, s.
    """

    robot: Robot
    obstacles: tuple[Obstacle, ...] = ()

    def __init__(self, sliders: Sequence[Slider], gaits: Sequence[str]) -> None:
        self.sliders, self.gaits = tuple(sliders), tuple(gaits)
        self.offset = 0.0
        self.stand()

    def stand(self) -> None:
        """Reset all values and the gait to the initial ones."""
        self.values: Mapping[str, float] = {slider.name: slider.value for slider in self.sliders}
        self.gait = STAND

    def obey(self, wanted: Mapping[str, Any]) -> None:
        """Set some of the values and the gait, all or none of them; callable from any thread.

        Raises:
            InputError: for an unknown name or gait, or a value that is not a finite number in its range.
        """
        known = {slider.name: slider for slider in self.sliders}
        names, values = [*known, *([GAIT] if self.gaits else [])], dict(self.values)
        for name, value in wanted.items():
            if name not in names:
                raise not_among(names, name, f"'{name}' is no command")
            if name == GAIT:
                if value not in (STAND, *self.gaits):
                    raise not_among((STAND, *self.gaits), str(value), f"gait is {shown(value)}")
                continue
            low, high, is_number = known[name].low, known[name].high, isinstance(value, int | float)
            if not is_number or isinstance(value, bool) or not low - EDGE <= value <= high + EDGE:
                allowed = f"allowed: {low:.4g} to {high:.4g} {known[name].unit}"
                raise InputError(f"{name} is {shown(value)}", allowed)
            values[name] = float(min(max(value, low), high))
        self.values, self.gait = values, str(wanted.get(GAIT, self.gait))

    @abstractmethod
    def begin(self) -> None:
        """Restart with a fresh controller."""

    @abstractmethod
    def torque(self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray) -> np.ndarray:
        """Torques (nu,) at time ``t``, s; see `TorqueController`."""

    @property
    @abstractmethod
    def plans(self) -> Plans:
        """The current plan, and figures of all plans."""

    @property
    def target(self) -> np.ndarray | None:
        """Desired position (3,) of the tool in the world, m; None without a tool."""
        return None

    def close(self) -> None:
        """Stop the planning thread."""
        self.plans.close()


class LegsDriver(PageController):
    """A legged robot that follows a commanded gait, speeds and height.

    Args:
        robot: with a free base and feet.
        gaits: to prepare; default: those of `USUAL_GAITS` that the robot has.
        settings: of the controller; default: a plan every `PERIOD` s, made in the loop.

    ``controller`` is the current one, ``log`` the commands since the last begin with their times in s, and
    ``slack`` as in `Steering`.

    Raises:
        InputError: for another base, or a gait that the robot does not have.
    """

    def __init__(
        self, robot: Robot, gaits: Sequence[str] | None = None, settings: ControllerSettings | None = None
    ) -> None:
        if robot.base != "freeflyer":
            raise InputError(f"robot '{robot.name}' has a {robot.base} base", "allowed: a free base, on feet")
        known, self.robot = gait_names(robot), robot
        names = tuple(gaits or [name for name in USUAL_GAITS if name in known] or known[:MOST_GAITS])
        self._made = Controller(robot, names, settings or ControllerSettings(period=PERIOD, delay=DELAY))
        units = NaturalUnits.of(robot.model)
        part = 1.0 if len(robot.contacts) >= FEET else CAREFUL
        speed, impulse = part * units.length / units.time, units.weight * units.time
        super().__init__(
            [
                _even("speed", "forward", "m/s", SPEED * speed, ("w", "s")),
                _even("lateral", "to the left", "m/s", LATERAL * speed, ("q", "e")),
                _even("turn_rate", "turn left", "rad/s", part * TURN / units.time, ("a", "d")),
                _even("height", "height", "m", HEIGHT * units.length),
                Slider(
                    name=PUSH, label="push", unit="N s", low=0.0, high=_rounded(MOST_PUSH * impulse),
                    value=_rounded(USUAL_PUSH * impulse),
                ),
                Slider(name=DIRECTION, label="push to", unit="°", low=-180.0, high=180.0, value=90.0),
            ],
            names,
        )  # fmt: skip
        self.controller = self._made
        self.begin()

    @property
    def command(self) -> Command:
        """The current command; speeds are zero in a stand and reduced in slow gaits."""
        if self.gait == STAND:
            return Command(height=self.values["height"])
        slow = self.gait in SLOW_GAITS and len(self.robot.contacts) >= FEET
        most = {each.name: (SLOW if slow else 1.0) * each.high for each in self.sliders}
        speeds = {name: min(max(self.values[name], -most[name]), most[name]) for name in SPEEDS}
        return Command(gait=self.gait, height=self.values["height"], **speeds)

    def _noted(self, time: float) -> Command:
        """The current command; it is logged with its time if it is new."""
        command = self.command
        if not self.log or self.log[-1][1] != command:
            self.log.append((time, command))
        return command

    @override
    def begin(self) -> None:
        self.close()
        self.log: list[tuple[float, Command]] = []
        self.offset = self.slack = 0.0
        self.controller = _as_new(self._made)

    @override
    def torque(self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray) -> np.ndarray:
        time = t + self.offset
        torque = self.controller.step(time, q, v, touching, self._noted(time))
        if self.controller.follower.last is not None:
            self.slack = max(self.slack, self.controller.follower.last.slack)
        return torque

    @property
    @override
    def plans(self) -> Plans:
        return self.controller.plans


class ArmDriver(PageController):
    """An arm whose tool follows a target, which moves at a bounded speed to where the page sets it.

    Args:
        robot: with a fixed base.
        tool: frame that follows the target and keeps its orientation; default: the last frame of the model.
        settings: of the controller; default: a plan every `PERIOD` s, made in the loop.
        obstacles: in the world, avoided by the arm.

    ``controller`` is the current one, ``path`` the path of the target since the last begin.

    Raises:
        InputError: for another base or frame.
    """

    def __init__(
        self,
        robot: Robot,
        tool: str | None = None,
        settings: ArmSettings | None = None,
        obstacles: Sequence[Obstacle] = (),
    ) -> None:
        self.robot, self.obstacles = robot, tuple(obstacles)
        chosen = settings or ArmSettings(period=PERIOD, delay=DELAY)
        self._made = ArmController(robot, tool, self.obstacles, chosen)
        self.controller = self._made
        self._start = frame_pose(robot, robot.reference, self._made.tool)
        units = NaturalUnits.of(robot.model)
        self._speed, far = TARGET_SPEED * units.length / units.time, FARTHEST * robot.length
        keys = (("w", "s"), ("a", "d"), ("e", "q"))
        super().__init__(
            [
                Slider(name=axis, label=axis, unit="m", low=at - far, high=at + far, value=at, keys=pair)
                for axis, at, pair in zip("xyz", self._start.translation.tolist(), keys, strict=True)
            ],
            (),
        )
        self.begin()

    @override
    def begin(self) -> None:
        self.close()
        self.controller = copy.copy(self._made)
        self.controller.plans = _plans_of(self._made.settings)
        self.offset, self._place = 0.0, self._start.translation.copy()
        self.path = TargetPath(self._place, self._speed)

    @override
    def torque(self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray) -> np.ndarray:
        time = t + self.offset
        self.path.send(time, np.array([self.values[axis] for axis in "xyz"]))
        self._place, velocity = self.path.at(time)
        target = ToolTarget(position=self._place, rotation=self._start.rotation, velocity=velocity)
        return self.controller.step(time, q, v, target)

    @property
    @override
    def plans(self) -> Plans:
        return self.controller.plans

    @property
    @override
    def target(self) -> np.ndarray:
        return self._place

    @property
    def tool(self) -> str:
        """Name of the frame that follows the target."""
        return self._made.tool


def since(log: Sequence[tuple[float, Sent]], offset: float) -> list[tuple[float, Sent]]:
    """The entries of a log in effect from ``offset`` s on, with times relative to it; the first is at 0."""
    times = [max(time - offset, 0.0) for time, _ in log]
    first = sum(time == 0.0 for time in times) - 1
    return [(time, sent) for time, (_, sent) in zip(times, log, strict=True)][first:]


def _as_new(made: Controller) -> Controller:
    """A fresh copy of ``made``, which is itself never run; the copies share its horizons."""
    new = copy.copy(made)
    new.clock, new.ground, new.planner = made.clock.copy(), made.ground.copy(), copy.copy(made.planner)
    new.follower = Follower(made.robot, made.settings.gains, friction=made.settings.friction)
    new.plans = _plans_of(made.settings)
    new.planner.report = new.plans.report
    return new


def _plans_of(settings: ControllerSettings | ArmSettings) -> Plans:
    return Plans(settings.period, settings.delay, live=settings.live)


def _even(name: str, label: str, unit: str, most: float, keys: tuple[str, str] = ("", "")) -> Slider:
    most = _rounded(most)
    return Slider(name=name, label=label, unit=unit, low=-most, high=most, keys=keys)


def _rounded(value: float) -> float:
    """The value rounded to two significant digits."""
    digits = 1 - math.floor(math.log10(value))
    return round(value, digits)


class TargetPath:
    """A target that moves along straight lines at constant speed to where it was last sent.

    Args:
        start: initial position (3,), m.
        speed: m/s.

    ``goals`` are the times, s, and positions (3,), m, to which it was sent.
    """

    def __init__(self, start: np.ndarray, speed: float) -> None:
        self._speed = speed
        self.goals = [(0.0, start)]
        self._from = [start]

    def send(self, time: float, goal: np.ndarray) -> None:
        """Send the target to ``goal`` (3,), m, at ``time``, s, which is not before that of the last call."""
        if not np.array_equal(goal, self.goals[-1][1]):
            start, _ = self.at(time)
            self.goals.append((time, goal))
            self._from.append(start)

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,), m, and velocity (3,), m/s, of the target at ``time``, s."""
        last = max(bisect_right(self.goals, time, key=lambda sent: sent[0]) - 1, 0)
        (begun, goal), start = self.goals[last], self._from[last]
        way = goal - start
        far, gone = float(np.linalg.norm(way)), self._speed * (time - begun)
        if gone >= far:
            return goal, np.zeros(3)
        return start + gone / far * way, self._speed / far * way
