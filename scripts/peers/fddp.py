# /// script
# requires-python = ">=3.11"
# dependencies = ["crocoddyl==3.2.1", "pin==4.0.0", "numpy>=2"]
# ///
"""Crocoddyl's half of `scripts.measure fddp`: requests as lines of JSON on stdin, answers on stdout.

{"do": "build", "name": ..., "model": [...], "mass_matrix": [...], "feet": [...], "friction": ...,
 "weights": {...}, "start": [...],
 "knots": [{"step", "standing", "landed", "state", "places", "factors"}, ...]}    solve from the start at rest
{"do": "iterate", "name": ..., "starts": [[...], ...]}    seconds of one iteration of FDDP and of its parts

A model is a list of joints, as Crocoddyl's Pinocchio reads no text of a newer one. A state is q, v. The last
knot is the end. Runs where Crocoddyl is installed: uv makes an environment for this script alone.
"""

import itertools
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = "1"
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import crocoddyl
import numpy as np
import pinocchio as pin

from scripts.peers.halves import answer

# Velocities of contacts decay at this rate, 1/s, as in Crocoddyl's examples, but by half a knot at most.
DECAY = 50.0
# Most iterations of the solve from the start.
MOST = 200
FACETS = 4
# Relative difference of mass matrices: rounding.
SAME = 1e-9


@dataclass(frozen=True, kw_only=True)
class Built:
    """A problem that is solved: its solver, states and controls, and what the solve found."""

    solver: crocoddyl.SolverFDDP
    xs: list[np.ndarray]
    us: list[np.ndarray]
    found: dict[str, Any]


def _model(joints: list[dict[str, Any]]) -> pin.Model:
    model = pin.Model()
    for joint in joints:
        kind = getattr(pin, joint["kind"])
        own = kind(np.array(joint["axis"])) if joint["axis"] else kind()
        number = model.addJoint(joint["parent"], own, pin.SE3(np.array(joint["place"])), joint["name"])
        inertia = pin.Inertia(joint["mass"], np.array(joint["lever"]), np.array(joint["inertia"]))
        model.appendBodyToJoint(number, inertia, pin.SE3.Identity())
    return model


class Problem:
    """The shooting problem of a horizon."""

    def __init__(self, request: dict[str, Any]) -> None:
        self.model = _model(request["model"])
        self.frames = [self._add_frame(foot) for foot in request["feet"]]
        self.state = crocoddyl.StateMultibody(self.model)
        self.actuation = crocoddyl.ActuationModelFloatingBase(self.state)
        self.nu = self.actuation.nu
        self.feet, self.friction, self.weights = request["feet"], request["friction"], request["weights"]
        self.start, self.knots = np.array(request["start"]), request["knots"]
        upper = np.triu(pin.crba(self.model, self.model.createData(), self.start[: self.model.nq]))
        mass = upper + np.triu(upper, 1).T
        if not np.allclose(mass, request["mass_matrix"], rtol=SAME, atol=SAME):
            raise SystemExit("the robot is not the same on both sides")

    def _add_frame(self, foot: dict[str, Any]) -> int:
        joint, place = foot["joint"], pin.SE3(np.array(foot["place"]))
        return int(self.model.addFrame(pin.Frame(foot["frame"], joint, place, pin.FrameType.OP_FRAME)))

    def shooting(self) -> crocoddyl.ShootingProblem:
        """All knots; the cost of the end counts as that of a knot as long as the last."""
        running = [
            crocoddyl.IntegratedActionModelEuler(self._dynamics(knot), knot["step"])
            for knot in self.knots[:-1]
        ]
        end = crocoddyl.IntegratedActionModelEuler(self._dynamics(self.knots[-1], last=True), 0.0)
        problem = crocoddyl.ShootingProblem(self.start, running, end)
        problem.nthreads = 1
        return problem

    def _dynamics(
        self, knot: dict[str, Any], *, last: bool = False
    ) -> crocoddyl.DifferentialActionModelContactFwdDynamics:
        contacts = crocoddyl.ContactModelMultiple(self.state, self.nu)
        costs = crocoddyl.CostModelSum(self.state, self.nu)
        self._add_motion(costs, knot, knot["step"] if last else 1.0)
        for number, foot in enumerate(self.feet):
            if number in knot["standing"]:
                self._add_contact(contacts, number, knot["step"])
                self._add_cone(costs, number, foot)
                if number in knot["landed"]:
                    self._add_landing(costs, knot, number)
            else:
                self._add_swing(costs, knot, number, knot["step"] if last else 1.0)
        return crocoddyl.DifferentialActionModelContactFwdDynamics(
            self.state, self.actuation, contacts, costs, 0.0, True
        )

    def _add_motion(self, costs: crocoddyl.CostModelSum, knot: dict[str, Any], factor: float) -> None:
        weights = crocoddyl.ActivationModelWeightedQuad(np.array(self.weights["state"]))
        state = crocoddyl.ResidualModelState(self.state, np.array(knot["state"]), self.nu)
        control = crocoddyl.ResidualModelControl(self.state, self.nu)
        costs.addCost("state", crocoddyl.CostModelResidual(self.state, weights, state), factor)
        costs.addCost("control", crocoddyl.CostModelResidual(self.state, control), self.weights["control"])

    def _add_contact(self, contacts: crocoddyl.ContactModelMultiple, number: int, step: float) -> None:
        frame, axes = self.frames[number], pin.LOCAL_WORLD_ALIGNED
        gains = np.array([0.0, min(DECAY, 0.5 / step)])
        if self.feet[number]["kind"] == "surface":
            data = self.model.createData()
            pin.framesForwardKinematics(self.model, data, self.start[: self.model.nq])
            place = data.oMf[frame]
            contact = crocoddyl.ContactModel6D(self.state, frame, place, axes, self.nu, gains)
        else:
            contact = crocoddyl.ContactModel3D(self.state, frame, np.zeros(3), axes, self.nu, gains)
        contacts.addContact(f"{number}", contact)

    def _add_cone(self, costs: crocoddyl.CostModelSum, number: int, foot: dict[str, Any]) -> None:
        frame, level = self.frames[number], np.eye(3)
        if foot["kind"] == "surface":
            box = np.array(foot["box"])
            cone = crocoddyl.WrenchCone(level, self.friction, box, FACETS, True, 0.0)
            residual = crocoddyl.ResidualModelContactWrenchCone(self.state, frame, cone, self.nu)
        else:
            cone = crocoddyl.FrictionCone(level, self.friction, FACETS, True, 0.0)
            residual = crocoddyl.ResidualModelContactFrictionCone(self.state, frame, cone, self.nu)
        barrier = crocoddyl.ActivationModelQuadraticBarrier(crocoddyl.ActivationBounds(cone.lb, cone.ub))
        cost = crocoddyl.CostModelResidual(self.state, barrier, residual)
        costs.addCost(f"cone {number}", cost, self.weights["cone"])

    def _add_swing(
        self, costs: crocoddyl.CostModelSum, knot: dict[str, Any], number: int, factor: float
    ) -> None:
        frame, factors = self.frames[number], np.array(knot["factors"][number])
        weights = crocoddyl.ActivationModelWeightedQuad(factors**2)
        place = np.array(knot["places"][number])
        residual = crocoddyl.ResidualModelFrameTranslation(self.state, frame, place, self.nu)
        cost = crocoddyl.CostModelResidual(self.state, weights, residual)
        costs.addCost(f"swing {number}", cost, factor * self.weights["foot"])
        if self.feet[number]["kind"] == "surface":
            turn = pin.Quaternion(np.array(knot["state"][3:7])).toRotationMatrix()
            rotation = crocoddyl.ResidualModelFrameRotation(self.state, frame, turn, self.nu)
            cost = crocoddyl.CostModelResidual(self.state, rotation)
            costs.addCost(f"sole {number}", cost, factor * self.weights["sole"])

    def _add_landing(self, costs: crocoddyl.CostModelSum, knot: dict[str, Any], number: int) -> None:
        """Height of a foot as its stance begins, and its velocity then, for an instant of this knot."""
        frame, place = self.frames[number], np.array(knot["places"][number])
        height = crocoddyl.ActivationModelWeightedQuad(np.array([0.0, 0.0, 1.0]))
        residual = crocoddyl.ResidualModelFrameTranslation(self.state, frame, place, self.nu)
        cost = crocoddyl.CostModelResidual(self.state, height, residual)
        costs.addCost(f"height {number}", cost, self.weights["landing"] / knot["step"])
        linear = crocoddyl.ActivationModelWeightedQuad(np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]))
        rest = crocoddyl.ResidualModelFrameVelocity(
            self.state, frame, pin.Motion.Zero(), pin.LOCAL_WORLD_ALIGNED, self.nu
        )
        cost = crocoddyl.CostModelResidual(self.state, linear, rest)
        costs.addCost(f"rest {number}", cost, self.weights["touchdown"] / knot["step"])


_BUILT: dict[str, Built] = {}


def build(name: str, **request: Any) -> dict[str, Any]:
    """Solve from the start held and the torques that this takes; what the solution is."""
    own = Problem(request)
    problem = own.shooting()
    solver = crocoddyl.SolverFDDP(problem)
    still = own.start.copy()
    still[own.model.nq :] = 0.0
    xs = [own.start] + [still] * problem.T
    us = list(problem.quasiStatic([still] * problem.T))
    converged = solver.solve(xs, us, MOST, False)
    xs, us = [x.copy() for x in solver.xs], [u.copy() for u in solver.us]
    problem.calc(xs, us)
    found = {"converged": bool(converged), "iterations": solver.iter, "cost": solver.cost}
    found |= {"knots": problem.T, **_described(own, problem, xs, us)}
    _BUILT[name] = Built(solver=solver, xs=xs, us=us, found=found)
    return found


def _described(
    own: Problem, problem: crocoddyl.ShootingProblem, xs: list[np.ndarray], us: list[np.ndarray]
) -> dict[str, Any]:
    """Figures of a solution: what stands, mean load over the weight, slip, lift, speed, largest torque."""
    model, data = own.model, own.model.createData()
    standing, loads, slips, heights = [], [], [], []
    for action, knot, x in zip(problem.runningDatas, own.knots, xs, strict=False):
        contacts = action.differential.multibody.contacts.contacts.todict()
        standing.append(len(contacts))
        pin.forwardKinematics(model, data, x[: model.nq], x[model.nq :])
        pin.updateFramePlacements(model, data)
        load = np.zeros(3)
        for number, frame in enumerate(own.frames):
            if number in knot["standing"]:
                force = contacts[f"{number}"].f.linear
                load += force
                slips.append(float(np.hypot(*force[:2]) / max(force[2], 1e-9)))
            else:
                heights.append(float(data.oMf[frame].translation[2]))
        loads.append(float(load[2]))
    weight = np.linalg.norm(model.gravity.linear) * pin.computeTotalMass(model)
    steps = [knot["step"] for knot in own.knots[:-1]]
    return {
        "standing": [[count, len(list(same))] for count, same in itertools.groupby(standing)],
        "load": float(np.average(loads, weights=steps) / weight),
        "slip": max(slips),
        "lift": max(heights) - min(heights),
        "speed": float((xs[-1][0] - xs[0][0]) / sum(steps)),
        "height": [float(x[2]) for x in (xs[0], xs[-1])],
        "torque": max(float(np.abs(u).max()) for u in us),
    }


def iterate(name: str, starts: list[list[float]]) -> dict[str, Any]:
    """Seconds of an iteration from the solution to each of these starts, of its parts; accepted steps."""
    built = _BUILT[name]
    solver, problem = built.solver, built.solver.problem
    answer: dict[str, list[float]] = {
        "whole": [],
        "derivatives": [],
        "backward": [],
        "forward": [],
        "steps": [],
    }
    for start in starts:
        problem.x0 = np.array(start)
        answer["whole"].append(_seconds(lambda: solver.solve(built.xs, built.us, 1, False)))
        answer["steps"].append(solver.stepLength)
        solver.setCandidate(built.xs, built.us, False)
        answer["derivatives"].append(_seconds(solver.calcDiff))
        answer["backward"].append(_seconds(solver.backwardPass))
        answer["forward"].append(_seconds(lambda: solver.forwardPass(1.0)))
    return answer


def _seconds(act: Callable[[], Any]) -> float:
    begun = time.thread_time()
    act()
    return time.thread_time() - begun


ANSWERS: dict[str, Callable[..., dict[str, Any]]] = {"build": build, "iterate": iterate}


if __name__ == "__main__":
    answer(ANSWERS)
