"""What a page steers: a robot on legs by its command, or the target of an arm's tool."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from typing_extensions import override

from trajopt.collision import Obstacle
from trajopt.control.mpc.arm import ArmController, ArmSettings
from trajopt.control.mpc.commands import SPEEDS, STAND, Command
from trajopt.control.mpc.controller import Controller
from trajopt.control.mpc.plans import Plans
from trajopt.control.mpc.receding import ControllerSettings
from trajopt.errors import InputError, not_among, shown
from trajopt.robot.natural_units import NaturalUnits
from trajopt.robot.robot import Robot
from trajopt.schedule.gaits import gait_names
from trajopt.simulation.arm_drive import AXES, DELAY, PERIOD, ArmDrive, ToolSteering
from trajopt.simulation.driven_scene import DrivenScene
from trajopt.simulation.lockstep import DrivenMotion, Steering
from trajopt.simulation.simulated import SimulatedMotion
from trajopt.terrain.piecewise import PiecewiseTerrain

# Gaits prepared by default, in seconds each; if a robot has none of them, its first MOST_GAITS.
USUAL_GAITS, MOST_GAITS = ("trot", "walk", "pace"), 2
# Largest commands in natural units: speed forward and sideways, turn rate, height. With fewer than FEET feet
# the speeds are scaled by CAREFUL.
SPEED, LATERAL, TURN, HEIGHT = 0.6, 0.25, 0.25, 0.15
FEET, CAREFUL = 4, 0.4
# Gaits of four or more feet with long stances are limited to these fractions of the speeds: faster ones fall.
SLOW = {"walk": 0.5, "amble": 0.5, "ripple": 0.5, "wave": 0.2}
# Largest and initial push in units of weight times natural time.
MOST_PUSH, USUAL_PUSH = 0.5, 0.1
# Names of the sliders of a push.
PUSH, DIRECTION = "push", "direction"
GAIT = "gait"
# A browser rounds the ends of a slider: values this far beyond them are clipped.
EDGE = 1e-9
AnySteering = TypeVar("AnySteering", bound=Steering | ToolSteering)


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


class PageController(ABC, Generic[AnySteering]):
    """A robot that is steered from a page.

    Attributes:
        steering: the controller that follows what is set.
        obstacles: avoided by the robot.
        terrain: ground; None where it is level.
        sliders, gaits: what the page can set.
        values, gait: what is set now.
    """

    robot: Robot
    steering: AnySteering
    obstacles: tuple[Obstacle, ...] = ()
    terrain: PiecewiseTerrain | None = None

    def __init__(self, sliders: Sequence[Slider], gaits: Sequence[str]) -> None:
        self.sliders, self.gaits = tuple(sliders), tuple(gaits)
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
    def recorded(self, driven: DrivenScene) -> SimulatedMotion:
        """The recorded drive since the last begin; its settings do not contain pushes on legs."""

    @property
    def plans(self) -> Plans:
        """The current plan, and figures of all plans."""
        return self.steering.controller.plans

    def height(self, time: float) -> float:
        """Commanded height of the base over that of the reference posture, m."""
        return 0.0

    @property
    def target(self) -> np.ndarray | None:
        """Desired position (3,) of the tool in the world, m; None without a tool."""
        return None

    def close(self) -> None:
        """Stop the planning thread."""
        self.plans.close()


class LegsDriver(PageController[Steering]):
    """A legged robot that follows a commanded gait, speeds and height.

    Args:
        robot: with a free base and feet.
        gaits: to prepare; default: those of `USUAL_GAITS` that the robot has.
        settings: of the controller; default: a plan every `PERIOD` s, made in the loop.
        terrain: ground that the robot touches and the controller knows; default: level ground.

    ``steering`` has the current controller, ``log`` the commands since the last begin with their times in s.

    Raises:
        InputError: for another base, or a gait that the robot does not have.
    """

    def __init__(
        self,
        robot: Robot,
        gaits: Sequence[str] | None = None,
        settings: ControllerSettings | None = None,
        terrain: PiecewiseTerrain | None = None,
    ) -> None:
        if robot.base != "freeflyer":
            raise InputError(f"robot '{robot.name}' has a {robot.base} base", "allowed: a free base, on feet")
        known, self.robot, self.terrain = gait_names(robot), robot, terrain
        names = tuple(gaits or [name for name in USUAL_GAITS if name in known] or known[:MOST_GAITS])
        chosen = settings or ControllerSettings(period=PERIOD, delay=DELAY)
        self._made = Controller(robot, names, chosen, terrain)
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
        self.steering = Steering(self._made, self._noted)
        self.begin()

    @property
    def command(self) -> Command:
        """The current command; speeds are zero in a stand, except on wheels, and reduced in slow gaits."""
        part = SLOW.get(self.gait, 1.0) if len(self.robot.contacts) >= FEET else 1.0
        most = {each.name: part * each.high for each in self.sliders}
        names = self._made.rolling if self.gait == STAND else SPEEDS
        speeds = {name: min(max(self.values[name], -most[name]), most[name]) for name in names}
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
        self.steering = Steering(self._made.fresh(), self._noted)

    @override
    def recorded(self, driven: DrivenScene) -> DrivenMotion:
        return DrivenMotion.of(driven, self.steering, self.log, driven.timeline.until(driven.row))

    @override
    def height(self, time: float) -> float:
        return self.command.height


class ArmDriver(PageController[ToolSteering]):
    """An arm whose tool follows a target, which moves at a bounded speed to where the page sets it.

    Args:
        robot: with a fixed base.
        tool: frame that follows the target and keeps its orientation; default: the last frame of the model.
        settings: of the controller; default: a plan every `PERIOD` s, made in the loop.
        obstacles: in the world, avoided by the arm.

    ``steering`` has the current controller and the path of the target since the last begin.

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
        self.steering = ToolSteering(self._made, self._goal)
        steering, keys = self.steering, (("w", "s"), ("a", "d"), ("e", "q"))
        ends = zip(AXES, *np.array([steering.low, steering.place, steering.high]).tolist(), keys, strict=True)
        super().__init__(
            [
                Slider(name=axis, label=axis, unit="m", low=low, high=high, value=at, keys=pair)
                for axis, low, at, high, pair in ends
            ],
            (),
        )
        self.begin()

    @override
    def begin(self) -> None:
        self.close()
        self.steering = ToolSteering(self._made.fresh(), self._goal)

    @override
    def recorded(self, driven: DrivenScene) -> ArmDrive:
        return ArmDrive.of(driven, self.steering)

    def _goal(self, time: float) -> np.ndarray:
        return np.array([self.values[axis] for axis in AXES])

    @property
    @override
    def target(self) -> np.ndarray:
        return self.steering.place

    @property
    def tool(self) -> str:
        """Name of the frame that follows the target."""
        return self._made.tool


def _even(name: str, label: str, unit: str, most: float, keys: tuple[str, str] = ("", "")) -> Slider:
    most = _rounded(most)
    return Slider(name=name, label=label, unit=unit, low=-most, high=most, keys=keys)


def _rounded(value: float) -> float:
    """The value rounded to two significant digits."""
    digits = 1 - math.floor(math.log10(value))
    return round(value, digits)
