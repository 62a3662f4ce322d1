"""Crocoddyl's half of the comparison: its own gaits, its own solvers, and what its torques do.

Runs where Crocoddyl is installed, see `scripts/compare_crocoddyl.py`.
"""

import time
from dataclasses import dataclass
from functools import cache
from typing import Any

import crocoddyl
import example_robot_data
import mim_solvers
import numpy as np
import pinocchio as pin
from crocoddyl.utils.quadruped import SimpleQuadrupedalGaitProblem

from scripts.peers.tasks import Gait, Task

# Steps of the integration in one step of a plan.
FINER = 20
SOLVERS = {"FDDP": crocoddyl.SolverFDDP, "BoxFDDP": crocoddyl.SolverBoxFDDP, "mim SQP": mim_solvers.SolverSQP}
KINDS = {"walk": "Walking", "trot": "Trotting", "pace": "Pacing", "bound": "Bounding"}
ROBOTS = {
    "anymal_b": ("anymal", ("LF_FOOT", "RF_FOOT", "LH_FOOT", "RH_FOOT")),
    "solo12": ("solo12", ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")),
}
# What both halves call the same robot differs at most by this, kg, rad.
SAME = 1e-9


@dataclass(frozen=True, kw_only=True)
class Solved:
    """Time of a solve in s, iterations, whether it converged, and its states and controls."""

    seconds: float
    iterations: int
    converged: bool
    xs: list[np.ndarray]
    us: list[np.ndarray]


def robot_of(task: Task) -> str:
    """Our name of a task's robot."""
    return "anymal_b" if isinstance(task, Gait) else task.robot


@cache
def _model(robot: str) -> pin.Model:
    return example_robot_data.load(ROBOTS[robot][0]).model


def adopt(task: Task, described: dict[str, Any]) -> None:
    """Check that our robot is the same; for a robot without an example of Crocoddyl's take our posture.

    The feet stand on the ground, as `createJumpingProblem` assumes.
    """
    robot = robot_of(task)
    model = _model(robot)
    masses = [inertia.mass for inertia in model.inertias]
    if not np.allclose(masses, described["masses"], rtol=0, atol=SAME):
        raise SystemExit(f"{robot} differs between the sides: masses {masses}, {described['masses']}")
    posture = np.array(described["posture"])
    if robot == "anymal_b":
        if not np.allclose(model.referenceConfigurations["standing"][7:], posture[7:], rtol=0, atol=SAME):
            raise SystemExit("ANYmal does not stand in the same posture on both sides")
        return
    data = model.createData()
    pin.framesForwardKinematics(model, data, posture)
    posture[2] -= data.oMf[model.getFrameId(ROBOTS[robot][1][0])].translation[2]
    model.referenceConfigurations["standing"] = posture
    limits = model.effortLimit.copy()
    limits[6:] = task.torque_limit
    model.effortLimit = limits


def start_of(task: Task) -> np.ndarray:
    """The state at the start: standing at rest."""
    model = _model(robot_of(task))
    return np.concatenate([model.referenceConfigurations["standing"], np.zeros(model.nv)])


def build(task: Task, step: float) -> crocoddyl.ShootingProblem:
    """Crocoddyl's problem with knots of ``step`` s; durations are rounded to whole knots."""
    feet = ROBOTS[robot_of(task)][1]
    gait, start = SimpleQuadrupedalGaitProblem(_model(robot_of(task)), *feet), start_of(task)
    if isinstance(task, Gait):
        create = getattr(gait, f"create{KINDS[task.name]}Problem")
        knots = round(task.step / step), round(task.support / step)
        return create(start, task.length, task.height, step, *knots)
    ground, up = round(task.ground / step), round(task.flight / 2 / step)
    return gait.createJumpingProblem(start, task.height, list(task.distance), step, ground, up)


def solve(problem: crocoddyl.ShootingProblem, solver: str, threads: int, most: int) -> Solved:
    """Solve as the examples do: from standing still and the torques that this takes."""
    problem.nthreads = threads
    own = SOLVERS[solver](problem)
    own.setCallbacks([])
    xs = [problem.x0] * (problem.T + 1)
    us = list(problem.quasiStatic([problem.x0] * problem.T))
    begun = time.perf_counter()
    converged = own.solve(xs, us, most, False)
    seconds = time.perf_counter() - begun
    xs, us = ([value.copy() for value in values] for values in (own.xs, own.us))
    return Solved(seconds=seconds, iterations=own.iter, converged=bool(converged), xs=xs, us=us)


def errors(problem: crocoddyl.ShootingProblem, solved: Solved) -> dict[str, float]:
    """Integrate the torques with Crocoddyl's own models by Runge and Kutta's method: base off the plan, m.

    From start to end without correction, torques constant over a knot, impulses by its own model; also
    the largest torque, N m.
    """
    x, apart, torque = problem.x0.copy(), [], 0.0
    for model, u, planned in zip(problem.runningModels, solved.us, solved.xs[1:], strict=True):
        x = _advanced(model, x, u)
        apart.append(float(np.linalg.norm(x[:3] - planned[:3])))
        torque = max(torque, float(np.abs(u).max(initial=0.0)))
    finite = [value if np.isfinite(value) else np.inf for value in apart]
    return {"end": finite[-1], "largest": max(finite), "torque": torque}


def _advanced(model: Any, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    fine, count = model, 1
    if isinstance(model, crocoddyl.IntegratedActionModelEuler) and model.dt > 0:
        control = crocoddyl.ControlParametrizationModelPolyZero(model.nu)
        rule, count = crocoddyl.RKType.four, FINER
        fine = crocoddyl.IntegratedActionModelRK(model.differential, control, rule, model.dt / FINER)
    data = fine.createData()
    for _ in range(count):
        fine.calc(data, x, u)
        x = data.xnext.copy()
    return x
