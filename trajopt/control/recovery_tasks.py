"""Tasks of a tick while a robot recovers: centre of mass, base, swinging feet, joints and forces."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from trajopt.control.recovery import RecoveryStep
from trajopt.control.robot_state import RobotState
from trajopt.control.tasks import CenterOfMassTask, ContactForceTask, FrameTask, PostureTask, Task

if TYPE_CHECKING:
    from trajopt.control.tracker import Tracker

W_COM, W_BASE, W_FOOT, W_JOINT, W_FORCE = 10.0, 1.0, 1.0, 1e-3, 1e-3


def recovery_tasks(tracker: Tracker, k: int, step: RecoveryStep, state: RobotState) -> list[Task]:
    gains, units, reference, targets = tracker.gains, tracker.units, tracker.reference, tracker.targets
    rotation = units.gravity / units.length
    position, velocity = state.centre_of_mass()[:2]
    first = tracker.plan.n_unactuated
    rows = np.arange(first, tracker.plan.model.nv)
    tasks: list[Task] = [
        PostureTask(
            weight=W_JOINT,
            q=reference.q[k],
            v=reference.v[k],
            a=reference.a[k],
            bandwidth=gains.joint / units.time,
            rows_of_v=rows,
            weights=np.ones(len(rows)),
            unit=tracker._acceleration[rows],
        )
    ]
    if step.active.any():
        wanted = np.zeros_like(reference.f[k])
        wanted[step.active, 2] = units.weight / step.active.sum()
        tasks.append(
            ContactForceTask(weight=W_FORCE, wanted=wanted, units=(units.weight, units.weight * units.length))
        )
        tasks.append(
            CenterOfMassTask(
                weight=W_COM,
                position=position,
                velocity=velocity,
                acceleration=step.acceleration,
                bandwidth=0.0,
                unit=units.gravity,
            )
        )
        tasks.append(
            FrameTask(
                weight=W_BASE,
                frame=tracker._base,
                pose=pin.SE3(targets.base_rotation[k], np.zeros(3)),
                velocity=targets.base_velocity[k],
                acceleration=targets.base_acceleration[k],
                bandwidth=gains.body / units.time,
                selection=np.hstack([np.zeros((3, 3)), np.eye(3)]),
                units=(units.gravity, rotation),
            )
        )
    for i, path in step.swings.items():
        tasks.append(
            FrameTask(
                weight=W_FOOT,
                frame=tracker._frames[i],
                pose=pin.SE3(targets.rotation[k, i], path.position),
                velocity=np.concatenate([path.velocity, np.zeros(3)]),
                acceleration=np.concatenate([path.acceleration, np.zeros(3)]),
                bandwidth=gains.foot / units.time,
                selection=np.eye(6)[:3],
                units=(units.gravity, rotation),
            )
        )
    return tasks
