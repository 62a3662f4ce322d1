"""A drive in real time: stretches of physics that wait for the wall clock, and what a page is told of them.

What is slower than the wall clock does not catch up: simulated time falls behind, and the page says by how
much.
"""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from trajopt.control.reference import stance_reference
from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.errors import InputError, TrajoptError, not_among, shown
from trajopt.mpc import lockstep
from trajopt.mpc.commands import CommandScript
from trajopt.robot.mujoco_package import muted_mujoco
from trajopt.simulation.bodies import body_name
from trajopt.simulation.figures import Fall, fall_between
from trajopt.simulation.push import DURATION
from trajopt.simulation.run import SimulationRun
from trajopt.simulation.settings import SimulationSettings
from trajopt.simulation.simulate import require_fitting, require_within
from trajopt.simulation.world import build_world
from trajopt.view.driving.arm_drive import ArmDrive, arm_drive
from trajopt.view.driving.drivers import DIRECTION, PUSH, ArmDriver, LegsDriver, PageController, since

# s of physics in a turn of the loop; rate of the controller, Hz; s that are kept for a file, at most.
STRETCH, RATE, KEPT = 0.02, 500.0, 60.0
# s behind the wall clock that are still caught up with, and s without a message after which a page is gone.
CATCH, SILENCE = 0.1, 2.0
# The pace is measured over so many s.
WINDOW = 1.0
ACTION, RESET = "action", "reset"
# Rows of a reference.
ROWS = ("t", "q", "v", "a", "torque", "f", "active", "phase", "source")


class Clock(Protocol):
    """What a session measures and waits by."""

    def now(self) -> float:
        """Time, s, from any origin."""
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
    """A robot in MuJoCo that a driver steers, turn by turn.

    Args:
        driver: what is steered, and its controller.
        clock: by which it waits; default the machine's.
        keep: s, of which the last half at least can be saved.
        hardware: fields of `SimulationSettings`; feet with a radius roll by default, and ``control_rate`` is
            `RATE` Hz.

    Raises:
        InputError: for settings that are not allowed.

    passed: simulated s since the last begin. fall: how it ended, if it did. behind: s that simulated time is
    late. silent: whether a page was there and is gone.
    """

    def __init__(
        self,
        driver: PageController,
        *,
        clock: Clock | None = None,
        keep: float = KEPT,
        **hardware: Any,
    ) -> None:
        self.driver, self.clock = driver, clock or WallClock()
        self.stand = lockstep.stand_of(driver.robot, None).with_description(obstacles=driver.obstacles)
        self.settings = SimulationSettings(
            controller=driver, **{"control_rate": RATE, "rolling": True, **hardware}
        )
        require_fitting(self.settings, self.stand)
        reference = stance_reference(self.stand, self.settings.control_rate, keep)
        self._still = replace(reference, phase_names=("drive",))
        require_within(self.settings, self._still)
        with muted_mujoco():
            self.world = build_world(self.stand, self.settings, math.inf)
        base = body_name(BASE_JOINT[base_of(self.stand.model)])
        self._base = self.world.compiled.body(base).id
        self._actions: deque[str] = deque()
        self._heard: float | None = None
        self.silent, self.behind = False, 0.0
        self.units = self.world.units
        self.reset()

    def obey(self, message: Any) -> None:
        """Take a message of the page, from any thread: values to set, and an action, "push" or "reset".

        Raises:
            InputError: for what is not allowed.
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
        """Put the robot back into its stand, with a controller as new."""
        self.driver.stand()
        self.driver.begin()
        self.reference = replace(self._still, q=self._still.q.copy())
        with muted_mujoco():
            self.run = SimulationRun(self.stand, self.reference, self.world, self.settings)
            self.record = self.run.start()
        self.row = 0
        self.fall: Fall | None = None
        self._pushed, self._force = 0, np.zeros(3)
        self._marks: deque[tuple[float, float]] = deque([(self.clock.now(), 0.0)])
        self._origin = self.clock.now()

    @property
    def passed(self) -> float:
        """Simulated s since the last begin."""
        return self.driver.offset + self.row * self.reference.period

    def turn(self) -> None:
        """Obey what came in, and simulate a stretch; a robot that has fallen stays as it is."""
        while self._actions:
            self.reset() if self._actions.popleft() == RESET else self._begin_push()
        if self._heard is not None and not self.silent and self.clock.now() - self._heard > SILENCE:
            self.driver.stand()
            self.silent = True
        if self.fall is None:
            self.advance(max(1, round(STRETCH / self.reference.period)))

    def wait(self) -> None:
        """Sleep until the wall clock is where simulated time is; what is too late falls behind."""
        now = self.clock.now()
        if self.fall is not None:
            self._origin = now - self.passed
            self.clock.sleep(STRETCH)
            return
        ahead = self._origin + self.passed - now
        if ahead > 0:
            self.clock.sleep(ahead)
        elif -ahead > CATCH:
            self._origin, self.behind = self._origin - ahead - CATCH, self.behind - ahead - CATCH
        self._marks.append((self.clock.now(), self.passed))
        while len(self._marks) > 2 and self._marks[-1][0] - self._marks[0][0] > WINDOW:
            self._marks.popleft()

    @property
    def pace(self) -> float:
        """Simulated over real time, lately."""
        (begin, before), (end, after) = self._marks[0], self._marks[-1]
        return (after - before) / (end - begin) if end > begin else 1.0

    def _begin_push(self) -> None:
        """Begin a level push on the base, as the page's size and direction say."""
        period, values = self.reference.period, self.driver.values
        self._pushed = max(1, round(DURATION * self.units.time / period))
        level = self.run.forward()
        along, angle = level / max(float(np.linalg.norm(level)), 1e-9), math.radians(values[DIRECTION])
        turned = math.cos(angle) * along + math.sin(angle) * np.cross(self.run.up, along)
        self._force = values[PUSH] / (self._pushed * period) * turned

    def advance(self, count: int) -> None:
        """Simulate so many periods, at most to a fall."""
        if self.row + count > len(self.reference.t):
            self._forget()
        first, end = self.row, self.row + count
        xfrc = self.run.data.xfrc_applied
        with muted_mujoco():
            while self.row < end and self.fall is None:
                pushed = min(self._pushed, end - self.row)
                xfrc[self._base, :3] = self._force if pushed else 0.0
                last = self.row + pushed if pushed else end
                self._pushed -= pushed
                self._simulate(last)
        if isinstance(self.driver, LegsDriver) and self.row > first:
            self._judge(self.driver, slice(first, self.row))

    def _simulate(self, last: int) -> None:
        """Simulate up to a row; what diverges, or cannot be controlled, is a fall."""
        why = "the simulation diverged"
        try:
            reached = self.run.advance(self.record, self.row, last)
        except TrajoptError as error:
            reached, why = self.row, str(error)
        self.row = reached
        if reached < last:
            self.fall = Fall(time=self.passed, why=why)

    def _judge(self, driver: LegsDriver, rows: slice) -> None:
        """Whether the robot has fallen in these rows."""
        q = self.world.coordinates.from_mujoco(self.record.qpos[rows])
        heights = [driver.command.height] * len(q)
        self.reference.q[rows] = lockstep.upright(self.stand, q, heights)
        found = fall_between(self.stand, self.reference, self.record, self.world, rows)
        self.fall = self.fall or found

    def _forget(self) -> None:
        """Leave out the first half of what is kept."""
        half = len(self.reference.t) // 2
        kept = [part for part in vars(self.record).values() if isinstance(part, np.ndarray)]
        for part in (*kept, self.reference.q):
            part[: self.row - half] = part[half : self.row].copy()
        self.row -= half
        self.driver.offset += half * self.reference.period

    def as_drive(self) -> lockstep.DrivenMotion | ArmDrive:
        """What was kept since the last begin, as a drive; pushes on legs are not in its settings.

        Raises:
            InputError: where nothing was simulated.
        """
        if self.row < 2:
            raise InputError("nothing was simulated", "allowed: a drive of some time")
        rows = {name: getattr(self.reference, name)[: self.row] for name in ROWS}
        reference = replace(self.reference, **rows)
        if self.fall is None and self.row < len(self.reference.t):
            record = self.record.until(self.row + 1)
            record.qpos[self.row], record.qvel[self.row] = self.run.data.qpos, self.run.data.qvel
        else:
            record = self.run.ended(self.record, self.row)
        driver = self.driver
        if isinstance(driver, ArmDriver):
            return arm_drive(driver, self.stand, reference, self.world, record, self.fall)
        assert isinstance(driver, LegsDriver)
        script = CommandScript(*zip(*since(driver.log, driver.offset), strict=True))
        steering = lockstep.Steering(driver.controller, script)
        steering.slack = driver.slack
        velocity = lockstep.base_velocity(self.world, self.stand, record)
        return lockstep.DrivenMotion(
            robot=driver.robot,
            script=script,
            controller=driver.controller,
            settings=self.settings,
            stand=self.stand,
            reference=reference,
            world=self.world,
            record=record,
            report=lockstep.report_of(steering, reference, record, self.fall, velocity),
        )

    def close(self) -> None:
        """End the thread of plans."""
        self.driver.close()
