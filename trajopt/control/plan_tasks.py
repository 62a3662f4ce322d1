"""Tasks of a tick, of the plan or of recovery: joints, forces, balance, base and contacts in the air."""

from __future__ import annotations

import copy

import numpy as np
import pinocchio as pin

from trajopt.control.contact_forces import cross
from trajopt.control.gains import TrackerGains
from trajopt.control.measured_contacts import MeasuredContacts
from trajopt.control.plan_targets import PlanTargets
from trajopt.control.recovery import RecoveryStep
from trajopt.control.reference import ReferenceTrajectory
from trajopt.control.robot_state import RobotState
from trajopt.control.support import LOWEST, Support, next_narrow, support_of, thin_axes
from trajopt.control.swing_tasks import SwingTasks
from trajopt.control.tasks import CenterOfMassTask, ContactForceTask, FrameTask, PostureTask, Task
from trajopt.motion.cycles import moving_rows

# Factor on rotations of the base about lines on which the robot balances.
TILT_PART = 0.03
# Factor on the weight of joints during recovery, when feet are far from the planned posture.
RECOVERING = 0.1


class PlanTasks:
    """Tasks of all ticks of a plan.

    Args:
        reference: the tracked plan at the ticks.
        targets: its targets.
        gains: gains of the feedback.
    """

    def __init__(self, reference: ReferenceTrajectory, targets: PlanTargets, gains: TrackerGains) -> None:
        self._gains, self._reference, self._targets = gains, reference, targets
        self._units, self._rows = reference.units, reference.actuated_rows
        self._moving = reference.base != "fixed"
        self._unit = self._units.acceleration(reference.model)[self._rows]
        self._walks = bool(reference.description.periodicity)
        self._stands = np.asarray(reference.active.any(axis=0))
        self._legs = _determined_joints(reference, self._stands)
        self._balance = Balance(reference, targets, gains)
        self._swings = SwingTasks(reference, targets, gains)

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
        reference = self._reference
        planned = reference.active[k]
        flying = not (planned.any() and active.any())
        support = self._balance.support(k, active | planned, state) if self._moving and not flying else None
        tilting = support.lines if support and self._balance.lasts[k] else np.zeros((0, 3))
        tasks: list[Task] = [self._posture(k, self._joint_weights(active, flying, bool(len(tilting))))]
        if active.any():
            tasks.append(self._forces(reference.f[k]))
        if not self._moving:
            return tasks
        if support:
            tasks += [self._balance.task(k, support, state), self._orientation(k, tilting)]
        return tasks + [
            self._swings.of(int(i), k, contacts.late(int(i), k), support, state)
            for i in np.flatnonzero(self._stands & ~active)
        ]

    def of_recovery(self, k: int, step: RecoveryStep, state: RobotState) -> list[Task]:
        """Tasks of tick ``k`` of recovery, in which feet share the weight; in flight of joints and feet."""
        gains, units = self._gains, self._units
        tasks: list[Task] = [self._posture(k, np.ones(len(self._rows)), RECOVERING * gains.joint_weight)]
        if step.active.any():
            position, velocity = state.centre_of_mass()[:2]
            forces = np.zeros_like(self._reference.f[k])
            forces[step.active, 2] = units.weight / step.active.sum()
            centre = CenterOfMassTask(
                weight=gains.com_weight,
                position=position,
                velocity=velocity,
                acceleration=step.acceleration,
                bandwidth=0.0,
                unit=units.gravity,
            )
            tasks += [self._forces(forces), centre, self._orientation(k, np.zeros((0, 3)))]
        return tasks + [
            self._swings.task(
                i,
                pin.SE3(self._targets.rotation[k, i], path.position),
                np.append(path.velocity, np.zeros(3)),
                np.append(path.acceleration, np.zeros(3)),
            )
            for i, path in step.paths.items()
        ]

    def _forces(self, wanted: np.ndarray) -> ContactForceTask:
        units = self._units
        return ContactForceTask(
            weight=self._gains.force_weight, wanted=wanted, units=(units.weight, units.weight * units.length)
        )

    def _posture(self, k: int, weights: np.ndarray, weight: float = 1.0) -> PostureTask:
        reference = self._reference
        return PostureTask(
            weight=weight,
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
            frame=targets.base,
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


def _determined_joints(plan: ReferenceTrajectory, stands: np.ndarray) -> np.ndarray:
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


# Largest feedback acceleration of the centre of mass, over g: more would only leave the friction cones.
MOST_FEEDBACK = 1.0
# Shortest stance on a line or a point in which the robot actively balances, over sqrt(l / g).
LASTING = 1.0
# Width, over l, below which a support is a line or a point, on which only motion can balance.
THIN = 1e-2


class Balance:
    """Supports at the ticks of a plan, and the centre of mass over them.

    Args:
        reference: the tracked plan at the ticks.
        targets: its targets.
        gains: gains of the feedback.

    ``wide`` (n,) tells whether the planned contacts hold the body in all directions: by a sole, a held
    contact, or points that are not on a line. ``lasts`` (n,): whether the robot balances on narrow ones.
    """

    def __init__(self, reference: ReferenceTrajectory, targets: PlanTargets, gains: TrackerGains) -> None:
        self._units, self._gains, self._targets = reference.units, gains, targets
        self._frames, self._soles = reference.contact_ids, reference.description.soles
        self._walks = bool(reference.description.periodicity)
        self.wide = np.array([self._is_wide(row, k) for k, row in enumerate(reference.active)])
        self.lasts = self._lasting(reference)
        # In gaits feet land where they catch the centre of mass instead.
        self._next = next_narrow(reference.active, self.wide) & (not self._walks)

    def support(self, k: int, standing: np.ndarray, state: RobotState) -> Support:
        """The support at tick k; it is narrow only if the planned one is, not because a foot is late."""
        picked = np.flatnonzero(standing)
        places = np.array([state.frame(self._frames[i]).placement.translation for i in picked])
        return support_of(
            places,
            self._targets.position[k, picked],
            np.zeros((0, 3)) if self.wide[k] else thin_axes(places, THIN * self._units.length),
            state.centre_of_mass()[0],
            self._units.gravity,
            LOWEST * self._units.length,
        )

    def task(self, k: int, support: Support, state: RobotState) -> CenterOfMassTask:
        """The task by which the centre of mass follows the plan, as far as the support allows.

        On a narrow support that lasts, the angular momentum follows the plan too. If the support p has no
        extent along u, only gravity changes the angular momentum L about its line, whose level part is z x u:
        dL = m g (c - p) u. A triple pole of this chain of integrators (Azad and Featherstone, IEEE Trans.
        Robotics 32, 2016) gives, with errors e and the bandwidth w,
            dd c = dd c_d - 3 w de - 3 w^2 e - w^3 e_L / (m g)
        On a narrow support that does not last, the centre of mass falls like a pendulum until the next feet
        stand. Before that, on the wide support, it follows the feet that will carry it, which may stand
        beside their planned places.
        """
        gains, units, targets = self._gains, self._units, self._targets
        w, tilt = gains.body / units.time, gains.balance / units.time
        position, velocity, _, _ = state.centre_of_mass()
        wanted, rate, acceleration = targets.com[k]
        error, change = position - wanted, velocity - rate
        if self._next[k].any():
            error -= self.support(k, self._next[k], state).offset
        feedback = -2 * w * change - w**2 * error
        across = support.axes.T @ support.axes
        if len(support.axes) and self.lasts[k]:
            mass = units.weight / units.gravity
            here, planned = support.places.mean(axis=0), support.planned.mean(axis=0)
            momentum = state.angular_momentum()[0] + mass * cross(position - here, velocity)
            asked = targets.momentum[k] + mass * cross(wanted - planned, rate)
            turned = support.axes.T @ (support.lines @ (momentum - asked)) / units.weight
            poles = 3 * tilt * change + 3 * tilt**2 * (error - support.offset)
            feedback -= across @ (poles + feedback) + tilt**3 * turned
        elif len(support.axes):
            feedback += across @ (support.falling(error) - feedback)
            feedback = support.reachable(position, acceleration + feedback) - acceleration
        most = MOST_FEEDBACK * units.gravity
        feedback *= min(1.0, most / max(float(np.linalg.norm(feedback)), most))
        return CenterOfMassTask(
            weight=gains.thin_com_weight if len(support.axes) and not self._walks else gains.com_weight,
            position=position,
            velocity=velocity,
            acceleration=acceleration + feedback,
            bandwidth=0.0,
            unit=units.gravity,
        )

    def _is_wide(self, active: np.ndarray, k: int) -> bool:
        picked = np.flatnonzero(active)
        if self._soles[picked].any() or self._targets.surfaces.bilateral[k, picked].any():
            return True
        return len(picked) > 2 and not len(
            thin_axes(self._targets.position[k, picked], THIN * self._units.length)
        )

    def _lasting(self, reference: ReferenceTrajectory) -> np.ndarray:
        """Ticks (n,) of lasting stances on one line or point; in shorter ones the robot does not balance."""
        active = reference.active
        lasting = np.zeros(len(active), dtype=bool)
        if self._walks or self.wide[active.any(axis=1)].any():
            return lasting  # the next steps, or a wider support, balance the robot
        for begin, end in reference.modes:
            lasts = (end - begin) * reference.period >= LASTING * self._units.time
            lasting[begin:end] = lasts and bool(active[begin].any()) and not self.wide[begin]
        return lasting
