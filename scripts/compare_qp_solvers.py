"""Quadratic programs of the SQP's own steps, given to several solvers: time, iterations, accuracy.

    OMP_NUM_THREADS=1 python -m scripts.compare_qp_solvers solo12-jump hopper-hop biped-squat

Programs are those of the first step, of the third, and of the last before the solution, with the exact
Hessian and with Gauss-Newton's, which is nowhere negative. Solvers are PIQP with both of its factorisations,
OSQP, and HPIPM from CasADi's wheel, which knows no rows that join the first and the last stage. Times are
the best of three with patterns set up before, in ms; `missed` is the largest violation of a row, `dual`
the largest entry of the gradient of the Lagrangian.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np
import osqp
import piqp
from scipy import sparse

from trajopt.solvers.qp import QuadraticProgram, StageQp
from trajopt.solvers.sqp import Sqp
from trajopt.solvers.sqp_point import Evaluator, SqpIterate
from trajopt.solvers.sqp_settings import SqpSettings
from trajopt.solving.solving import prepare
from trajopt.transcription.nlp import Nlp
from trajopt_library import problems

REPEATS = 3
ACCURACY = 1e-6
STEPS, MOST_STEPS = (0, 2), 100
# Curvature added to all: where the Hessian is zero a program has many solutions.
DELTA = 1e-6
MOST_SECONDS = 4.0
HPIPM_STATUS = {0: "solved", 1: "iteration limit", 2: "smallest step", 3: "not a number"}


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What a solver found: step, multipliers of rows and bounds, iterations (or none), its word for it."""

    d: np.ndarray
    lam_g: np.ndarray
    lam_x: np.ndarray
    iterations: int | None
    status: str


class Program:
    """One program as matrices."""

    def __init__(self, nlp: Nlp, q: QuadraticProgram) -> None:
        t = nlp.transcription
        n = len(q.gradient)
        lower = sparse.csc_matrix((q.hessian, (nlp.hessian_row, nlp.hessian_column)), shape=(n, n))
        self.h = (lower + sparse.tril(lower, -1).T + DELTA * sparse.eye(n)).tocsc()
        self.j = sparse.csc_matrix((q.jacobian, (nlp.row, nlp.column)), shape=(len(q.low), n))
        self.h.sort_indices()
        self.j.sort_indices()
        self.q, self.stages = q, None if t.problem.periodicity is not None else t.stage_sizes()
        self.equal = t.lower_g == t.upper_g

    def missed(self, d: np.ndarray) -> float:
        """Largest violation of a row or bound."""
        q, rows = self.q, self.j @ d
        worst = (q.low - rows, rows - q.high, q.x_low - d, d - q.x_high)
        return float(max(part.max(initial=0.0) for part in worst))

    def dual(self, answer: Answer) -> float:
        """Largest entry of the gradient of the Lagrangian."""
        slope = self.h @ answer.d + self.q.gradient + self.j.T @ answer.lam_g + answer.lam_x
        return float(np.abs(slope).max())

    def objective(self, d: np.ndarray) -> float:
        """Value at ``d``."""
        return float(0.5 * d @ (self.h @ d) + self.q.gradient @ d)


def by_piqp(factorisation: str) -> Callable[[Nlp, Program], Callable[[], Answer]]:
    """PIQP as the SQP uses it, with either factorisation."""

    def ready(nlp: Nlp, program: Program) -> Callable[[], Answer]:
        qp = StageQp(nlp)
        qp.factorisation = getattr(piqp.KKTSolver, factorisation)

        def solve() -> Answer:
            step = qp.solve(program.q, DELTA, ACCURACY)
            word = "solved" if step.solved else "infeasible" if step.infeasible else "not solved"
            return Answer(
                d=step.d, lam_g=step.lam_g, lam_x=step.lam_x, iterations=step.iterations, status=word
            )

        return solve

    return ready


def by_osqp(_: Nlp, program: Program) -> Callable[[], Answer]:
    """OSQP, set up anew: its factorisation changes with the Hessian and the Jacobian."""
    q, n = program.q, len(program.q.gradient)
    rows = sparse.vstack([program.j, sparse.eye(n)], format="csc")
    low, high = np.concatenate([q.low, q.x_low]), np.concatenate([q.high, q.x_high])

    def solve() -> Answer:
        solver = osqp.OSQP()
        solver.setup(
            sparse.triu(program.h, format="csc"), q.gradient, rows, low, high, verbose=False, polishing=False,
            eps_abs=ACCURACY, eps_rel=ACCURACY, max_iter=100000, time_limit=MOST_SECONDS,
        )  # fmt: skip
        found = solver.solve()
        m = len(q.low)
        return Answer(
            d=np.array(found.x), lam_g=np.array(found.y[:m]), lam_x=np.array(found.y[m:]),
            iterations=int(found.info.iter), status=str(found.info.status),
        )  # fmt: skip

    return solve


def by_hpipm(_: Nlp, program: Program) -> Callable[[], Answer] | None:
    """HPIPM through CasADi, told the stages; None where rows join the first and the last."""
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
        d, lam_g, lam_x = (np.array(found[key]).ravel() for key in ("x", "lam_a", "lam_x"))
        word = HPIPM_STATUS.get(int(stats["return_status"]), "failed")
        return Answer(d=d, lam_g=lam_g, lam_x=lam_x, iterations=stats["iter_count"], status=word)

    return solve


def _dm(matrix: sparse.csc_matrix) -> ca.DM:
    pattern = ca.Sparsity(*matrix.shape, matrix.indptr.tolist(), matrix.indices.tolist())
    return ca.DM(pattern, matrix.data)


SOLVERS = {
    "piqp, stages": by_piqp("sparse_multistage"),
    "piqp, sparse": by_piqp("sparse_ldlt"),
    "osqp": by_osqp,
    "hpipm": by_hpipm,
}


def point_after(nlp: Nlp, guess: np.ndarray, steps: int) -> tuple[int, SqpIterate]:
    """The iterate after so many steps of the SQP, and how many it took."""
    settings = SqpSettings(tolerance=ACCURACY, feasibility=ACCURACY, max_iterations=steps, max_time=600.0)
    zero = np.zeros(nlp.transcription.n_rows), np.zeros_like(guess)
    outcome = Sqp(nlp, settings, lambda *_: True).run(guess, *zero)
    return outcome.iterations, outcome.point


def programs(nlp: Nlp, guess: np.ndarray) -> Iterator[tuple[str, Program]]:
    """Programs along a solve by the SQP."""
    evaluator = Evaluator(nlp)
    last, _ = point_after(nlp, guess, MOST_STEPS)
    for steps in (*STEPS, max(0, last - 1)):
        _, point = point_after(nlp, guess, steps)
        yield f"step {steps + 1} of {last}", Program(nlp, evaluator.program(point, point.lam_g))


def report(name: str, hessian: str) -> None:
    """A table of one problem's programs."""
    prepared = prepare(problems.load(name), hessian=hessian)
    nlp = prepared.nlp
    print(f"\n{name}, {hessian}: {len(prepared.guess)} unknowns, {nlp.transcription.n_rows} rows\n")
    print("| program | solver | status | ms | iterations | ms each | missed | dual | objective |")
    print("|---" * 9 + "|")
    for label, program in programs(nlp, prepared.guess):
        for solver, ready in SOLVERS.items():
            try:
                solve = ready(nlp, program)
                text = None if solve is None else figures(program, solve)
            except (ValueError, osqp.OSQPException):
                text = "refused: not convex" + " |" * 5
            if text is not None:
                print(f"| {label} | {solver} | {text} |", flush=True)


def figures(program: Program, solve: Callable[[], Answer]) -> str:
    """Cells of one solver's answer to one program."""
    seconds: list[float] = []
    while len(seconds) < REPEATS and sum(seconds) < MOST_SECONDS:
        begun = time.perf_counter()
        answer = solve()
        seconds.append(time.perf_counter() - begun)
    best, count = 1e3 * min(seconds), answer.iterations
    each = f"{best / count:.2f}" if count else ""
    quality = f"{program.missed(answer.d):.0e} | {program.dual(answer):.0e}"
    cost = f"{program.objective(answer.d):.6g}"
    return f"{answer.status} | {best:.1f} | {count} | {each} | {quality} | {cost}"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("problems", nargs="*", default=["solo12-jump", "hopper-hop"])
    parser.add_argument("--hessian", nargs="*", default=["exact", "gauss-newton"])
    given = parser.parse_args()
    for name in given.problems:
        for hessian in given.hessian:
            report(name, hessian)


if __name__ == "__main__":
    main()
