# /// script
# requires-python = ">=3.11"
# dependencies = [
#     "dymos==1.15.1",
#     "openmdao==3.45.1",
#     "cyipopt-wheels==1.7.0.dev0",
#     "numpy>=2",
#     "scipy>=1.14",
# ]
# ///
"""Dymos' half of `scripts/compare_collocation.py`: requests as lines of JSON on stdin, answers on stdout.

{"do": "build", "task": {...}}                                our description of the cart-pole
{"do": "solve", "method": "Radau", "intervals": 20}           see `scripts.peers.plans`

Dynamics, their derivatives, scales and options of IPOPT are those of Dymos' own example. pyOptSparse, through
which Dymos reaches IPOPT, is not on PyPI: `Ipopt` hands it the same values and sparse derivatives, coloured
by OpenMDAO. The build includes the colouring.
"""

import contextlib
import os
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

os.environ |= {"OMP_NUM_THREADS": "1", "OPENMDAO_REPORTS": "0", "OPENMDAO_WORKDIR": tempfile.mkdtemp()}
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import cyipopt
import dymos as dm
import numpy as np
import openmdao.api as om
from dymos.examples.cart_pole.cartpole_dynamics import CartPoleDynamics
from numpy.polynomial import Polynomial
from scipy.interpolate import BarycentricInterpolator, CubicHermiteSpline

from scripts.peers.halves import answer
from scripts.peers.plans import TOLD, Stopwatch, plan, times_told

SCHEMES = {"Radau": dm.Radau, "GaussLobatto": dm.GaussLobatto}
ORDER = 3
OPTIONS = {"tol": 1e-6, "acceptable_iter": 0, "max_iter": 1000, "print_level": 0, "sb": "yes"}
OPTIONS |= {"mu_init": 0.1, "nlp_scaling_method": "gradient-based", "alpha_for_y": "safer-min-dual-infeas"}
CONTROL_UNIT = 0.01
# Rates and units of the states, in our order.
STATES = {
    "x": ("x_dot", "m"),
    "theta": ("theta_dot", "rad"),
    "x_dot": ("x_dotdot", "m/s"),
    "theta_dot": ("theta_dotdot", "rad/s"),
}
PARAMETERS = {"m_cart": (1.0, "kg"), "m_pole": (0.3, "kg"), "l_pole": (0.5, "m")}


class Ipopt(om.ScipyOptimizeDriver):
    """A problem of OpenMDAO as cyipopt asks for it; the Hessian is a quasi-Newton approximation."""

    def prepare(self) -> None:
        """Colour the derivatives, and find where they are."""
        self._problem().run_model()
        self._problem().get_total_coloring(self._coloring_info, run_model=False)
        self._here, self.start = np.empty(0), self._joined(self.get_design_var_values())
        pattern = self._totals(self.start + np.random.default_rng(0).normal(size=len(self.start)))
        self.places = np.nonzero(pattern[1:])

    def solve(self) -> bool:
        """Solve from the start; whether IPOPT converged."""
        low, high = self._bounds("design_var", self._designvars)
        least, most = self._bounds("constraint", self._cons)
        nlp = cyipopt.Problem(n=len(low), m=len(least), problem_obj=self, lb=low, ub=high, cl=least, cu=most)
        for name, value in OPTIONS.items():
            nlp.add_option(name, value)
        x, info = nlp.solve(self.start)
        self._move(x)
        return bool(info["status"] == 0)

    def _bounds(self, kind: str, metadata: dict[str, Any]) -> list[np.ndarray]:
        sides: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])
        known = self._autoscaler.get_bounds_scaling(kind)
        for name, meta in metadata.items():
            equal = known[name].equals
            for side, value, missing in zip(
                sides, (known[name].lower, known[name].upper), (-np.inf, np.inf), strict=True
            ):
                value = equal if equal is not None else missing if value is None else value
                side.append(np.broadcast_to(value, meta["size"]))
        return [np.concatenate(side) for side in sides]

    def _joined(self, values: dict[str, Any]) -> np.ndarray:
        return np.concatenate([np.ravel(value) for value in values.values()])

    def _move(self, x: np.ndarray) -> None:
        if not np.array_equal(x, self._here):
            self._here, self._derivatives = x.copy(), np.empty(0)
            self._vectors["design_var"].set_data(x, driver_scaling=True)
            self._set_design_vars(driver_scaling=True)
            self._run_solve_nonlinear()

    def _totals(self, x: np.ndarray) -> np.ndarray:
        self._move(x)
        if not self._derivatives.size:
            rows = [*self._objs, *self._cons]
            found = self._compute_totals(of=rows, wrt=list(self._designvars), return_format="array")
            self._derivatives = np.array(found)
        return self._derivatives

    def objective(self, x: np.ndarray) -> float:
        """Value."""
        self._move(x)
        return float(self._joined(self.get_objective_values())[0])

    def constraints(self, x: np.ndarray) -> np.ndarray:
        """Values."""
        self._move(x)
        return self._joined(self.get_constraint_values())

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """Of the objective."""
        return self._totals(x)[0]

    def jacobianstructure(self) -> tuple[np.ndarray, ...]:
        """Rows and columns."""
        return self.places

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Values there."""
        return self._totals(x)[1:][self.places]


_TASK: dict[str, Any] = {}


def build(task: dict[str, Any]) -> dict[str, Any]:
    """Take the task, which the requests that follow are about."""
    _TASK.update(task)
    return {}


@cache
def transcribed(method: str, intervals: int) -> tuple[om.Problem, dm.Phase, float]:
    """The problem of Dymos' example, with a free force at the end, and the time to build it, s."""
    with Stopwatch() as watch, contextlib.redirect_stdout(sys.stderr):
        problem, duration, force = om.Problem(driver=Ipopt()), _TASK["duration"], _TASK["torque"][0]
        scheme = SCHEMES[method](num_segments=intervals, order=ORDER, compressed=True)
        phase = dm.Phase(transcription=scheme, ode_class=CartPoleDynamics)
        problem.model.add_subsystem("traj", dm.Trajectory()).add_phase("phase", phase)
        phase.set_time_options(fix_initial=True, fix_duration=True, duration_val=duration, units="s")
        for name, (rate, unit) in STATES.items():
            track = {"lower": _TASK["lower"][0], "upper": _TASK["upper"][0]} if name == "x" else {}
            phase.add_state(name, fix_initial=True, rate_source=rate, units=unit, shape=(1,), **track)
        phase.add_state("effort", fix_initial=True, rate_source="e_dot", units="N**2*s", shape=(1,))
        shape = {"ref": CONTROL_UNIT, "units": "N", "shape": (1,)}
        phase.add_control("f", rate_continuity=False, lower=-force, upper=force, **shape)
        for name, (value, unit) in PARAMETERS.items():
            phase.add_parameter(name, val=value, units=unit, static_target=True)
        for name, value in zip(STATES, [*_TASK["last"], 0.0, 0.0], strict=True):
            phase.add_boundary_constraint(name, loc="final", equals=value, units=STATES[name][1])
        phase.add_timeseries_output(["x_dotdot", "theta_dotdot"])
        phase.add_objective("effort", loc="final")
        problem.driver.declare_coloring(show_summary=False)
        problem.setup(check=False)
        phase.set_time_val(initial=0.0)
        ends = list(zip(_TASK["first"], _TASK["last"], strict=True))
        rates = [(0.0, (last - first) / duration) for first, last in ends]
        for name, values in zip([*STATES, "effort"], [*ends, *rates, (0.0, 0.0)], strict=True):
            phase.set_state_val(name, vals=values, time_vals=[0.0, duration])
        phase.set_control_val("f", vals=[0.0, 0.0], time_vals=[0.0, duration], units="N")
        problem.final_setup()
        problem.driver.prepare()
    return problem, phase, watch.seconds


def solve(method: str, intervals: int) -> dict[str, Any]:
    """Solve from the guess: positions straight, forces zero."""
    problem, phase, built = transcribed(method, intervals)
    with Stopwatch() as watch, contextlib.redirect_stdout(sys.stderr):
        solved = problem.driver.solve()
    read = {name: problem.get_val(f"traj.phase.timeseries.{name}")[:, 0] for name in ("time", "f", *STATES)}
    states = np.column_stack([read[name] for name in STATES])
    rates = (problem.get_val(f"traj.phase.timeseries.{rate}")[:, 0] for rate, _ in STATES.values())
    slopes = np.column_stack(list(rates))
    breaks, inputs, told = [0.0], [], [states[:1]]
    for low, high in phase.options["transcription"].grid_data.segment_indices:
        ends, x = [low, high - 1], states[low:high]
        begin, end = read["time"][ends]
        part = (read["time"][low:high] - begin) / (end - begin)
        fit = Polynomial.fit(part, read["f"][low:high], high - low - 1, domain=[0, 1], window=[0, 1])
        inputs.append(fit.coef[:, None])
        hermite = CubicHermiteSpline([0.0, 1.0], states[ends], (end - begin) * slopes[ends])
        told.append((BarycentricInterpolator(part, x) if method == "Radau" else hermite)(TOLD))
        breaks.append(end)
    edges = np.array(breaks)
    given = {"build": built, "watch": watch, "solved": solved, "breaks": edges, "inputs": inputs}
    return plan(**given, times=times_told(edges), states=np.vstack(told))


if __name__ == "__main__":
    answer({"build": build, "solve": solve})
