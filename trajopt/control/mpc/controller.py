"""The controller of a commanded robot: torques from the measured state and the command, at each tick."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Self

import numpy as np
import pinocchio as pin
from typing_extensions import override

from trajopt.control.mpc.clock import GaitClock
from trajopt.control.mpc.commands import SPEEDS, STAND, Command
from trajopt.control.mpc.gait_reference import GaitReference, RestingFeet, half_stance
from trajopt.control.mpc.ground import GroundEstimate, KnownGround
from trajopt.control.mpc.receding import ControllerSettings, LegsController
from trajopt.control.mpc.reference import Reference
from trajopt.errors import InputError
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.legs import feet_in_base
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.schedule.gaits import Gait, gait_of
from trajopt.terrain.piecewise import PiecewiseTerrain

# Periods of gaits over sqrt(l / g); the least period and the least duration of a swing of any other gait.
PERIODS = {"walk": 3.2, "trot": 2.0, "pace": 1.6, "bound": 1.6, "pronk": 2.0, "tripod": 2.0}
PERIOD, SWING = 2.6, 1.0
# Duty factors that differ from `trajopt.schedule.gaits`: a bound without flight.
DUTIES = {"bound": 0.5}
# Largest accelerations towards a command: of speeds over g, of the turn rate over g / l.
FASTEST, FASTEST_TURN = 0.3, 0.4
# Rate of the velocity integral times sqrt(l / g); largest error that is integrated and largest integral, over
# sqrt(g l).
STEADY, SMALL, MOST = 0.3, 0.2, 0.15
# Largest angle by which the commanded heading leads that of the base, rad.
FARTHEST = 0.3


class Controller(LegsController[GaitClock]):
    """Whole-body receding-horizon control of a legged robot that follows commands.

    Args:
        robot: a robot with a free base and feet.
        gaits: names of the gaits that may be commanded; their horizons are built here.
        settings: settings of the plans and of the feedback.
        terrain: ground that the controller knows; default: it estimates the ground from touchdowns.

    Raises:
        InputError: for known terrain under soles.
    """

    def __init__(
        self,
        robot: Robot,
        gaits: tuple[str, ...] = ("trot",),
        settings: ControllerSettings | None = None,
        terrain: PiecewiseTerrain | None = None,
    ) -> None:
        chosen, unit = settings or ControllerSettings(), Units(robot).time
        self._resting = RestingFeet(robot, list(feet_in_base(robot)))
        timed = {name: _timed(robot, name, unit) for name in gaits}
        super().__init__(robot, GaitClock(self._resting.names, timed), chosen)
        self._heading: float | None = None
        self._asked = Command()
        self._velocity_integral = np.zeros(2)
        self.ground = GroundEstimate(len(self._feet), robot.length)
        if terrain is not None:
            if any(self._resting.soles):
                raise InputError(f"robot '{robot.name}' has soles", "allowed: point feet on known terrain")
            around = float(np.linalg.norm(self._resting.hips[:, :2], axis=1).max())
            self.ground = KnownGround(len(self._feet), robot.length, around, terrain)

    @override
    def fresh(self) -> Self:
        twin = super().fresh()
        twin.ground = self.ground.copy()
        return twin

    def step(
        self, time: float, q: np.ndarray, v: np.ndarray, contacts: np.ndarray, command: Command
    ) -> np.ndarray:
        """Torques (nu,) for a tick.

        Args:
            time: time of the tick, s, increasing.
            q: measured configuration (nq,).
            v: measured velocity (nv,).
            contacts: which contacts touch (nc,), in the robot's order.
            command: the command from now on.

        Raises:
            InputError: for a command that is not `possible`, a time that is not finite or decreases, and a
                state that is not finite or has the wrong shape.
        """
        command = self.possible(command)
        passed = self._passed(time, q, v, contacts)
        self.clock.request(command.gait)
        places = np.array(list(contact_positions(self.robot, q).values()))[self._feet]
        places[:, 2] -= self._resting.radius
        self.ground.touch(places, np.asarray(contacts, dtype=bool)[self._feet])
        x, y, z, w = q[3:7]
        turn = pin.Quaternion(w, x, y, z).toRotationMatrix()
        yaw = math.atan2(turn[1, 0], turn[0, 0])
        self._asked = self._rate_limited(self._asked, command, passed)
        self._integrate(passed, turn[:2] @ v[:3], yaw)
        heading = yaw if self._heading is None else self._heading
        away = math.remainder(heading + self._asked.turn_rate * passed - yaw, 2 * math.pi)
        self._heading = yaw + min(max(away, -FARTHEST), FARTHEST)
        return self._follow(passed, q, v, self._reference_maker)

    @property
    def rolling(self) -> tuple[str, ...]:
        """Speeds of a command that the robot can have on its wheels while it stands."""
        return self._resting.rolling

    def possible(self, command: Command) -> Command:
        """The command that is followed: a robot that cannot stand still steps in place instead.

        Raises:
            InputError: for a gait that was not prepared, and a speed that wheels do not permit in a stand.
        """
        if command.gait != STAND:
            if command.gait not in self.clock.gaits:
                allowed = ", ".join((STAND, *self.clock.gaits))
                raise InputError(f"gait is '{command.gait}'", f"allowed: {allowed}")
            return command
        if not self._resting.stable:
            stepping = next(iter(self.clock.gaits)) if self.clock.gait == STAND else self.clock.gait
            return Command(gait=stepping, height=command.height)
        for name in SPEEDS if self._resting.wheels else ():
            if getattr(command, name) and name not in self.rolling:
                allowed = f"allowed: {', '.join(self.rolling) or 'none'}, or a gait that steps"
                raise InputError(f"{name} of a stand on wheels is {getattr(command, name):g}", allowed)
        return command

    def _reference_maker(self) -> Callable[[GaitClock, np.ndarray], Reference]:
        """A function that makes a plan's reference from the present command and estimate of the ground."""
        command, heading, ground = self._corrected, self._heading or 0.0, self.ground.copy()
        lifts = self.robot.length * self.settings.lift, self.robot.length * self.settings.sole_lift

        def reference_at(clock: GaitClock, base: np.ndarray) -> Reference:
            return GaitReference(
                feet=self._resting,
                base=base,
                command=command,
                heading=heading,
                ground=ground,
                swings=clock.swings(),
                half_stance=half_stance(clock),
                lifts=lifts,
            )

        return reference_at

    def _integrate(self, passed: float, level: np.ndarray, yaw: float) -> None:
        """Integrate the error of the level velocity (2,), world, which model errors leave in a gait."""
        turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
        error = np.array([self._asked.speed, self._asked.lateral]) - turn @ level
        unit = self.robot.length / self.unit
        if self.clock.gait == STAND and not self.rolling:
            self._velocity_integral[:] = 0.0
        elif np.linalg.norm(error) < SMALL * unit:
            moved = self._velocity_integral + passed * STEADY / self.unit * error
            self._velocity_integral = np.clip(moved, -MOST * unit, MOST * unit)

    @property
    def _corrected(self) -> Command:
        """The rate-limited command plus the integral of the velocity error."""
        asked, (speed, lateral) = self._asked, self._velocity_integral.tolist()
        return replace(asked, speed=asked.speed + speed, lateral=asked.lateral + lateral)

    def _rate_limited(self, now: Command, command: Command, passed: float) -> Command:
        """The present command ``passed`` s later: it approaches ``command`` at bounded rates."""
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


def _timed(robot: Robot, name: str, unit: float) -> tuple[Gait, float]:
    """A gait of a robot, with its duty factor from `DUTIES`, and its period, s; ``unit`` is sqrt(l / g)."""
    gait = gait_of(robot, name)
    gait = gait.with_duty(DUTIES[name]) if name in DUTIES else gait
    return gait, PERIODS.get(name, max(PERIOD, SWING / (1 - gait.duty_of(gait.feet[0])))) * unit
