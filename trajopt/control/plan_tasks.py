"""Tasks of a tick that follows the plan, for joints, forces, centre of mass, base and contacts in the air."""

from __future__ import annotations

import copy

import numpy as np
import pinocchio as pin

from trajopt.control.balance import Balance
from trajopt.control.gains import TrackerGains
from trajopt.control.measured_contacts import MeasuredContacts
from trajopt.control.plan_targets import PlanTargets, base_frame, tracking_model
from trajopt.control.reference import ReferenceTrajectory
from trajopt.control.robot_state import RobotState
from trajopt.control.swing_tasks import SwingTasks
from trajopt.control.tasks import ContactForceTask, FrameTask, PostureTask, Task
from trajopt.dynamics.base_joint import base_of
from trajopt.motion.cycles import moving_rows
from trajopt.robot.natural_units import NaturalUnits
from trajopt.solution.solution import Solution

# Factor on rotations of the base about lines on which the robot balances.
TILT_PART = 0.03


class PlanTasks:
    """Tasks of all ticks of a plan.

    Args:
        plan: the tracked plan; ``reference`` and ``targets`` are of its ticks.
        gains: gains of the feedback.
    """

    def __init__(
        self, plan: Solution, reference: ReferenceTrajectory, targets: PlanTargets, gains: TrackerGains
    ) -> None:
        self._gains, self._reference, self._targets = gains, reference, targets
        self._units = NaturalUnits.of(plan.model)
        self._moving = base_of(plan.model) != "fixed"
        self._base = base_frame(tracking_model(plan, 0)) if self._moving else 0
        self._rows = plan.actuated_rows
        self._unit = self._units.acceleration(plan.model)[self._rows]
        self._walks = bool(plan.description.periodicity)
        self._stands = np.asarray(reference.active.any(axis=0))
        self._legs = _determined_joints(plan, self._stands)
        self._balance = Balance(plan, reference, targets, gains)
        self._swings = SwingTasks(plan, reference, targets, gains)

    def copy(self) -> PlanTasks:
        """An independent copy of the tasks."""
        twin = copy.copy(self)
        twin._swings = self._swings.copy()
        return twin

    def stand(self, k: int, active: np.ndarray, state: RobotState) -> None:
        """Let the ``active`` contacts (nc,) stand where they are."""
        self._swings.stand(k, active, state)

    def of(self, k: int, active: np.ndarray, contacts: MeasuredContacts, state: RobotState) -> list[Task]:
        """Tasks of tick ``k`` with the ``active`` contacts (nc,)."""
        units, reference = self._units, self._reference
        planned = reference.active[k]
        flying = not (planned.any() and active.any())
        support = self._balance.support(k, active | planned, state) if self._moving and not flying else None
        tilting = support.lines if support and self._balance.lasts[k] else np.zeros((0, 3))
        tasks: list[Task] = [self._posture(k, self._joint_weights(active, flying, bool(len(tilting))))]
        if active.any():
            tasks.append(
                ContactForceTask(
                    weight=self._gains.force_weight,
                    wanted=reference.f[k],
                    units=(units.weight, units.weight * units.length),
                )
            )
        if not self._moving:
            return tasks
        if support:
            tasks += [self._balance.task(k, support, state), self._orientation(k, tilting)]
        return tasks + [
            self._swings.of(int(i), k, contacts.late(int(i), k), support, state)
            for i in np.flatnonzero(self._stands & ~active)
        ]

    def _posture(self, k: int, weights: np.ndarray) -> PostureTask:
        reference = self._reference
        return PostureTask(
            q=reference.q[k],
            v=reference.v[k],
            a=reference.a[k],
            bandwidth=self._gains.joint / self._units.time,
            rows_of_v=self._rows,
            weights=weights,
            unit=self._unit,
        )

    def _orientation(self, k: int, tilting: np.ndarray) -> FrameTask:
        """Orientation task of the base, with little weight about axes (r, 3) on which the robot balances."""
        units, targets = self._units, self._targets
        return FrameTask(
            weight=self._gains.base_weight,
            frame=self._base,
            pose=pin.SE3(targets.base_rotation[k], np.zeros(3)),
            velocity=targets.base_velocity[k],
            acceleration=targets.base_acceleration[k],
            bandwidth=self._gains.body / units.time,
            selection=np.hstack([np.zeros((3, 3)), _without(tilting)]),
            units=(units.gravity, units.gravity / units.length),
        )

    def _joint_weights(self, active: np.ndarray, flying: bool, balances: bool) -> np.ndarray:
        """Weights of the planned posture, one for each actuated joint.

        They are low for joints that the pose of a foot in the air determines. When the base is off the plan,
        their posture contradicts the pose of the foot and would hold it back.
        """
        gains, legs = self._gains, self._legs
        size = legs.shape[1]
        if not self._moving:
            return np.ones(size)
        if balances:
            return np.full(size, gains.balance_joint_weight)
        if flying and not self._walks:
            return np.full(size, gains.flight_joint_weight)
        swinging = legs[self._stands & ~active].any(axis=0)
        return np.where(swinging, gains.leg_weight, gains.joint_weight)


def _determined_joints(plan: Solution, stands: np.ndarray) -> np.ndarray:
    """Mask (nc, actuated joints) of the joints that move a foot, if its pose determines all of them."""
    actuated = plan.actuated_rows
    determined = np.zeros((len(stands), len(actuated)), dtype=bool)
    for i in np.flatnonzero(stands):
        joints = np.isin(actuated, list(moving_rows(plan.model, plan.contact_frames[i])))
        determined[i, joints] = joints.sum() <= (6 if plan.description.contacts[i].is_sole else 3)
    return determined


def _without(axes: np.ndarray) -> np.ndarray:
    """Rows (3, 3) of rotations, of which only a small part is left about orthogonal axes (r, 3)."""
    axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    return np.asarray(np.eye(3) - (1.0 - TILT_PART) * axes.T @ axes)
