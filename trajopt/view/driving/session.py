"""A drive from a page: its messages, its simulation by a clock, and its record."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

from trajopt.errors import InputError, not_among, shown
from trajopt.simulation.arm_drive import RATE
from trajopt.simulation.clock import WallClock
from trajopt.simulation.driven_scene import DrivenScene
from trajopt.simulation.push import DURATION
from trajopt.simulation.settings import Impulse, SimulationSettings
from trajopt.simulation.simulated import SimulatedMotion
from trajopt.view.driving.drivers import DIRECTION, PUSH, LegsDriver, PageController

# Longest record kept for a file, s.
KEPT = 60.0
# Time without a message after which the page counts as gone, s.
SILENCE = 2.0
ACTION, RESET = "action", "reset"


class DriveSession:
    """A robot in MuJoCo that is steered by a driver.

    Args:
        driver: the robot and its controller.
        clock: of real time; default: that of the machine.
        keep: length of the record, s; at least its last half can be saved.
        lying: as of `trajopt.simulation.lockstep.drive`.
        hardware: fields of `SimulationSettings`; feet with a radius roll by default, and ``control_rate`` is
            `RATE` Hz.

    Attributes:
        driven: the simulation since the last begin.
        stand: the robot at rest at the start.
        silent: whether the page was connected and is gone.

    Raises:
        InputError: for settings that are not allowed.
    """

    def __init__(
        self,
        driver: PageController[Any],
        *,
        clock: WallClock | None = None,
        keep: float = KEPT,
        lying: bool = False,
        **hardware: Any,
    ) -> None:
        self.driver, self.clock = driver, clock or WallClock()
        settings = SimulationSettings(**{"control_rate": RATE, "rolling": True, **hardware})
        self.driven = DrivenScene(
            driver.robot, settings, keep, ground=driver.terrain, obstacles=driver.obstacles, lying=lying
        )
        self._actions: deque[str] = deque()
        self._heard: float | None = None
        self.silent = False
        self.reset()
        begun = self.driven.motion_fields(self.driven.timeline, self.driven.record.until(1))
        self.stand = SimulatedMotion(**begun).as_solution()

    def obey(self, message: Any) -> None:
        """Handle a message of the page, from any thread: values to set, and an action, "push" or "reset".

        Raises:
            InputError: for a value or action that is not allowed.
        """
        if not isinstance(message, dict):
            raise InputError(f"a command is {shown(message)}", "allowed: an object")
        wanted = dict(message)
        allowed = [RESET, *([PUSH] if isinstance(self.driver, LegsDriver) else [])]
        action = wanted.pop(ACTION, None)
        if action is not None and action not in allowed:
            raise not_among(allowed, str(action), f"action is {shown(action)}")
        self.driver.obey(wanted)
        if action is not None:
            self._actions.append(action)
        self._heard, self.silent = self.clock.now(), False

    def reset(self) -> None:
        """Put the robot back into its start, with a fresh controller."""
        self.driver.stand()
        self.driver.begin()
        self.driven.begin(self.driver.steering, self.driver.height)
        self.clock.begin()

    def ticks(self, driven: DrivenScene) -> int:
        """The ticks that the clock lets pass now, after pending actions; a `Clock` of the page."""
        count = self.clock.ticks(driven)
        while self._actions:
            self.reset() if self._actions.popleft() == RESET else self._begin_push()
        if self._heard is not None and not self.silent and self.clock.now() - self._heard > SILENCE:
            self.driver.stand()
            self.silent = True
        return count

    def _begin_push(self) -> None:
        """Begin the level push on the base that the page has set; it ends an earlier one."""
        values, run = self.driver.values, self.driven.run
        run.events.impulses = (
            Impulse(
                direction=math.radians(values[DIRECTION]),
                size=values[PUSH],
                time=self.driven.passed,
                duration=DURATION * self.driven.scene.units.time,
            ),
        )

    def as_drive(self) -> SimulatedMotion:
        """The recorded drive since the last begin; its settings do not contain pushes on legs.

        Raises:
            InputError: if nothing was simulated.
        """
        if self.driven.row < 2:
            raise InputError("nothing was simulated", "allowed: a drive of some time")
        return self.driver.recorded(self.driven)

    def close(self) -> None:
        """Stop the planning thread."""
        self.driver.close()
