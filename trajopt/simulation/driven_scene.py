"""A robot that is driven in MuJoCo, stretch by stretch: its scene, its record, and whether it has fallen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.collision.shapes import Obstacle
from trajopt.control.reference import ContactTimeline
from trajopt.dynamics.model_quantities import contact_jacobian
from trajopt.errors import InputError, TrajoptError
from trajopt.inspection.standing import standing_feet
from trajopt.problem.problem import rest
from trajopt.robot.actuators.joint_force import joint_force
from trajopt.robot.contact import Contact
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.mujoco_package import muted_mujoco
from trajopt.robot.robot import Robot
from trajopt.simulation.figures import Fall, FallTest
from trajopt.simulation.record import SimulationRecord
from trajopt.simulation.rise import RISE_TIME, Rise
from trajopt.simulation.run import SimulationRun, Start
from trajopt.simulation.scene import Scene, build_scene
from trajopt.simulation.settings import SimulationSettings, TorqueController
from trajopt.simulation.simulate import require_fitting, require_within
from trajopt.simulation.site import SceneRobot, Site
from trajopt.solving.extraction import described
from trajopt.terrain.piecewise import PiecewiseTerrain

# Largest height of the ground under the feet at the start, m: rounding.
LEVEL = 1e-9
# Number of ticks that may pass now; 0 ends the drive.
Clock = Callable[["DrivenScene"], int]


class DrivenScene:
    """A robot on the ground, and its simulation under a controller.

    Args:
        robot: the robot.
        settings: settings of the simulation.
        duration: length of the record without the rise, s.
        ground: ground that the robot touches, at height 0 where it stands; default: level ground.
        obstacles: obstacles in the world.
        lying: begin with a `Rise`, which comes before the controller, not in the reference posture.

    Attributes:
        rises: time of the rise, s.
        scene: the scene in MuJoCo.
        timeline: the ticks of the record.
        run: the simulation.
        record: the record; its rows before ``row`` are simulated.
        fall: how the drive ended, if the robot fell, the simulation diverged or the controller failed.

    Raises:
        InputError: for settings that are not allowed, ground that is not level at the start, and as `Rise`.
    """

    run: SimulationRun
    record: SimulationRecord
    fall: Fall | None

    def __init__(
        self,
        robot: Robot,
        settings: SimulationSettings,
        duration: float,
        *,
        ground: PiecewiseTerrain | None = None,
        obstacles: Sequence[Obstacle] = (),
        lying: bool = False,
    ) -> None:
        self.robot, self.settings, self._ground = robot, settings, ground
        q, stands = robot.reference, standing_feet(robot)
        feet = np.array([*contact_positions(robot, q).values()]).reshape(-1, 3)
        if ground is not None and np.abs(ground.height(feet[:, 0], feet[:, 1])).max() > LEVEL:
            raise InputError(
                "ground of drive is not at the height 0 where the robot stands", "allowed: it is"
            )
        simulated = _simulated(robot, ground, obstacles)
        require_fitting(settings, simulated.model, simulated.description.frames)
        standing = np.array([contact in stands for contact in robot.contacts], dtype=bool)
        self.rises = RISE_TIME * simulated.units.time if lying else 0.0
        duration += self.rises
        self.timeline = ContactTimeline.of_one_phase("drive", settings.control_rate, duration, standing)
        require_within(settings, self.timeline)
        with muted_mujoco():
            site = Site.at_rest(simulated, q, np.flatnonzero(standing).tolist())
            self.scene: Scene = build_scene(site, settings)
        torque = _torque_at_rest(robot, stands)
        self._rise = Rise(robot, self.scene, torque, self.timeline.period) if lying else None
        q, torque = (q, torque) if self._rise is None else (self._rise.lying, np.zeros(robot.nu))
        self._start = Start(q=q, v=np.zeros(robot.nv), torque=torque)
        self._test = FallTest(self.scene)

    def begin(self, controller: TorqueController, height: Callable[[float], float] | None = None) -> None:
        """Put the robot back into its start.

        Args:
            controller: returns the torques; its time begins after the rise.
            height: commanded height, m, over this time in s, at which falls are judged; default: 0.
        """
        if self._rise is not None:
            self._rise.controller, controller = controller, self._rise
        with muted_mujoco():
            self.run = SimulationRun(self.scene, self.timeline, controller, self._start, self.settings)
            self.record = self.run.start()
        self._height = height
        self.row = 0
        self.fall = None

    def simulate(self, clock: Clock) -> None:
        """Simulate as many ticks at a time as the clock lets pass, until it ends the drive."""
        while count := clock(self):
            self.advance(count)

    @property
    def offset(self) -> float:
        """Time at which the record begins, s after the start."""
        return self.run.forgotten * self.timeline.period

    @property
    def passed(self) -> float:
        """Simulated time, s."""
        return (self.run.forgotten + self.row) * self.timeline.period

    def advance(self, count: int) -> None:
        """Simulate ``count`` ticks, or until the simulation fails, and judge whether the robot has fallen.

        It cannot fall while it rises. A full record drops its older half. A fallen robot stays as it is.
        """
        if self.fall is not None:
            return
        if self.row + count > len(self.timeline.t):
            self._forget()
        first, why = self.row, "the simulation diverged"
        last = first + count
        try:
            with muted_mujoco():
                self.row = self.run.advance(self.record, first, last)
        except TrajoptError as error:
            why = str(error)
        rows = slice(max(first, round(self.rises / self.timeline.period) - self.run.forgotten), self.row)
        self.fall = self._test.first(self.record, self.timeline, rows, self._upright(rows))
        if self.fall is None and self.row < last:
            self.fall = Fall(time=float(self.timeline.t[self.row]), why=why)

    def recorded(self) -> SimulationRecord:
        """The record so far, with the final state; up to where the simulation failed."""
        if self.fall is not None or self.row == len(self.timeline.t):
            return self.run.ended(self.record, self.row)
        record, data = self.record.until(self.row + 1), self.run.data
        record.qpos[self.row], record.qvel[self.row] = data.qpos, data.qvel
        return record

    def motion_fields(self, timeline: ContactTimeline, record: SimulationRecord) -> dict[str, Any]:
        """Fields of a `SimulatedMotion` beside its report."""
        return {"scene": self.scene, "settings": self.settings, "timeline": timeline, "record": record}

    def _forget(self) -> None:
        half = len(self.timeline.t) // 2
        for part in vars(self.record).values():
            if isinstance(part, np.ndarray):
                part[: self.row - half] = part[half : self.row].copy()
        self.row -= half
        self.run.forgotten += half

    def _upright(self, rows: slice) -> np.ndarray:
        """The posture at the start (n, nq), at the place, heading and commanded height of each row."""
        q = self.scene.coordinates.from_mujoco(self.record.qpos[rows])
        result = np.repeat(self.robot.reference[None], len(q), axis=0)
        if self.robot.base != "freeflyer":
            return result
        result[:, :2] = q[:, :2]
        if self._height is not None:
            result[:, 2] += [self._height(self.offset - self.rises + t) for t in self.timeline.t[rows]]
        if self._ground is not None:
            below = self._ground.height(q[:, 0], q[:, 1])
            result[:, 2] += np.where(np.isfinite(below), below, 0.0)
        x, y, z, w = q[:, 3:7].T
        half = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) / 2
        result[:, 3:7] = np.column_stack([np.zeros((len(q), 2)), np.sin(half), np.cos(half)])
        return result


def _simulated(robot: Robot, ground: PiecewiseTerrain | None, obstacles: Sequence[Obstacle]) -> SceneRobot:
    """The robot with the description of its problem at rest, on level or other ground."""
    about = replace(
        described(rest(robot)), problem="drive", phase_names=("drive",), obstacles=tuple(obstacles)
    )
    return SceneRobot(
        model=robot.limited_model(),
        description=about if ground is None else replace(about, terrain=ground),
        actuated_rows=robot.actuated_rows,
        actuation=robot.actuation,
    )


def _torque_at_rest(robot: Robot, feet: Sequence[Contact]) -> np.ndarray:
    """Torques (nu,) that hold the reference posture, with the least contact forces at the feet."""
    q, model, actuation = robot.reference, robot.model, robot.actuation
    gravity = pin.computeGeneralizedGravity(model, model.createData(), q)
    gravity = gravity - joint_force(model, robot.joint_forces, q, np.zeros(robot.nv))
    jacobian = contact_jacobian(model, q, [(contact.frame, contact.rows) for contact in feet])
    balance = actuation.balanced(jacobian).T, actuation.balanced(gravity)
    return actuation.inputs(gravity - jacobian.T @ np.linalg.lstsq(*balance, rcond=None)[0])
