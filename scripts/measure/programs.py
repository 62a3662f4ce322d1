"""Quadratic programs of the SQP's own steps, given to several solvers.

Programs are those of the first step, of the third, and of the last before the solution, with the exact
Hessian and with Gauss-Newton's, which is positive semidefinite. Solvers are PIQP with both of its
factorisations, OSQP, and HPIPM from CasADi's wheel, which takes no rows that join the first and the last
stage.
"""

import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import casadi as ca
import click
import numpy as np
import osqp
import piqp
from scipy import sparse

from scripts.measure.shared import head, row
from trajopt.solvers.qp import QuadraticProgram, StageQp
from trajopt.solvers.sqp import Sqp, SqpOutcome
from trajopt.solvers.sqp_point import Evaluator
from trajopt.solvers.sqp_settings import SqpSettings
from trajopt.solving.solving import prepare
from trajopt.transcription.nlp import Nlp
from trajopt_library import problems

REPEATS = 3
ACCURACY = 1e-6
STEPS, MOST_STEPS, MOST_TIME = (0, 2), 100, 600.0
# Curvature added to all: where the Hessian is zero a program has many solutions.
DELTA = 1e-6
MOST_SECONDS = 4.0
HPIPM_STATUS = {0: "solved", 1: "iteration limit", 2: "smallest step", 3: "not a number"}


class Answer(NamedTuple):
    """A solver's result: step, iterations, status."""

    d: np.ndarray
    iterations: int
    status: str


class Program:
    """One program as matrices."""

    def __init__(self, nlp: Nlp, q: QuadraticProgram) -> None:
        t, n = nlp.transcription, len(q.gradient)
        lower = sparse.csc_matrix((q.hessian, (nlp.hessian_row, nlp.hessian_column)), shape=(n, n))
        self.h = (lower + sparse.tril(lower, -1).T + DELTA * sparse.eye(n)).tocsc()
        self.j = sparse.csc_matrix((q.jacobian, (nlp.row, nlp.column)), shape=(len(q.low), n))
        self.h.sort_indices()
        self.j.sort_indices()
        self.nlp, self.q = nlp, q
        self.stages = None if t.problem.periodicity is not None else t.stage_sizes()

    def missed(self, d: np.ndarray) -> float:
        """Largest violation of a row or bound."""
        q, rows = self.q, self.j @ d
        worst = (q.low - rows, rows - q.high, q.x_low - d, d - q.x_high)
        return float(max(part.max(initial=0.0) for part in worst))


# Solves a program, with its pattern set up before; None where the solver cannot take it.
Ready = Callable[[], Answer] | None


def by_piqp(factorisation: str, program: Program) -> Ready:
    """PIQP as the SQP uses it, with either factorisation."""
    qp = StageQp(program.nlp)
    qp.factorisation = getattr(piqp.KKTSolver, factorisation)

    def solve() -> Answer:
        step = qp.solve(program.q, DELTA, ACCURACY)
        word = "solved" if step.solved else "infeasible" if step.infeasible else "not solved"
        return Answer(step.d, step.iterations, word)

    return solve


def by_osqp(program: Program) -> Ready:
    """OSQP, set up anew: its factorisation changes with the Hessian and the Jacobian."""
    q = program.q
    rows = sparse.vstack([program.j, sparse.eye(len(q.gradient))], format="csc")
    low, high = np.concatenate([q.low, q.x_low]), np.concatenate([q.high, q.x_high])

    def solve() -> Answer:
        solver = osqp.OSQP()
        solver.setup(
            sparse.triu(program.h, format="csc"), q.gradient, rows, low, high, verbose=False, polishing=False,
            eps_abs=ACCURACY, eps_rel=ACCURACY, max_iter=100000, time_limit=MOST_SECONDS,
        )  # fmt: skip
        found = solver.solve()
        return Answer(np.array(found.x), int(found.info.iter), str(found.info.status))

    return solve


def by_hpipm(program: Program) -> Ready:
    """HPIPM through CasADi, told the stages."""
    if program.stages is None:
        return None
    nx, nu, ng = program.stages
    options = {"print_time": False, "error_on_fail": False, "N": len(nx) - 1, "nx": nx, "nu": nu, "ng": ng}
    h, j = (_dm(matrix) for matrix in (program.h, program.j))
    patterns = {"h": h.sparsity(), "a": j.sparsity()}
    solver = ca.conic("solver", "hpipm", patterns, {**options, "hpipm": {"iter_max": 200}})
    q = program.q
    given = {"h": h, "g": q.gradient, "a": j, "lba": q.low, "uba": q.high, "lbx": q.x_low, "ubx": q.x_high}

    def solve() -> Answer:
        found, stats = solver(**given), solver.stats()
        word = HPIPM_STATUS.get(int(stats["return_status"]), "failed")
        return Answer(np.array(found["x"]).ravel(), stats["iter_count"], word)

    return solve


def _dm(matrix: sparse.csc_matrix) -> ca.DM:
    pattern = ca.Sparsity(*matrix.shape, matrix.indptr.tolist(), matrix.indices.tolist())
    return ca.DM(pattern, matrix.data)


SOLVERS = {
    "piqp, stages": partial(by_piqp, "sparse_multistage"),
    "piqp, sparse": partial(by_piqp, "sparse_ldlt"),
    "osqp": by_osqp,
    "hpipm": by_hpipm,
}


def along_a_solve(nlp: Nlp, guess: np.ndarray) -> Iterator[tuple[str, Program]]:
    """Programs along a solve by the SQP."""
    zero = np.zeros(nlp.transcription.n_rows), np.zeros_like(guess)

    def after(steps: int) -> SqpOutcome:
        settings = SqpSettings(
            tolerance=ACCURACY, feasibility=ACCURACY, max_iterations=steps, max_time=MOST_TIME
        )
        return Sqp(nlp, settings, lambda *_: True).run(guess, *zero)

    evaluator, last = Evaluator(nlp), after(MOST_STEPS).iterations
    for steps in (*STEPS, max(0, last - 1)):
        point = after(steps).point
        yield f"step {steps + 1} of {last}", Program(nlp, evaluator.program(point, point.lam_g))


@click.command()
@click.argument("names", nargs=-1)
def programs(names: tuple[str, ...]) -> None:
    """Quadratic programs of SQP steps by several solvers: best time, iterations, largest violation."""
    head("problem, Hessian", "program", "solver", "status", "ms", "iterations", "missed")
    for name in names or ("solo12-jump", "hopper-hop", "quadruped-trot"):
        for hessian in ("exact", "gauss-newton"):
            prepared = prepare(problems.load(name), hessian=hessian)
            for label, program in along_a_solve(prepared.nlp, prepared.guess):
                for solver, ready in SOLVERS.items():
                    row(f"{name}, {hessian}", label, solver, *_figures(program, ready))


def _figures(program: Program, ready: Callable[[Program], Ready]) -> tuple[str, ...]:
    seconds: list[float] = []
    try:
        solve = ready(program)
        if solve is None:
            return "refused: rows join the ends", "", "", ""
        while len(seconds) < REPEATS and sum(seconds) < MOST_SECONDS:
            begun = time.perf_counter()
            answer = solve()
            seconds.append(time.perf_counter() - begun)
    except (ValueError, osqp.OSQPException):
        return "refused: not convex", "", "", ""
    missed = f"{program.missed(answer.d):.0e}"
    return answer.status, f"{1e3 * min(seconds):.1f}", str(answer.iterations), missed
