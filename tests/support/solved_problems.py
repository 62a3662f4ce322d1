"""Solutions with the unknowns that a solver found, and the transcription that they belong to."""

import fcntl
import hashlib
import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import trajopt
from tests.support.problems import hop
from trajopt.motion.solution import Solution
from trajopt.problem.problem import Problem
from trajopt.solvers.drivers import run_solver
from trajopt.solvers.result import Result, StoppingCriteria
from trajopt.solving.extraction import extract
from trajopt.solving.multipliers import with_multipliers
from trajopt.solving.solving import prepare
from trajopt.transcription.transcription import Transcription

# Polynomials through up to four points, evaluated by powers of the fraction, lose three digits.
ROUNDING = 1e-12
# The solution's times are sums of steps; a sample at a node lies within rounding of it.
SAME_STATE = 1e-9


@dataclass(frozen=True)
class Solved:
    transcription: Transcription
    result: Result
    solution: Solution


def solved(problem: Problem, scheme: str, intervals: int) -> Solved:
    prepared = prepare(problem, transcription=scheme, intervals=intervals)
    result = run_solver(prepared.nlp, prepared.guess, "ipopt", StoppingCriteria(), {}, lambda *_: True)
    t = prepared.transcription
    stated = {"success": True, "converged": True, "status": "solved", "solver": "ipopt", "tolerance": 1e-6}
    found = with_multipliers(extract(t, result.x, objective=0.0, **stated), t, result.lam_g, result.lam_x)
    return Solved(t, result, found)


@lru_cache
def solved_hop() -> Solved:
    return solved(hop(), "legendre:2", 8)


@lru_cache
def motion(name: str, **settings: object) -> Solution:
    """The solution of a problem of the library, to the grade; once for all workers of a session."""
    problem = trajopt.load(name, **settings)
    parameters = repr(sorted(problem.parameters.items())).encode()
    file = Path(os.environ["SOLVED_MOTIONS"], f"{name}-{hashlib.sha256(parameters).hexdigest()}.npz")
    with file.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        return Solution.load(file if file.is_file() else trajopt.solve(problem).save(file))
