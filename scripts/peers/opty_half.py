# /// script
# requires-python = ">=3.11"
# dependencies = ["opty==1.5.0", "cyipopt-wheels==1.7.0.dev0", "numpy>=2"]
#
# [tool.uv]
# override-dependencies = ["cyipopt ; sys_platform == 'never'"]
# ///
"""opty's half of `scripts/compare_collocation.py`: requests as lines of JSON on stdin, answers on stdout.

{"do": "build", "task": {...}}                                       our description of Betts' pendulum
{"do": "solve", "method": "DAE, midpoint", "intervals": 100}         see `scripts.peers.plans`

"DAE" is opty's example `plot_betts_10_103_104`: places, velocities and the rod's force, which the second
derivative of the rod's length determines; "angle" has our coordinate. cyipopt, which opty asks for, has no
wheel under that name; cyipopt-wheels is the same with one.
"""

import contextlib
import os
import sys
from functools import cache
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = "1"
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
import sympy as sm
from opty import Problem, create_objective_function
from sympy.physics import mechanics

from scripts.peers.halves import answer
from scripts.peers.plans import Stopwatch, lines, plan

OPTIONS = {"tol": 1e-6, "acceptable_iter": 0, "max_iter": 1000, "print_level": 0, "sb": "yes"}
# As in the example.
OPTIONS |= {"nlp_scaling_method": "gradient-based"}
PLACE_AND_SPEED, ROD = (-5.0, 5.0), (-1.0, 15.0)
GRAVITY = 9.81

T = mechanics.dynamicsymbols._t
U = mechanics.dynamicsymbols("u")
PHI, OMEGA = mechanics.dynamicsymbols("phi, omega")
Y = mechanics.dynamicsymbols("y0:5")
# Our torque turns the other way than the example's u.
EQUATIONS = {
    "angle": [PHI.diff(T) - OMEGA, OMEGA.diff(T) + GRAVITY * sm.cos(PHI) - U],
    "DAE": [
        -Y[0].diff(T) + Y[2],
        -Y[1].diff(T) + Y[3],
        -Y[2].diff(T) - 2 * Y[4] * Y[0] - U * Y[1],
        -Y[3].diff(T) - GRAVITY - 2 * Y[4] * Y[1] + U * Y[0],
        Y[2] ** 2 + Y[3] ** 2 - 2 * Y[4] - GRAVITY * Y[1],
    ],
}
UNKNOWN = {"angle": (PHI, OMEGA), "DAE": Y}

_TASK: dict[str, Any] = {}


def build(task: dict[str, Any]) -> dict[str, Any]:
    """Take the task, which the requests that follow are about."""
    _TASK.update(task)
    return {}


@cache
def transcribed(form: str, rule: str, intervals: int) -> tuple[Problem, np.ndarray, float]:
    """The problem, its guess, straight in the angle with the torque that holds it, and s to build both."""
    with Stopwatch() as watch, contextlib.redirect_stdout(sys.stderr):
        states, duration, count = UNKNOWN[form], _TASK["duration"], intervals + 1
        (first,), (last,) = _TASK["first"], _TASK["last"]
        phi, omega = np.linspace(first, last, count), np.full(count, (last - first) / duration)
        if form == "angle":
            guess, bounds = [phi, omega], None
            ends = [PHI.func(0.0) - first, PHI.func(duration) - last, OMEGA.func(0.0), OMEGA.func(duration)]
        else:
            x, y = np.cos(phi), np.sin(phi)
            guess = [x, y, -omega * y, omega * x, (omega**2 - GRAVITY * y) / 2]
            bounds = dict.fromkeys(states[:4], PLACE_AND_SPEED) | {states[4]: ROD}
            ends = [Y[0].func(0.0) - 1, *(state.func(0.0) for state in Y[1:])]
            ends += [Y[0].func(duration), Y[2].func(duration)]
        step = duration / intervals
        cost = create_objective_function(
            sm.Integral(U**2, T), states, (U,), (), count, step, time_symbol=T, integration_method=rule
        )
        rest = {"instance_constraints": tuple(ends), "bounds": bounds}
        rest |= {"time_symbol": T, "integration_method": rule}
        problem = Problem(*cost, sm.Matrix(EQUATIONS[form]), states, count, step, **rest)
        for name, value in OPTIONS.items():
            problem.add_option(name, value)
    return problem, np.concatenate([*guess, GRAVITY * np.cos(phi)]), watch.seconds


def solve(method: str, intervals: int) -> dict[str, Any]:
    """Solve from the guess; states are told at nodes alone, for opty has none between them."""
    form, rule = method.split(", ")
    problem, guess, built = transcribed(form, rule, intervals)
    with Stopwatch() as watch:
        found, info = problem.solve(guess)
    *states, u = found.reshape(-1, intervals + 1)
    if form == "DAE":
        x, y, vx, vy, _ = states
        states = [np.unwrap(np.arctan2(y, x)), x * vy - y * vx]
    times = np.linspace(0.0, _TASK["duration"], intervals + 1)
    return plan(
        build=built,
        watch=watch,
        solved=info["status"] == 0,
        breaks=times,
        # Equations of the backward rule hold at the end of an interval, with the input there.
        inputs=list(u[1:, None, None]) if rule == "backward euler" else lines(u[:, None]),
        times=times,
        states=np.column_stack(states),
    )


if __name__ == "__main__":
    answer({"build": build, "solve": solve})
