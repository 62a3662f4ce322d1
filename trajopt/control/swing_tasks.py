"""Tasks of contacts in the air: follow the plan, land beside footholds for balance, press down when late."""

from __future__ import annotations

import copy

import numpy as np
import pinocchio as pin

from trajopt.control.footholds import FootholdOffsets, SteadyError, capture_error
from trajopt.control.gains import TrackerGains
from trajopt.control.measured_contacts import DEEPEST, PRESSED
from trajopt.control.plan_targets import PlanTargets
from trajopt.control.reference import ReferenceTrajectory
from trajopt.control.robot_state import RobotState
from trajopt.control.support import Support
from trajopt.control.tasks import FrameTask

# Rate of the pendulum after a flight, times sqrt(l / g): legs half as long as the reach.
FLYING = 2.0**0.5


class SwingTasks:
    """Tasks of contacts in the air, with the offsets of feet from the plan as state.

    Args:
        reference: the tracked plan at the ticks.
        targets: its targets.
        gains: gains of the feedback.
    """

    def __init__(self, reference: ReferenceTrajectory, targets: PlanTargets, gains: TrackerGains) -> None:
        self._units, self._gains, self._targets = reference.units, gains, targets
        self._period, self._frames = reference.period, reference.contact_ids
        self._soles = reference.description.soles
        period, length, time = reference.period, self._units.length, self._units.time
        self._offsets = FootholdOffsets(len(self._frames), period=period, length=length, time=time)
        self._steady = SteadyError(rate=gains.steady / time, period=period, length=length, time=time)
        self._walks = bool(reference.description.periodicity)

    def copy(self) -> SwingTasks:
        """An independent copy of the tasks."""
        twin = copy.copy(self)
        twin._offsets, twin._steady = self._offsets.copy(), self._steady.copy()
        return twin

    def stand(self, k: int, active: np.ndarray, state: RobotState) -> None:
        """Let the ``active`` contacts (nc,) stand where they are; to be called once a tick."""
        if self._walks:
            self._steady.update(*self._error(k, state))
        for i in np.flatnonzero(active):
            here = state.frame(self._frames[i]).placement.translation
            self._offsets.stand(int(i), (here - self._targets.position[k, i])[:2])

    def of(self, i: int, k: int, late: float | None, support: Support | None, state: RobotState) -> FrameTask:
        """The task of contact ``i`` to follow the plan; ``late`` s late, it is pressed to its surface."""
        targets, units = self._targets, self._units
        position, velocity = targets.position[k, i].copy(), targets.velocity[k, i].copy()
        acceleration = targets.acceleration[k, i].copy()
        normal = targets.surfaces.normal[k, i]
        if late is not None:
            speed = PRESSED * np.sqrt(units.gravity * units.length)
            position -= normal * min(speed * late, DEEPEST * units.length)
            velocity[:3] -= normal * speed
        if self._gains.placement and targets.level[k, i]:
            acceleration[:2] += self._beside(i, k, support, state)
            position[:2] += self._offsets.offset[i]
            velocity[:2] += self._offsets.rate[i]
        return self.task(i, pin.SE3(targets.rotation[k, i], position), velocity, acceleration)

    def task(self, i: int, pose: pin.SE3, velocity: np.ndarray, acceleration: np.ndarray) -> FrameTask:
        """The task of contact ``i`` to have a pose, a velocity (6,) and an acceleration (6,)."""
        units = self._units
        return FrameTask(
            weight=self._gains.foot_weight,
            frame=self._frames[i],
            pose=pose,
            velocity=velocity,
            acceleration=acceleration,
            bandwidth=self._gains.foot / units.time,
            selection=np.eye(6)[: 6 if self._soles[i] else 3],
            units=(units.gravity, units.gravity / units.length),
        )

    def _beside(self, i: int, k: int, support: Support | None, state: RobotState) -> np.ndarray:
        """Advance the offset of a foot from its planned motion; returns its acceleration (2,), m/s^2."""
        error, change = self._error(k, state)
        left = float(self._targets.next_stance[k, i]) * self._period
        capture = capture_error(error, change, support, left, FLYING / self._units.time)
        beside = self._gains.placement * capture + self._steady.integral
        return self._offsets.swing(i, error, beside, left)

    def _error(self, k: int, state: RobotState) -> tuple[np.ndarray, np.ndarray]:
        """Errors of the centre of mass (3,), m, and of its velocity (3,), m/s."""
        position, velocity, _, _ = state.centre_of_mass()
        return position - self._targets.com[k, 0], velocity - self._targets.com[k, 1]
