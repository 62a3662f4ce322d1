"""Gains of joint feedback along a plan, from its inertias and from the weight that its legs hold up.

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

import numpy as np

from trajopt.control.reference import ReferenceTrajectory
from trajopt.dynamics.base_joint import base_of
from trajopt.motion.carried import carrying_model
from trajopt.motion.cycles import moving_rows
from trajopt.robot.mujoco_package import mujoco_package
from trajopt.simulation.bodies import write_inertias
from trajopt.simulation.settings import FEEDBACK_TIME, SimulationSettings
from trajopt.simulation.world import World
from trajopt.solution.solution import Solution

# Gains are recomputed after this many periods of the controller, and held in between.
EVERY = 5
# A discrete damper is stable while its rate times the period is below 2; half of that leaves room for delay.
FASTEST = 1.0
# Stiffness of stance legs over that at which the body just falls.
STIFFER = 4.0


@dataclass(frozen=True, kw_only=True)
class Gains:
    """Feedback gains of the actuated rows in n periods, (n, nu); ``rate``: 1/s, of unloaded joints."""

    kp: np.ndarray
    kd: np.ndarray
    rate: float


def gains_of(
    plan: Solution, world: World, reference: ReferenceTrajectory, settings: SimulationSettings
) -> Gains:
    """Gains for every period of a reference."""
    picked = np.arange(0, len(reference.t), EVERY)
    rows = world.coordinates.rows[plan.actuated_rows]
    matrices = _inertias(plan, world, reference, picked)
    inertia = np.diagonal(matrices, axis1=1, axis2=2)[:, rows]
    rate = 1.0 / (FEEDBACK_TIME * world.units.time)
    kp = np.maximum(rate**2 * inertia, _holding(plan, world, reference.active[picked]))
    kd = 2 * np.sqrt(kp * inertia)
    response = np.linalg.inv(matrices)[:, rows[:, None], rows] * kd[:, None, :] * reference.period
    fastest = np.abs(np.linalg.eigvals(response)).max(axis=1, initial=0.0)
    weaker = np.minimum(1.0, FASTEST / np.maximum(fastest, FASTEST))[:, None]
    spread = np.arange(len(reference.t)) // EVERY
    return Gains(kp=settings.kp * (weaker * kp)[spread], kd=settings.kd * (weaker * kd)[spread], rate=rate)


def _inertias(plan: Solution, world: World, reference: ReferenceTrajectory, picked: np.ndarray) -> np.ndarray:
    """Mass matrices (n, nv, nv) of the picked periods, with payloads, in MuJoCo's coordinates."""
    mujoco, model = mujoco_package(), copy.copy(world.compiled)
    data, matrices = mujoco.MjData(model), np.zeros((len(picked), model.nv, model.nv))
    phases, carried = reference.source[picked], -1
    for qpos, phase, matrix in zip(
        world.coordinates.to_mujoco(reference.q[picked]), phases, matrices, strict=True
    ):
        if phase != carried:  # the masses of the plan: the feedback does not know others
            write_inertias(model, carrying_model(plan, int(phase)))
            carried = phase
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_crb(model, data)
        mujoco.mj_fullM(model, data, matrix)
    return matrices


def _holding(plan: Solution, world: World, active: np.ndarray) -> np.ndarray:
    """Stiffness (n, nu) with which legs hold up the body, for active contacts (n, nc); zero elsewhere."""
    holding = np.zeros((len(active), len(plan.actuated_rows)))
    if base_of(plan.model) == "fixed":
        return holding
    standing = np.maximum(active.sum(axis=1), 1)
    units, actuated = world.units, plan.actuated_rows
    force = units.generalized_force(plan.model)[actuated]
    stiffness = STIFFER * np.where(force == units.weight, force / units.length, force)  # N/m, or N m
    for contact, frame in enumerate(plan.contact_frames):
        moved = np.flatnonzero(np.isin(actuated, list(moving_rows(plan.model, frame))))
        held = np.where(active[:, contact, None], stiffness[moved] / standing[:, None], 0.0)
        holding[:, moved] = np.maximum(holding[:, moved], held)
    return holding
