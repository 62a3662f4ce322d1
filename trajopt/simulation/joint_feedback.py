"""Joint feedback along a plan, with gains from its inertias and from the weight that its legs hold up.

With the plan's q and v at the start of a period and its torque at mid-period, the torques of the period are

    tau = tau_plan + K_p (q_plan - q) + K_d (v_plan - v)

With the feedback rate w, the robot's weight times its reach m g l, and n contacts on the ground,

    K_p = max(w^2 M_ii, 4 m g l / n)      in legs that the plan has on the ground, else w^2 M_ii
    K_d = 2 sqrt(K_p M_ii)

(4 m g / (l n) for prismatic joints), so that each joint on its own removes an error without overshoot, in a
time that does not depend on its inertia. The joints of a stance leg hold up the body, an inverted pendulum
that falls if their stiffness is below m g l / n. Where dampers would be unstable in discrete time on a free
leg, dampers and springs are weakened: the joints of a late foot are as free as in the swing.
"""

import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from typing_extensions import override

from trajopt.control.reference import ReferenceTrajectory
from trajopt.dynamics.model_quantities import contact_jacobian
from trajopt.motion.cycles import gains_in_passes, moving_rows, pass_numbers
from trajopt.motion.sampled_motion import SampledMotion
from trajopt.robot.mujoco_package import mujoco_package
from trajopt.simulation.bodies import write_inertias
from trajopt.simulation.scene import Scene
from trajopt.simulation.settings import FEEDBACK_TIME, SimulationSettings

# Gains are recomputed after this many periods of the controller, and held in between.
EVERY = 5
# A discrete damper is stable while its rate times the period is below 2; half of that leaves room for delay.
FASTEST = 1.0
# Contact rows depend on others below this part of the largest eigenvalue of their inverse inertia.
DEPENDENT = 1e-9
# Ticks whose gains of a plan are interpolated at once.
STRETCH = 100
# Stiffness of stance legs over that at which the body just falls.
STIFFER = 4.0


@dataclass(frozen=True, kw_only=True)
class Gains:
    """Stiffness and damping (n, nu) of the actuated rows in n periods."""

    kp: np.ndarray
    kd: np.ndarray


class JointFeedback:
    """The controller of the module; each joint has its own feedback.

    Args:
        scene: the scene, without whose inertias there are no gains.
        reference: the plan.
        settings: factors on the gains.
    """

    def __init__(self, scene: Scene, reference: ReferenceTrajectory, settings: SimulationSettings) -> None:
        self._scene, self._reference, self._settings = scene, reference, settings
        self._rows = scene.robot.actuated_rows

    @cached_property
    def gains(self) -> Gains:
        """Gains for every period."""
        return gains_of(self._scene, self._reference, self._reference.period, self._settings)

    def torque(self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray) -> np.ndarray:
        """Torques (nu,) at ``t`` s, see `TorqueController`."""
        k, reference, rows = round(t / self._reference.period), self._reference, self._rows
        error = pin.difference(self._scene.robot.model, q, reference.q[k])[rows]
        torque = reference.drive_torque[k].copy()
        torque[: len(rows)] += self.gains.kp[k] * error + self.gains.kd[k] * (reference.v[k] - v)[rows]
        return torque


class PlanFeedback(JointFeedback):
    """Feedback of the whole state with the gains of the plan; single joints hold its end.

    The torques of a period are tau = tau_plan + K (x - x_plan), see `Solution.gains`. The state is that at
    the end of the period, to which feedback moves the robot on the contacts that hold: a damper of a stance
    would be unstable in discrete time on a leg that has lifted (Tan, Liu and Turk, "Stable
    proportional-derivative controllers", IEEE CG&A 31, 2011). Cycles repeat gains, mirrored as the motion is.

    Raises `InputError` for a plan without gains.
    """

    def __init__(self, scene: Scene, reference: ReferenceTrajectory, settings: SimulationSettings) -> None:
        super().__init__(scene, reference, settings)
        plan = self._plan = reference.plan
        plan.gains(times=plan.interval_t[:1, 0])  # refused before the first tick
        self._number = pass_numbers(plan, reference)
        first = np.searchsorted(self._number, self._number)
        self._times = plan.interval_t[0, 0] + (np.arange(len(first)) - first) * reference.period
        self._stretch, self._gains = -1, np.zeros(0)

    @override
    def torque(self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray) -> np.ndarray:
        reference, k = self._reference, round(t / self._reference.period)
        if k >= reference.planned:
            return super().torque(t, q, v, touching)
        gain, nv, period = self._gain(k), self._plan.model.nv, reference.period
        rate, model = v - reference.v[k], self._scene.site.models[int(reference.source[k])]
        change = np.concatenate([pin.difference(model, reference.q[k], q) + period * rate, rate])
        inverse = self._inverse_inertia(model, q, np.asarray(touching, dtype=bool) & reference.active[k])
        response = period * inverse @ self._plan.actuation.force(np.eye(len(gain))).T
        damping = gain[:, nv:] + period * gain[:, :nv]
        feedback = np.linalg.solve(np.eye(len(gain)) - damping @ response, gain @ change)
        return np.asarray(reference.drive_torque[k] + feedback)

    def _gain(self, k: int) -> np.ndarray:
        """Gain (nu, 2 nv) of tick ``k``, from those of a stretch of ticks."""
        stretch, row = divmod(k, STRETCH)
        if stretch != self._stretch:
            ticks = slice(stretch * STRETCH, min((stretch + 1) * STRETCH, self._reference.planned))
            self._gains = gains_in_passes(self._plan, self._times[ticks], self._number[ticks])
            self._stretch = stretch
        return np.asarray(self._gains[row])

    def _inverse_inertia(self, model: pin.Model, q: np.ndarray, standing: np.ndarray) -> np.ndarray:
        """Accelerations per force (nv, nv) with the contacts ``standing`` (nc,) held."""
        inverse = pin.computeMinverse(model, model.createData(), q)
        inverse = np.triu(inverse) + np.triu(inverse, 1).T
        every = self._plan.description.contacts
        frames = [(every[i].frame, 6 if every[i].is_sole else 3) for i in np.flatnonzero(standing)]
        if not frames:
            return np.asarray(inverse)
        jacobian = contact_jacobian(model, q, frames)
        held = jacobian @ inverse
        return inverse - held.T @ np.linalg.pinv(held @ jacobian.T, rcond=DEPENDENT, hermitian=True) @ held


def gains_of(scene: Scene, motion: SampledMotion, period: float, settings: SimulationSettings) -> Gains:
    """Gains at every time of a motion, for feedback with a ``period`` in s."""
    part, spread = motion.at(np.arange(0, len(motion.t), EVERY)), np.arange(len(motion.t)) // EVERY
    gains = gains_at(scene, part.q, part.active, part.source, period)
    return Gains(kp=settings.kp * gains.kp[spread], kd=settings.kd * gains.kd[spread])


def gains_at(scene: Scene, q: np.ndarray, active: np.ndarray, phases: np.ndarray, period: float) -> Gains:
    """Gains in postures (n, nq) on ``active`` contacts (n, nc), with the payloads of ``phases`` (n,)."""
    matrices, rows = _inertias(scene, q, phases), scene.rows
    inertia = np.diagonal(matrices, axis1=1, axis2=2)[:, rows]
    rate = 1.0 / (FEEDBACK_TIME * scene.units.time)
    kp = np.maximum(rate**2 * inertia, _holding(scene, active))
    kd = 2 * np.sqrt(kp * inertia)
    response = np.linalg.inv(matrices)[:, rows[:, None], rows] * kd[:, None, :] * period
    fastest = np.abs(np.linalg.eigvals(response)).max(axis=1, initial=0.0)
    weaker = np.minimum(1.0, FASTEST / np.maximum(fastest, FASTEST))[:, None]
    return Gains(kp=weaker * kp, kd=weaker * kd)


def _inertias(scene: Scene, q: np.ndarray, phases: np.ndarray) -> np.ndarray:
    """Mass matrices (n, nv, nv) in postures (n, nq), with payloads of phases, in MuJoCo's coordinates."""
    mujoco, model = mujoco_package(), copy.copy(scene.compiled)
    data, matrices = mujoco.MjData(model), np.zeros((len(q), model.nv, model.nv))
    every, carried = scene.coordinates.to_mujoco(q), -1
    for qpos, phase, matrix in zip(every, phases, matrices, strict=True):
        if phase != carried:  # the masses of the plan: the feedback does not know others
            write_inertias(model, scene.site.models[int(phase)])
            carried = phase
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_crb(model, data)
        mujoco.mj_fullM(model, data, matrix)
    return matrices


def _holding(scene: Scene, active: np.ndarray) -> np.ndarray:
    """Stiffness (n, nu) with which legs hold up the body, for active contacts (n, nc); zero elsewhere."""
    robot, units = scene.robot, scene.units
    actuated = robot.actuated_rows
    holding = np.zeros((len(active), len(actuated)))
    if robot.base == "fixed":
        return holding
    standing = np.maximum(active.sum(axis=1), 1)
    force = units.generalized_force(robot.model)[actuated]
    stiffness = STIFFER * np.where(force == units.weight, force / units.length, force)  # N/m, or N m
    for contact, frame in enumerate(robot.description.frames):
        moved = np.flatnonzero(np.isin(actuated, list(moving_rows(robot.model, frame))))
        held = np.where(active[:, contact, None], stiffness[moved] / standing[:, None], 0.0)
        holding[:, moved] = np.maximum(holding[:, moved], held)
    return holding
