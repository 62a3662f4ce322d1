"""Numeric inverse kinematics for guesses: damped Gauss-Newton on several frames at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.robot import Robot

# A pose, or a position (3,) in m, for each frame by name.
Targets = Mapping[str, pin.SE3 | np.ndarray]

# Levenberg-Marquardt: the damping starts small against joint Jacobians of order one, shrinks on
# success, grows on failure; an error below the tolerance is rounding to a guess.
FIRST_DAMPING = 1e-6
DAMPING_GROWTH = 10.0
MOST_ITERATIONS = 60
TOLERANCE = 1e-10


@dataclass(frozen=True)
class Posture:
    """Result of inverse kinematics: ``q`` (nq,) and the remaining ``error`` (norm, m and rad)."""

    q: np.ndarray
    error: float


def inverse_kinematics(robot: Robot, q: np.ndarray, targets: Targets, *, move_base: bool = False) -> Posture:
    """Posture near ``q`` (nq,) that brings frames to their targets, within position limits.

    A target is a pose (SE3, 6 rows) or a position (3,) in the world, m. The base moves only with
    ``move_base``. What cannot be reached is approached in the least-squares sense.
    """
    model, data = robot.model, robot.model.createData()
    movable = np.arange(0 if move_base else robot.n_unactuated, robot.nv)
    damping, error = FIRST_DAMPING, _errors(model, data, q, targets)
    for _ in range(MOST_ITERATIONS):
        if np.linalg.norm(error) < TOLERANCE or damping > 1 / FIRST_DAMPING:
            break
        jacobian = _jacobian(model, data, q, targets)[:, movable]
        step = np.zeros(robot.nv)
        normal = jacobian.T @ jacobian + damping * np.eye(len(movable))
        step[movable] = -np.linalg.solve(normal, jacobian.T @ error)
        trial = np.clip(pin.integrate(model, q, step), robot.position_lower, robot.position_upper)
        trial_error = _errors(model, data, trial, targets)
        if np.linalg.norm(trial_error) < np.linalg.norm(error):
            q, error, damping = trial, trial_error, damping / DAMPING_GROWTH
        else:
            damping *= DAMPING_GROWTH
    return Posture(q, float(np.linalg.norm(error)))


def _errors(model: pin.Model, data: pin.Data, q: np.ndarray, targets: Targets) -> np.ndarray:
    pin.framesForwardKinematics(model, data, q)
    parts = []
    for name, target in targets.items():
        placement = data.oMf[model.getFrameId(name)]
        if isinstance(target, pin.SE3):
            parts.append(-pin.log6(placement.actInv(target)).vector)
        else:
            parts.append(placement.translation - target)
    return np.concatenate(parts)


def _jacobian(model: pin.Model, data: pin.Data, q: np.ndarray, targets: Targets) -> np.ndarray:
    pin.computeJointJacobians(model, data, q)
    pin.framesForwardKinematics(model, data, q)
    blocks = []
    for name, target in targets.items():
        frame = model.getFrameId(name)
        if isinstance(target, pin.SE3):
            relative = target.actInv(data.oMf[frame])
            blocks.append(pin.Jlog6(relative) @ pin.getFrameJacobian(model, data, frame, pin.LOCAL))
        else:
            blocks.append(pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)[:3])
    return np.concatenate(blocks).reshape(-1, model.nv)  # one joint alone gives vectors
