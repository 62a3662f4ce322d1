"""A drive in lockstep: a controller follows commands in MuJoCo, whose time waits for the solver.

A plan takes effect after the controller's delay, however long the solver took. Repeated drives are therefore
identical, except for the computation times in their reports.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from trajopt.arguments import Positive, checked
from trajopt.control.mpc.commands import STAND, Command, CommandScript
from trajopt.control.mpc.controller import Controller
from trajopt.control.mpc.receding import ControllerSettings
from trajopt.control.reference import ContactTimeline
from trajopt.errors import InputError, not_among
from trajopt.robot.robot import Robot
from trajopt.schedule.gaits import gait_names
from trajopt.simulation.clock import lockstep
from trajopt.simulation.drive_report import CommandLog, DriveReport, command_errors, plan_figures, since
from trajopt.simulation.driven_scene import DrivenScene
from trajopt.simulation.record import SimulationRecord
from trajopt.simulation.scene import Scene
from trajopt.simulation.settings import Impulse, SimulationSettings
from trajopt.simulation.simulated import SimulatedMotion
from trajopt.simulation.site import base_poses
from trajopt.terrain.piecewise import PiecewiseTerrain

# Time that a drive lasts after its last command, s.
LAST = 2.0
# Settings of the simulation that a drive accepts.
HARDWARE = (
    *("timestep", "control_rate", "friction_scale", "mass_scale", "com_offset", "ground_offsets", "rolling"),
    *("noise", "sensor_noise", "seed", "delay", "torque_step", "torque_rate"),
)


@dataclass(frozen=True, kw_only=True)
class DrivenMotion(SimulatedMotion):
    """A drive of a robot on legs.

    Args:
        script: the commands.
        controller: the controller after the drive.
    """

    script: CommandScript
    controller: Controller
    report: DriveReport

    @classmethod
    def of(
        cls, driven: DrivenScene, steering: Steering, log: CommandLog, timeline: ContactTimeline
    ) -> DrivenMotion:
        """The record of a simulation, in which ``steering`` followed commands; ``timeline`` has its ticks."""
        log = [(0.0, Command()), *((driven.rises + time, command) for time, command in log)]
        script = CommandScript(*zip(*since(log, driven.offset), strict=True))
        record, controller, period = driven.recorded(), steering.controller, timeline.period
        periods = {name: whole for name, (_, whole) in controller.clock.gaits.items()}
        velocity = base_velocity(driven.scene, record)
        rolling = {STAND: min(periods.values())} if controller.rolling else {}
        means, values = command_errors(script, velocity, period, periods | rolling)
        steps = record.qpos[:: max(1, round(min(periods.values()) / period)), :2]
        report = DriveReport(
            **plan_figures(controller, record, period, driven.fall),
            duration=len(timeline.t) * period,
            distance=float(np.linalg.norm(np.diff(steps, axis=0), axis=1).sum()),
            mean_errors=means,
            errors=values,
            gaits=periods,
            script=script,
        )
        seen = driven.motion_fields(timeline, record)
        return cls(**seen, script=script, controller=controller, report=report)

    @property
    def commanded(self) -> np.ndarray:
        """Commands (n, 3) at ticks: forward speed, speed to the left, m/s, and turn rate, rad/s."""
        given = [self.script.at(t) for t in self.timeline.t[: len(self.record.feet)].tolist()]
        return np.array([[each.speed, each.lateral, each.turn_rate] for each in given])

    @cached_property
    def velocity(self) -> np.ndarray:
        """Measured velocity of the base (n, 3), with the columns of `commanded`, along its heading."""
        return base_velocity(self.scene, self.record)


@checked
def drive(
    robot: Robot,
    script: CommandScript,
    *,
    duration: Positive | None = None,
    gaits: Sequence[str] | None = None,
    settings: ControllerSettings | None = None,
    controller: Controller | None = None,
    pushes: Sequence[Impulse] = (),
    ground: PiecewiseTerrain | None = None,
    terrain: PiecewiseTerrain | None = None,
    lying: bool = False,
    **hardware: Any,
) -> DrivenMotion:
    """Drive a robot by a script in MuJoCo; the drive ends early if the robot falls.

    Args:
        robot: a robot with a free base and feet.
        script: commands over time.
        duration: duration of the drive, s; default: until `LAST` s after the last command.
        gaits: names of the gaits that the controller prepares; default: those of the script.
        settings: settings of the controller.
        controller: a new controller with its own gaits and settings, for this robot or one with other
            masses; default: one is made.
        pushes: level impulses on the base.
        ground: ground that feet and links touch and the controller does not know, with level faces at height
            0 where the robot stands; default: level ground.
        terrain: such ground that the controller knows, in place of ``ground``.
        lying: a quadruped stands up from its belly, before the time of duration and script begins.
        hardware: fields of `SimulationSettings` among `HARDWARE`; feet with a radius roll by default.

    Raises:
        InputError: for a robot without a free base or feet, a gait that it does not have, a command that is
            not `Controller.possible`, and settings that are not allowed.
    """
    unknown = [name for name in hardware if name not in HARDWARE]
    if unknown:
        raise not_among(HARDWARE, unknown[0], f"a drive has no setting '{unknown[0]}'")
    if robot.base != "freeflyer":
        raise InputError(f"robot '{robot.name}' has a {robot.base} base", "allowed: a free base, on feet")
    chosen = settings if controller is None else controller.settings
    if chosen is not None and chosen.live:
        raise InputError("settings of drive are live", "allowed: live=False, simulated time waits for plans")
    wanted = SimulationSettings(impulse=pushes, **{"rolling": True, **hardware})
    if ground is not None and terrain is not None:
        raise InputError("drive has a ground and a terrain", "allowed: one of them")
    below = ground if terrain is None else terrain
    driven = DrivenScene(robot, wanted, duration or script.times[-1] + LAST, ground=below, lying=lying)
    used = dict.fromkeys(command.gait for command in script.commands if command.gait != STAND)
    names = tuple(gaits or used or gait_names(robot)[:1])
    if controller is not None:
        if gaits is not None or settings is not None or terrain is not None:
            raise InputError("controller of drive has gaits and settings, or terrain", "allowed: no others")
        own = controller.robot
        if own.model.names.tolist() != robot.model.names.tolist() or own.contacts != robot.contacts:
            raise InputError(
                "controller of drive is of a robot with other joints or contacts", "allowed: the same"
            )
        names = tuple(controller.clock.gaits)
    for name in used:
        if name not in names:
            raise not_among(names, name, f"gait '{name}' of the script is not among those of the drive")
    steering = Steering(controller or Controller(robot, names, settings, terrain), script.at)
    for command in script.commands:
        steering.controller.possible(command)
    driven.begin(steering, lambda t: script.at(t).height)
    driven.simulate(lockstep)
    log = list(zip(script.times, script.commands, strict=True))
    return DrivenMotion.of(driven, steering, log, driven.timeline)


class Steering:
    """A controller that follows commands, with the interface of a simulation's controller.

    Args:
        controller: the controller.
        command: the command at a time in s.
    """

    def __init__(self, controller: Controller, command: Callable[[float], Command]) -> None:
        self.controller, self.command = controller, command

    def torque(self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray) -> np.ndarray:
        """Torques (nu,) at ``t`` s, see `Controller.step`."""
        return self.controller.step(t, q, v, touching, self.command(t))


def base_velocity(scene: Scene, record: SimulationRecord) -> np.ndarray:
    """Velocity of the base at ticks (n, 3): forward, to the left, m/s, and turn rate, rad/s."""
    qpos, qvel = (rows[: len(record.feet)] for rows in (record.qpos, record.qvel))
    v = scene.coordinates.rates_from_mujoco(qpos, qvel)
    turns = base_poses(scene.robot.model, scene.coordinates.from_mujoco(qpos))[:, :, :3]
    linear, spin = (np.einsum("nij,nj->ni", turns, part) for part in (v[:, :3], v[:, 3:6]))
    ahead = turns[:, :2, 0] / np.linalg.norm(turns[:, :2, 0], axis=1, keepdims=True)
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    along = [np.sum(direction * linear[:, :2], axis=1) for direction in (ahead, left)]
    return np.column_stack([*along, spin[:, 2]])
