"""A drive in real time: short stretches of physics paced by the wall clock.

Delays beyond `CATCH` are not caught up: simulated time falls behind, and the page shows by how much.
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

# Physics per turn of the loop, s; control rate, Hz; longest record kept for a file, s.
STRETCH, RATE, KEPT = 0.02, 500.0, 60.0
# Largest delay that is caught up, s; time without a message after which the page counts as gone, s.
CATCH, SILENCE = 0.1, 2.0
# Window over which the pace is measured, s.
WINDOW = 1.0
ACTION, RESET = "action", "reset"
# Fields of a reference with a row per tick.
ROWS = ("t", "q", "v", "a", "torque", "f", "active", "phase", "source")


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
        passed: simulated time since the last begin, s.
        fall: how the drive ended, if the robot fell.
        behind: time by which simulated time has fallen behind, s.
        silent: whether the page was connected and is gone.

    Raises:
        InputError: for settings that are not allowed.
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
        """Simulated time since the last begin, s."""
        return self.driver.offset + self.row * self.reference.period

    def turn(self) -> None:
        """Carry out pending actions and simulate a stretch; a fallen robot stays as it is."""
        while self._actions:
            self.reset() if self._actions.popleft() == RESET else self._begin_push()
        if self._heard is not None and not self.silent and self.clock.now() - self._heard > SILENCE:
            self.driver.stand()
            self.silent = True
        if self.fall is None:
            self.advance(max(1, round(STRETCH / self.reference.period)))

    def wait(self) -> None:
        """Sleep until the wall clock reaches simulated time; a delay beyond `CATCH` s is given up."""
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
        """Ratio of simulated to real time over the last `WINDOW` s."""
        (begin, before), (end, after) = self._marks[0], self._marks[-1]
        return (after - before) / (end - begin) if end > begin else 1.0

    def _begin_push(self) -> None:
        """Begin a level push on the base with the size and direction set by the page."""
        period, values = self.reference.period, self.driver.values
        self._pushed = max(1, round(DURATION * self.units.time / period))
        level = self.run.forward()
        along, angle = level / max(float(np.linalg.norm(level)), 1e-9), math.radians(values[DIRECTION])
        turned = math.cos(angle) * along + math.sin(angle) * np.cross(self.run.up, along)
        self._force = values[PUSH] / (self._pushed * period) * turned

    def advance(self, count: int) -> None:
        """Simulate ``count`` periods, or up to a fall."""
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
        """Simulate up to row ``last``; divergence and errors of the controller count as falls."""
        why = "the simulation diverged"
        try:
            reached = self.run.advance(self.record, self.row, last)
        except TrajoptError as error:
            reached, why = self.row, str(error)
        self.row = reached
        if reached < last:
            self.fall = Fall(time=self.passed, why=why)

    def _judge(self, driver: LegsDriver, rows: slice) -> None:
        """Record a fall if the robot has fallen in these rows."""
        q = self.world.coordinates.from_mujoco(self.record.qpos[rows])
        heights = [driver.command.height] * len(q)
        self.reference.q[rows] = lockstep.upright(self.stand, q, heights)
        found = fall_between(self.stand, self.reference, self.record, self.world, rows)
        self.fall = self.fall or found

    def _forget(self) -> None:
        """Drop the oldest part of the record: half of its capacity."""
        half = len(self.reference.t) // 2
        kept = [part for part in vars(self.record).values() if isinstance(part, np.ndarray)]
        for part in (*kept, self.reference.q):
            part[: self.row - half] = part[half : self.row].copy()
        self.row -= half
        self.driver.offset += half * self.reference.period

    def as_drive(self) -> lockstep.DrivenMotion | ArmDrive:
        """The recorded drive since the last begin; its settings do not contain pushes on legs.

        Raises:
            InputError: if nothing was simulated.
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
        """Stop the planning thread."""
        self.driver.close()
