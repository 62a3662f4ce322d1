# /// script
# requires-python = ">=3.11"
# dependencies = ["drake==1.51.1", "numpy>=2"]
# ///
"""Drake's half of `scripts/compare_collocation.py`: requests as lines of JSON on stdin, answers on stdout.

{"do": "build", "task": {...}}                                our description of an arm or a pendulum
{"do": "solve", "method": "SNOPT", "intervals": 20}           see `scripts.peers.plans`

`DirectCollocation` with equal steps: states are cubic and torques straight between its nodes.
"""

import os
import sys
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = "1"
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import MultibodyForces
from pydrake.planning import DirectCollocation
from pydrake.solvers import IpoptSolver, SnoptSolver, SolverOptions
from pydrake.trajectories import PiecewisePolynomial

from scripts.peers.halves import answer
from scripts.peers.plans import Stopwatch, lines, numbers, plan, times_told

TOLERANCE, MOST = 1e-6, 1000
SOLVERS = {"SNOPT": SnoptSolver, "IPOPT": IpoptSolver}
OPTIONS = {
    "SNOPT": {
        "Major optimality tolerance": TOLERANCE,
        "Major feasibility tolerance": TOLERANCE,
        "Major iterations limit": MOST,
        "Iterations limit": 1000 * MOST,
    },
    # Drake's own defaults are looser.
    "IPOPT": {"tol": TOLERANCE, "constr_viol_tol": TOLERANCE, "acceptable_iter": 0, "max_iter": MOST},
}
# Where SNOPT gets scales of variables and scales rows itself. Without both it stops at the acrobot with
# numerical trouble or after its iterations; the arm it solves several times faster without.
SCALED = {"acrobot"}


class Arm:
    """A task's plant: the joints of its URDF, and a motor on each that has one."""

    def __init__(self, task: dict[str, Any]) -> None:
        self.task, self.plant = task, MultibodyPlant(time_step=0.0)
        (robot,) = Parser(self.plant).AddModelsFromString(task["urdf"], "urdf")
        if 'name="world"' not in task["urdf"]:
            base = self.plant.GetBodyByName("base_link").body_frame()
            self.plant.WeldFrames(self.plant.world_frame(), base)
        for name in task["actuated"]:
            self.plant.AddJointActuator(name, self.plant.GetJointByName(name))
        self.plant.Finalize()
        names = [self.plant.get_joint(index).name() for index in self.plant.GetJointIndices(robot)]
        if [name for name in names if name in task["joints"]] != task["joints"]:
            raise SystemExit(f"Drake orders joints differently: {names}")

    def transcribed(self, intervals: int) -> DirectCollocation:
        """The problem; its cost by Drake's own trapezoidal rule, as quadratic costs, for steps are fixed."""
        task, plant = self.task, self.plant
        step, port = task["duration"] / intervals, plant.get_actuation_input_port().get_index()
        found = DirectCollocation(plant, plant.CreateDefaultContext(), intervals + 1, step, step, port)
        program, rest = found.prog(), np.zeros(plant.num_velocities())
        rate, torque = numbers(task["rate"], np.inf), numbers(task["torque"], np.inf)
        lower = np.concatenate([numbers(task["lower"], -np.inf), -rate])
        upper = np.concatenate([numbers(task["upper"], np.inf), rate])
        for k in range(intervals + 1):
            share, state, force = step * (0.5 if k in (0, intervals) else 1.0), found.state(k), found.input(k)
            program.AddBoundingBoxConstraint(-torque, torque, force)
            program.AddBoundingBoxConstraint(lower, upper, state)
            program.AddQuadraticCost(2 * share * np.eye(len(force)), 0 * torque, force, is_convex=True)
            if task["name"] in SCALED:
                for variable, unit in zip([*state[len(rest) :], *force], [*rate, *torque], strict=True):
                    program.SetVariableScaling(variable, unit)
        first, last = np.array(task["first"]), np.array(task["last"])
        for k, q in ((0, first), (intervals, last)):
            end = np.concatenate([q, rest])
            program.AddBoundingBoxConstraint(end, end, found.state(k))
        rates, times = (last - first) / task["duration"], np.linspace(0.0, task["duration"], intervals + 1)
        states = np.array([np.concatenate([first + t * rates, rates]) for t in times])
        found.SetInitialTrajectory(
            PiecewisePolynomial.FirstOrderHold(times, self._carrying(states).T),
            PiecewisePolynomial.FirstOrderHold(times, states.T),
        )
        return found

    def _carrying(self, states: np.ndarray) -> np.ndarray:
        """Torques (n, nu) with which the joints keep their rates in these states (n, 2 nv)."""
        plant, context, found = self.plant, self.plant.CreateDefaultContext(), []
        for state in states:
            plant.SetPositionsAndVelocities(context, state)
            forces = MultibodyForces(plant)
            plant.CalcForceElementsContribution(context, forces)
            moments = plant.CalcInverseDynamics(context, np.zeros(plant.num_velocities()), forces)
            found.append(plant.MakeActuationMatrix().T @ moments)
        return np.array(found)

    def solve(self, method: str, intervals: int) -> dict[str, Any]:
        """Solve from the guess: straight, with the torques that carry it."""
        with Stopwatch() as building:
            found = self.transcribed(intervals)
        solver, options = SOLVERS[method](), SolverOptions()
        for name, value in OPTIONS[method].items():
            options.SetOption(solver.solver_id(), name, value)
        if method == "SNOPT" and self.task["name"] in SCALED:
            options.SetOption(solver.solver_id(), "Scale option", 2)
        with Stopwatch() as watch:
            result = solver.Solve(found.prog(), None, options)
        torques, states = found.ReconstructInputTrajectory(result), found.ReconstructStateTrajectory(result)
        breaks = np.linspace(0.0, self.task["duration"], intervals + 1)
        times = times_told(breaks)
        return plan(
            build=building.seconds,
            watch=watch,
            solved=result.is_success(),
            breaks=breaks,
            inputs=lines(torques.vector_values(breaks).T),
            times=times,
            states=states.vector_values(times).T,
        )


_BUILT: list[Arm] = []


def build(task: dict[str, Any]) -> dict[str, Any]:
    """Take a task, which the requests that follow are about."""
    _BUILT[:] = [Arm(task)]
    return {}


if __name__ == "__main__":
    answer({"build": build, "solve": lambda **what: _BUILT[0].solve(**what)})
