"""The solution of a reduced problem as one of the whole robot: every sample, torques anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trajopt.extraction import robot_meta
from trajopt.model_quantities import generalized_force
from trajopt.problem import Problem
from trajopt.robot import Robot
from trajopt.scene_reduction import Reduction
from trajopt.schemes import scheme
from trajopt.solution import Solution


def lifted(solution: Solution, problem: Problem, reduction: Reduction) -> Solution:
    """Return the motion of the whole robot of ``problem`` that a small robot's ``solution`` stands for.

    Configurations, rates and contact wrenches follow from the reduction. Torques are the actuated rows of
    numeric RNEA - J^T f of the whole robot, at the collocation points, interpolated to the nodes as everywhere:
    so they hold locked joints too, and its base rows show what the reduction left out.
    """
    whole = reduction.whole
    q = np.array([reduction.lift_q(row) for row in solution.q])
    v, a = solution.v @ reduction.rates.T, solution.a @ reduction.rates.T
    f = reduction.lift_forces(solution.f)
    phases = problem.schedule.phases
    active = [[contact.name in phase.contacts for contact in whole.contacts] for phase in phases]
    impulse = None if solution.impulse is None else reduction.lift_forces(solution.impulse)
    return replace(
        solution,
        meta={
            **{key: value for key, value in solution.meta.items() if key != "drives"},
            **robot_meta(problem),
        },
        model_text=whole.limited_model().saveToString(),
        q=q,
        v=v,
        a=a,
        f=f,
        tau=_torques(solution, whole, (q, v, a), f),
        active=np.array(active, dtype=bool).reshape(len(phases), -1)[solution.phase],
        impulse=impulse,
    )


def _torques(
    solution: Solution, robot: Robot, motion: tuple[np.ndarray, np.ndarray, np.ndarray], f: np.ndarray
) -> np.ndarray:
    model, data = robot.model, robot.model.createData()
    frames = [model.getFrameId(contact.frame) for contact in robot.contacts]
    ends = scheme(solution.meta["transcription"]).interpolation(np.array([0.0, 1.0]))
    found = np.zeros((solution.n_samples, robot.nu))
    for rows in solution.intervals:
        samples = list(rows)
        inner = [k for k in samples if solution.collocation[k]]
        points = np.array(
            [
                generalized_force(model, data, (motion[0][k], motion[1][k], motion[2][k]), frames, f[k])
                for k in inner
            ]
        )[:, robot.n_unactuated :]
        found[inner] = points
        found[[samples[0], samples[-1]]] = ends @ points
    return found
