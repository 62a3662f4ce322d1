"""Tasks of a tick in which a robot recovers: centre of mass, base, feet in the air, joints and forces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.certify.accuracy.natural_units import NaturalUnits
from trajopt.control.plan_targets import PlanTargets
from trajopt.control.recovery import RecoveryStep
from trajopt.control.reference import ReferenceTrajectory
from trajopt.control.robot_state import RobotState
from trajopt.control.tasks import CenterOfMassTask, ContactForceTask, FrameTask, PostureTask, Task


@dataclass(frozen=True, kw_only=True)
class RecoveryTasks:
    """What the tasks of all ticks share.

    frames: of the contacts. base: frame of the base. rows: of v that are actuated. unit: (nv,) of
    accelerations. body, foot, joint: bandwidths, 1/s. weights: of tasks, by name.
    """

    reference: ReferenceTrajectory
    targets: PlanTargets
    units: NaturalUnits
    frames: list[int]
    base: int
    rows: np.ndarray
    unit: np.ndarray
    body: float
    foot: float
    joint: float
    weights: dict[str, float]

    def of(self, k: int, step: RecoveryStep, state: RobotState) -> list[Task]:
        """Tasks of tick ``k``; in flight joints and feet alone."""
        reference = self.reference
        found: list[Task] = [
            PostureTask(
                weight=self.weights["joint"],
                q=reference.q[k],
                v=reference.v[k],
                a=reference.a[k],
                bandwidth=self.joint,
                rows_of_v=self.rows,
                weights=np.ones(len(self.rows)),
                unit=self.unit[self.rows],
            )
        ]
        if step.active.any():
            found += self._standing(k, step, state)
        return found + [
            FrameTask(
                weight=self.weights["foot"],
                frame=self.frames[i],
                pose=pin.SE3(self.targets.rotation[k, i], path.position),
                velocity=np.append(path.velocity, np.zeros(3)),
                acceleration=np.append(path.acceleration, np.zeros(3)),
                bandwidth=self.foot,
                selection=np.eye(6)[:3],
                units=(self.units.gravity, self.units.gravity / self.units.length),
            )
            for i, path in step.paths.items()
        ]

    def _standing(self, k: int, step: RecoveryStep, state: RobotState) -> list[Task]:
        """Forces, with the weight on all feet alike, centre of mass and orientation of the base."""
        units, targets = self.units, self.targets
        position, velocity = state.centre_of_mass()[:2]
        forces = np.zeros_like(self.reference.f[k])
        forces[step.active, 2] = units.weight / step.active.sum()
        return [
            ContactForceTask(
                weight=self.weights["force"],
                wanted=forces,
                units=(units.weight, units.weight * units.length),
            ),
            CenterOfMassTask(
                weight=self.weights["com"],
                position=position,
                velocity=velocity,
                acceleration=step.acceleration,
                bandwidth=0.0,
                unit=units.gravity,
            ),
            FrameTask(
                weight=self.weights["base"],
                frame=self.base,
                pose=pin.SE3(targets.base_rotation[k], np.zeros(3)),
                velocity=targets.base_velocity[k],
                acceleration=targets.base_acceleration[k],
                bandwidth=self.body,
                selection=np.hstack([np.zeros((3, 3)), np.eye(3)]),
                units=(units.gravity, units.gravity / units.length),
            ),
        ]
