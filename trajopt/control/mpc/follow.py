"""Torques that follow the motion of a horizon, by a quadratic program at each tick."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trajopt.arguments import NonNegative, Positive, checked
from trajopt.control.inverse_dynamics import RELAXED, TaskSpaceInverseDynamics
from trajopt.control.limits import RobotLimits
from trajopt.control.mpc.motion import FollowedSample
from trajopt.control.mpc.payload import carrying
from trajopt.control.mpc.plans import ControllerReport
from trajopt.control.quadratic_programs import QpSolverName
from trajopt.control.robot_state import RobotState
from trajopt.control.task_space import standing_contact
from trajopt.control.tasks import ContactForceTask, FrameTask, PostureTask, RegularisationTask, Task
from trajopt.robot.natural_units import NaturalUnits
from trajopt.robot.robot import Robot

SMALL = 1e-8
# A contact that should stand but does not touch moves down at this fraction of sqrt(g l), with this weight.
PRESSED, PRESSING = 0.15, 10.0
# Time over which joints brake before their limits, s.
HORIZON = 0.02


@checked
@dataclass(frozen=True, kw_only=True)
class FollowerGains:
    """Gains of a `Follower`: bandwidths in 1 / sqrt(l / g), with l the robot's reach, and weights.

    ``base`` and ``joint`` are bandwidths. Weights are of the base, of the joints of standing legs
    (``joint_weight``) and of swinging legs (``swing_weight``), and of contact forces.
    """

    base: NonNegative = 6.0
    joint: Positive = 20.0
    base_weight: NonNegative = 10.0
    joint_weight: NonNegative = 0.01
    swing_weight: NonNegative = 1.0
    force_weight: NonNegative = 1e-3


class Follower:
    """Torques that follow samples of a motion, within the limits of the robot and its drives.

    Args:
        robot: a robot with a free base.
        gains: gains of the feedback.
        friction: Coulomb's coefficient.
        solver: solver of the quadratic programs.
    """

    def __init__(
        self,
        robot: Robot,
        gains: FollowerGains | None = None,
        *,
        friction: float = 0.7,
        solver: QpSolverName = "piqp",
    ) -> None:
        self.robot, self.gains, self.friction = robot, gains or FollowerGains(), friction
        self.units, self.state = NaturalUnits.of(robot.model), RobotState(robot.model, robot.joint_forces)
        self._program = TaskSpaceInverseDynamics.of(self.state, robot.actuation, self.units, solver=solver)
        self.acceleration_unit = self._program.acceleration_unit
        self._limits = RobotLimits.of(robot, HORIZON)
        self._small = RegularisationTask(weight=SMALL, unit=self.acceleration_unit)
        self._legs = [self._rows_of(contact.frame) for contact in robot.contacts]
        self.report = ControllerReport()

    def _rows_of(self, frame: str) -> np.ndarray:
        """Rows of v of the joints between the base and a frame."""
        model = self.robot.model
        joint = model.frames[model.getFrameId(frame)].parentJoint
        chain = [model.joints[i] for i in model.supports[joint] if i > 1]
        return np.array([row for each in chain for row in range(each.idx_v, each.idx_v + each.nv)])

    def carry(self, payload: np.ndarray) -> None:
        """Set the payload of the base, `payload_numbers` (4,)."""
        self.state.model = carrying(self.robot.model, payload)
        self.state.data = self.state.model.createData()

    def bandwidths(self, active: np.ndarray) -> np.ndarray:
        """Bandwidths (nv,) of the feedback, 1/s; standing legs have that of the base."""
        rates = np.full(self.state.model.nv, self.gains.base)
        for leg, stands in zip(self._legs, active, strict=True):
            if not stands:
                rates[leg] = self.gains.joint
        return rates / self.units.time

    def torque(self, wanted: FollowedSample, q: np.ndarray, v: np.ndarray, active: np.ndarray) -> np.ndarray:
        """Torques (nu,) that follow a sample in the measured state; ``active`` contacts (nc,) carry force."""
        self.state.update(q, v)
        robot, standing = self.robot, np.flatnonzero(active)
        contacts = [standing_contact(robot, robot.contacts[i], self.friction) for i in standing]
        result = self._program.solve(contacts, self._tasks(wanted, active), self._limits.at(q, v))
        self.report.followed(result)
        if RELAXED[result.relaxed] != "everything":
            return result.torque
        held = self._program.held(self.gains.joint / self.units.time, wanted.q, wanted.v, wanted.torque)
        return np.asarray(np.clip(held, *self._limits.torque))

    def _tasks(self, wanted: FollowedSample, active: np.ndarray) -> Sequence[Task]:
        gains, model, time = self.gains, self.state.model, self.units.time
        weights = np.full(model.nv, gains.joint_weight)
        for leg, stands in zip(self._legs, active, strict=True):
            if not stands:
                weights[leg] = gains.swing_weight
        base, joints = np.arange(6), np.arange(6, model.nv)
        return [
            PostureTask(
                q=wanted.q,
                v=wanted.v,
                a=wanted.a,
                bandwidth=gains.base / time,
                rows_of_v=base,
                weight=gains.base_weight,
                unit=self.acceleration_unit[base],
            ),
            PostureTask(
                q=wanted.q,
                v=wanted.v,
                a=wanted.a,
                bandwidth=gains.joint / time,
                rows_of_v=joints,
                weights=weights[joints],
                unit=self.acceleration_unit[joints],
            ),
            ContactForceTask(
                wanted=wanted.forces,
                weight=gains.force_weight,
                units=(self.units.weight, self.units.weight * self.units.length),
            ),
            self._small,
            *(self._pressing(int(i)) for i in np.flatnonzero(wanted.active & ~active)),
        ]

    def _pressing(self, number: int) -> FrameTask:
        """The task by which a late contact moves down."""
        frame, speed = self.robot.contacts[number].frame, PRESSED * self.units.length / self.units.time
        return FrameTask(
            frame=frame,
            pose=self.state.frame(frame).placement,
            velocity=np.array([0.0, 0.0, -speed, 0.0, 0.0, 0.0]),
            bandwidth=self.gains.joint / self.units.time,
            selection=np.eye(6)[2:3],
            units=(self.units.gravity, self.units.gravity / self.units.length),
            weight=PRESSING,
        )
