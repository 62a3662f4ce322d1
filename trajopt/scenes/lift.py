"""The solution of a reduced problem as one of the whole robot: samples, forces and torques recomputed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trajopt.dynamics.model_quantities import contact_jacobian, generalized_force
from trajopt.problem.problem import Problem
from trajopt.robot.robot import Robot
from trajopt.scenes.reduction import Reduction
from trajopt.solution.grid import interpolated
from trajopt.solution.solution import Solution
from trajopt.solving.extraction import contact_activity, described_robot

_Trajectory = tuple[np.ndarray, np.ndarray, np.ndarray]


def lift_solution(solution: Solution, problem: Problem, reduction: Reduction) -> Solution:
    """Return the motion of the whole robot of ``problem`` that a small robot's ``solution`` stands for.

    Configurations, rates and contact wrenches follow from the reduction. The halves of a real robot differ a
    little: wrenches of active contacts get the least correction, in natural units, with which the whole
    robot's base rows hold. What contacts cannot provide (all of it in flight) remains as a residual in the
    check. Torques are the actuated rows of numeric RNEA - J^T f, locked joints' too.
    """
    whole = reduction.whole
    q = np.array([reduction.lift_q(row) for row in solution.q])
    motion = (q, solution.v @ reduction.rates.T, solution.a @ reduction.rates.T)
    every = contact_activity(whole, problem.schedule)[solution.phase]
    f = reduction.lift_forces(solution.f)
    if reduction.is_half:
        f = _carrying(solution, whole, motion, f, every)
    return replace(
        solution,
        description=replace(solution.description, **described_robot(problem)),
        model=whole.limited_model(),
        q=q,
        v=motion[1],
        a=motion[2],
        f=f,
        tau=_torques(solution, whole, motion, f),
        active=every,
        impulse=None if solution.impulse is None else reduction.lift_forces(solution.impulse),
        row_multiplier=None,  # those of the small problem do not apply
        row_place=None,
        bound_multiplier=None,
    )


def _carrying(
    solution: Solution, robot: Robot, motion: _Trajectory, f: np.ndarray, active: np.ndarray
) -> np.ndarray:
    """Wrenches (K, nc, 6) nearest to ``f`` whose base rows carry the motion at collocation points."""
    model, data, n = robot.model, robot.model.createData(), robot.n_unactuated
    frames = [model.getFrameId(contact.frame) for contact in robot.contacts]
    units = np.array([1.0] * 3 + [robot.length] * 3)
    corrected = f.copy()
    for k in np.flatnonzero(solution.collocation & active.any(axis=1)):
        state = (motion[0][k], motion[1][k], motion[2][k])
        missing = generalized_force(model, data, state, frames, f[k])[:n]
        chosen = [
            (c, row) for c, row in zip(robot.contacts, range(len(frames)), strict=True) if active[k, row]
        ]
        jacobian = contact_jacobian(model, state[0], [(c.frame, c.rows) for c, _ in chosen])[:, :n]
        scale = np.concatenate([units[list(c.rows)] for c, _ in chosen])
        change = scale * np.linalg.lstsq((scale[:, None] * jacobian).T, missing, rcond=None)[0]
        for contact, row in chosen:
            corrected[k, row, list(contact.rows)] += change[: contact.dimension]
            change = change[contact.dimension :]
    return interpolated(solution, corrected)


def _torques(solution: Solution, robot: Robot, motion: _Trajectory, f: np.ndarray) -> np.ndarray:
    """Actuated rows (K, nu) of RNEA - J^T f at collocation points, interpolated elsewhere."""
    model, data = robot.model, robot.model.createData()
    frames = [model.getFrameId(contact.frame) for contact in robot.contacts]
    forces = np.zeros((solution.n_samples, robot.nv))
    for k in np.flatnonzero(solution.collocation):
        state = (motion[0][k], motion[1][k], motion[2][k])
        forces[k] = generalized_force(model, data, state, frames, f[k])
    return interpolated(solution, forces)[:, robot.n_unactuated :]
