"""Tasks of a tick during recovery, for centre of mass, base, feet in the air, joints and forces."""

import numpy as np
import pinocchio as pin

from trajopt.control.gains import TrackerGains
from trajopt.control.plan_targets import PlanTargets
from trajopt.control.recovery import RecoveryStep
from trajopt.control.reference import ReferenceTrajectory
from trajopt.control.robot_state import RobotState
from trajopt.control.tasks import CenterOfMassTask, ContactForceTask, FrameTask, PostureTask, Task

# Factor on the weight of joints during recovery, when feet are far from the planned posture.
RECOVERING = 0.1


class RecoveryTasks:
    """Tasks of all ticks during recovery.

    Args:
        reference: the tracked plan at the ticks.
        targets: its targets.
        gains: gains of the feedback.
    """

    def __init__(self, reference: ReferenceTrajectory, targets: PlanTargets, gains: TrackerGains) -> None:
        self._gains, self._reference, self._targets = gains, reference, targets
        self._units, self._frames = reference.units, reference.contact_ids
        self._rows = reference.actuated_rows
        self._unit = self._units.acceleration(reference.model)[self._rows]

    def of(self, k: int, step: RecoveryStep, state: RobotState) -> list[Task]:
        """Tasks of tick ``k``; in flight only those of joints and feet."""
        gains, units, reference = self._gains, self._units, self._reference
        tasks: list[Task] = [
            PostureTask(
                weight=RECOVERING * gains.joint_weight,
                q=reference.q[k],
                v=reference.v[k],
                a=reference.a[k],
                bandwidth=gains.joint / units.time,
                rows_of_v=self._rows,
                weights=np.ones(len(self._rows)),
                unit=self._unit,
            )
        ]
        if step.active.any():
            tasks += self._standing(k, step, state)
        return tasks + [
            FrameTask(
                weight=gains.foot_weight,
                frame=self._frames[i],
                pose=pin.SE3(self._targets.rotation[k, i], path.position),
                velocity=np.append(path.velocity, np.zeros(3)),
                acceleration=np.append(path.acceleration, np.zeros(3)),
                bandwidth=gains.foot / units.time,
                selection=np.eye(6)[:3],
                units=(units.gravity, units.gravity / units.length),
            )
            for i, path in step.paths.items()
        ]

    def _standing(self, k: int, step: RecoveryStep, state: RobotState) -> list[Task]:
        """Tasks of forces that share the weight equally, of the centre of mass and of the base."""
        gains, units, targets = self._gains, self._units, self._targets
        position, velocity = state.centre_of_mass()[:2]
        forces = np.zeros_like(self._reference.f[k])
        forces[step.active, 2] = units.weight / step.active.sum()
        return [
            ContactForceTask(
                weight=gains.force_weight,
                wanted=forces,
                units=(units.weight, units.weight * units.length),
            ),
            CenterOfMassTask(
                weight=gains.com_weight,
                position=position,
                velocity=velocity,
                acceleration=step.acceleration,
                bandwidth=0.0,
                unit=units.gravity,
            ),
            FrameTask(
                weight=gains.base_weight,
                frame=targets.base,
                pose=pin.SE3(targets.base_rotation[k], np.zeros(3)),
                velocity=targets.base_velocity[k],
                acceleration=targets.base_acceleration[k],
                bandwidth=gains.body / units.time,
                selection=np.hstack([np.zeros((3, 3)), np.eye(3)]),
                units=(units.gravity, units.gravity / units.length),
            ),
        ]
