"""A drive in lockstep: a controller follows commands in MuJoCo, whose time waits for the solver.

A plan takes effect after the controller's delay, however long the solver took. Repeated drives are therefore
identical, except for the computation times in their reports.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from trajopt.arguments import Positive, checked
from trajopt.control.inverse_dynamics import RELAXED
from trajopt.control.reference import ReferenceTrajectory, stance_reference
from trajopt.errors import InputError, not_among
from trajopt.motion.samples import contact_places
from trajopt.mpc.commands import STAND, CommandScript
from trajopt.mpc.controller import Controller
from trajopt.mpc.drive_report import DriveReport, command_errors, plan_figures
from trajopt.mpc.receding import ControllerSettings
from trajopt.robot.mujoco_package import muted_mujoco
from trajopt.robot.robot import Robot
from trajopt.schedule.gaits import gait_names
from trajopt.simulation.figures import Fall, base_poses, fall_between
from trajopt.simulation.record import SimulationRecord
from trajopt.simulation.run import SimulationRun
from trajopt.simulation.settings import Impulse, SimulationSettings
from trajopt.simulation.simulate import require_fitting, require_within
from trajopt.simulation.simulated import simulated_solution
from trajopt.simulation.world import World, build_world
from trajopt.solution.solution import Solution
from trajopt.solving.rest import rest
from trajopt.solving.solving import solve
from trajopt.terrain.piecewise import PiecewiseTerrain

# Time that a drive lasts after its last command, s.
LAST = 2.0
# Interval between tests for a fall, s.
STRETCH = 0.1
# Largest height of the ground under the feet at the start, m: rounding.
LEVEL = 1e-9
# Settings of the simulation that a drive accepts.
HARDWARE = (
    *("timestep", "control_rate", "friction_scale", "mass_scale", "com_offset", "ground_offsets", "rolling"),
    *("noise", "sensor_noise", "seed", "delay", "torque_step", "torque_rate"),
)


@dataclass(frozen=True, kw_only=True)
class DrivenMotion:
    """A drive: report, commands, and everything that was recorded.

    ``stand`` is the robot at rest at the start; ``reference`` has the base upright at its place of each tick.
    """

    robot: Robot
    script: CommandScript
    controller: Controller
    settings: SimulationSettings
    stand: Solution
    reference: ReferenceTrajectory
    world: World
    record: SimulationRecord
    report: DriveReport

    def as_solution(self) -> Solution:
        """The motion as a solution of the same model; ``statistics.simulated`` is true."""
        return self._solution

    @cached_property
    def _solution(self) -> Solution:
        return simulated_solution(self.stand, self.reference, self.record, self.world, self.report)

    @property
    def commanded(self) -> np.ndarray:
        """Commands (n, 3) at ticks: forward speed, speed to the left, m/s, and turn rate, rad/s."""
        given = [self.script.at(t) for t in self.reference.t[: len(self.record.feet)].tolist()]
        return np.array([[each.speed, each.lateral, each.turn_rate] for each in given])

    @cached_property
    def velocity(self) -> np.ndarray:
        """Measured velocity of the base (n, 3), with the columns of `commanded`, along its heading."""
        return base_velocity(self.world, self.stand, self.record)


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
        hardware: fields of `SimulationSettings` among `HARDWARE`; feet with a radius roll by default.

    Raises:
        InputError: for a robot without a free base or feet, a gait that it does not have, and settings that
            are not allowed.
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
    stand = stand_of(robot, ground)
    require_fitting(wanted, stand)
    reference = stance_reference(stand, wanted.control_rate, duration or script.times[-1] + LAST)
    reference = replace(reference, phase_names=("drive",))
    require_within(wanted, reference)
    used = dict.fromkeys(command.gait for command in script.commands if command.gait != STAND)
    names = tuple(gaits or used or gait_names(robot)[:1])
    if controller is not None:
        if gaits is not None or settings is not None:
            raise InputError("controller of drive has gaits and settings", "allowed: no others")
        own = controller.robot
        if own.model.names.tolist() != robot.model.names.tolist() or own.contacts != robot.contacts:
            raise InputError(
                "controller of drive is of a robot with other joints or contacts", "allowed: the same"
            )
        names = tuple(controller.clock.gaits)
    for name in used:
        if name not in names:
            raise not_among(names, name, f"gait '{name}' of the script is not among those of the drive")
    steering = Steering(controller or Controller(robot, names, settings), script)
    wanted = replace(wanted, controller=steering)
    with muted_mujoco():
        world = build_world(stand, wanted, math.inf)
        record, fall = _driven(SimulationRun(stand, reference, world, wanted), script)
    return DrivenMotion(
        robot=robot,
        script=script,
        controller=steering.controller,
        settings=wanted,
        stand=stand,
        reference=reference,
        world=world,
        record=record,
        report=report_of(steering, reference, record, fall, base_velocity(world, stand, record)),
    )


class Steering:
    """A controller that follows a script, with the interface of a simulation's controller.

    ``slack`` is the largest violation of relaxed rows in any tick, natural units.
    """

    def __init__(self, controller: Controller, script: CommandScript) -> None:
        self.controller, self.script, self.slack = controller, script, 0.0

    def torque(self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray) -> np.ndarray:
        """Torques (nu,) at ``t`` s, see `Controller.step`."""
        torque = self.controller.step(t, q, v, touching, self.script.at(t))
        if self.controller.follower.last is not None:
            self.slack = max(self.slack, self.controller.follower.last.slack)
        return torque


def stand_of(robot: Robot, ground: PiecewiseTerrain | None) -> Solution:
    """The robot at rest in its reference posture on the given ground. Raises `InputError`."""
    stand = solve(rest(robot))
    about = replace(stand.description, problem="drive")
    if ground is not None:
        x, y, _ = contact_places(stand).position[0].T
        if np.abs(ground.height(x, y)).max() > LEVEL:
            raise InputError(
                "ground of drive is not at the height 0 where the robot stands", "allowed: it is"
            )
        about = replace(about, terrain=ground, surfaces=(), patches=())
    return replace(stand, description=about)


def _driven(run: SimulationRun, script: CommandScript) -> tuple[SimulationRecord, Fall | None]:
    """The record up to a fall, if any; sets the reference to the base upright at its place of each tick."""
    record, count = run.start(), len(run.reference.t)
    stretch = max(1, round(STRETCH / run.reference.period))
    for first in range(0, count, stretch):
        last = min(first + stretch, count)
        reached = run.advance(record, first, last)
        rows = slice(first, reached)
        heights = [script.at(t).height for t in run.reference.t[rows].tolist()]
        q = run.world.coordinates.from_mujoco(record.qpos[rows])
        run.reference.q[rows] = upright(run.plan, q, heights)
        fall = fall_between(run.plan, run.reference, record, run.world, rows)
        if fall is None and reached < last:
            fall = Fall(time=float(run.reference.t[reached]), why="the simulation diverged")
        if fall is not None:
            return run.ended(record, reached), fall
    return run.ended(record, count), None


def upright(stand: Solution, q: np.ndarray, heights: Sequence[float]) -> np.ndarray:
    """The start's posture (n, nq) with place and heading of q (n, nq), raised by heights (n,) in m."""
    result, ground = np.repeat(stand.q[:1], len(q), axis=0), stand.description.ground
    result[:, :2] = q[:, :2]
    result[:, 2] += heights
    if isinstance(ground, PiecewiseTerrain):
        below = ground.height(q[:, 0], q[:, 1])
        result[:, 2] += np.where(np.isfinite(below), below, 0.0)
    x, y, z, w = q[:, 3:7].T
    half = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) / 2
    result[:, 3:7] = np.column_stack([np.zeros((len(q), 2)), np.sin(half), np.cos(half)])
    return result


def base_velocity(world: World, stand: Solution, record: SimulationRecord) -> np.ndarray:
    """Velocity of the base at ticks (n, 3): forward, to the left, m/s, and turn rate, rad/s."""
    qpos, qvel = (rows[: len(record.feet)] for rows in (record.qpos, record.qvel))
    v = world.coordinates.rates_from_mujoco(qpos, qvel)
    turns = base_poses(stand.model, world.coordinates.from_mujoco(qpos))[:, :, :3]
    linear, spin = (np.einsum("nij,nj->ni", turns, part) for part in (v[:, :3], v[:, 3:6]))
    ahead = turns[:, :2, 0] / np.linalg.norm(turns[:, :2, 0], axis=1, keepdims=True)
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    along = [np.sum(direction * linear[:, :2], axis=1) for direction in (ahead, left)]
    return np.column_stack([*along, spin[:, 2]])


def report_of(
    steering: Steering,
    reference: ReferenceTrajectory,
    record: SimulationRecord,
    fall: Fall | None,
    velocity: np.ndarray,
) -> DriveReport:
    """Figures of a drive.

    Args:
        steering: the controller and its counts.
        reference: reference at the ticks of the requested duration.
        record: record of the simulated ticks.
        fall: the fall, if the robot fell.
        velocity: velocity of the base at ticks (n, 3), see `base_velocity`.
    """
    controller, script = steering.controller, steering.script
    periods = {name: period for name, (_, period) in controller.clock.gaits.items()}
    means, values = command_errors(script, velocity, reference.period, periods)
    steps = record.qpos[:: max(1, round(min(periods.values()) / reference.period)), :2]
    return DriveReport(
        **plan_figures(controller, record, reference.period, fall),
        duration=len(reference.t) * reference.period,
        distance=float(np.linalg.norm(np.diff(steps, axis=0), axis=1).sum()),
        mean_errors=means,
        errors=values,
        relaxed={
            name: count for name, count in zip(RELAXED, controller.follower.relaxed, strict=True) if count
        },
        slack=steering.slack,
        gaits=periods,
        script=script,
    )
