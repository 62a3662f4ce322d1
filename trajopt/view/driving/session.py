"""A drive in real time: short stretches of physics paced by the wall clock.

Delays beyond `CATCH` are not caught up: simulated time falls behind, and the page shows by how much.
"""

from __future__ import annotations

import math
import time
from collections import deque
from typing import Any, Protocol

from trajopt.control.mpc.commands import CommandScript
from trajopt.errors import InputError, not_among, shown
from trajopt.simulation.arm_drive import RATE, ArmDrive, since
from trajopt.simulation.driven_scene import DrivenScene
from trajopt.simulation.lockstep import DrivenMotion
from trajopt.simulation.push import DURATION
from trajopt.simulation.settings import Impulse, SimulationSettings
from trajopt.simulation.simulated import simulated_solution
from trajopt.view.driving.drivers import DIRECTION, PUSH, ArmDriver, LegsDriver, PageController

# Physics per turn of the loop, s.
STRETCH = 0.02
# Longest record kept for a file, s.
KEPT = 60.0
# Largest delay that is caught up, s; time without a message after which the page counts as gone, s.
CATCH, SILENCE = 0.1, 2.0
# Window over which the pace is measured, s.
WINDOW = 1.0
ACTION, RESET = "action", "reset"


class Clock(Protocol):
    """The clock by which a session measures time and waits."""

    def now(self) -> float:
        """Time since an arbitrary origin, s."""
        ...

    def sleep(self, seconds: float) -> None:
        """Wait."""
        ...


class WallClock:
    """The machine's clock."""

    def now(self) -> float:
        """Time, s."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Wait."""
        time.sleep(seconds)


class DriveSession:
    """A robot in MuJoCo that is steered by a driver and simulated turn by turn.

    Args:
        driver: the robot and its controller.
        clock: default: that of the machine.
        keep: length of the record, s; at least its last half can be saved.
        hardware: fields of `SimulationSettings`; feet with a radius roll by default, and ``control_rate`` is
            `RATE` Hz.

    Attributes:
        driven: the simulation since the last begin.
        stand: the robot at rest at the start.
        behind: time by which simulated time has fallen behind, s.
        silent: whether the page was connected and is gone.

    Raises:
        InputError: for settings that are not allowed.
    """

    def __init__(
        self,
        driver: PageController[Any],
        *,
        clock: Clock | None = None,
        keep: float = KEPT,
        **hardware: Any,
    ) -> None:
        self.driver, self.clock = driver, clock or WallClock()
        settings = SimulationSettings(**{"control_rate": RATE, "rolling": True, **hardware})
        self.driven = DrivenScene(driver.robot, settings, keep, obstacles=driver.obstacles)
        self._actions: deque[str] = deque()
        self._heard: float | None = None
        self.silent, self.behind = False, 0.0
        self.reset()
        self.stand = simulated_solution(
            self.driven.scene, self.driven.timeline, self.driven.record.until(1), None
        )

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
        """Put the robot back into its stand, with a fresh controller."""
        self.driver.stand()
        self.driver.begin()
        self.driven.begin(self.driver.steering, self.driver.height)
        self._marks: deque[tuple[float, float]] = deque([(self.clock.now(), 0.0)])
        self._origin = self.clock.now()

    def turn(self) -> None:
        """Carry out pending actions and simulate a stretch; a fallen robot stays as it is."""
        while self._actions:
            self.reset() if self._actions.popleft() == RESET else self._begin_push()
        if self._heard is not None and not self.silent and self.clock.now() - self._heard > SILENCE:
            self.driver.stand()
            self.silent = True
        if self.driven.fall is None:
            self.driven.advance(max(1, round(STRETCH / self.driven.timeline.period)))

    def wait(self) -> None:
        """Sleep until the wall clock reaches simulated time; a delay beyond `CATCH` s is given up."""
        now = self.clock.now()
        if self.driven.fall is not None:
            self._origin = now - self.driven.passed
            self.clock.sleep(STRETCH)
            return
        ahead = self._origin + self.driven.passed - now
        if ahead > 0:
            self.clock.sleep(ahead)
        elif -ahead > CATCH:
            self._origin, self.behind = self._origin - ahead - CATCH, self.behind - ahead - CATCH
        self._marks.append((self.clock.now(), self.driven.passed))
        while len(self._marks) > 2 and self._marks[-1][0] - self._marks[0][0] > WINDOW:
            self._marks.popleft()

    @property
    def pace(self) -> float:
        """Ratio of simulated to real time over the last `WINDOW` s."""
        (begin, before), (end, after) = self._marks[0], self._marks[-1]
        return (after - before) / (end - begin) if end > begin else 1.0

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

    def as_drive(self) -> DrivenMotion | ArmDrive:
        """The recorded drive since the last begin; its settings do not contain pushes on legs.

        Raises:
            InputError: if nothing was simulated.
        """
        driver, driven = self.driver, self.driven
        if driven.row < 2:
            raise InputError("nothing was simulated", "allowed: a drive of some time")
        if isinstance(driver, ArmDriver):
            return ArmDrive.of(driven, driver.steering)
        assert isinstance(driver, LegsDriver)
        script = CommandScript(*zip(*since(driver.log, driven.offset), strict=True))
        return DrivenMotion.of(driven, driver.steering, script, driven.timeline.until(driven.row))

    def close(self) -> None:
        """Stop the planning thread."""
        self.driver.close()
