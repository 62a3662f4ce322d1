"""Quadratic programs of SQP steps, solved by PIQP with the variables in their order in time.

    min over d   1/2 d^T (H + delta 1) d + c^T d   with   low <= J d <= high,   x_low <= d <= x_high

PIQP (Schwan, Jiang, Kuhn, Jones, "PIQP: A Proximal Interior-Point Quadratic Programming Solver", CDC 2023)
factorises H + rho 1 + J_e^T J_e / epsilon + J_i^T W J_i, with J_e the equations and J_i the inequalities, by
a block Cholesky factorisation that follows the stages (Schwan, Kuhn, Jones, "Exploiting Multistage
Optimization Structure in Proximal Solvers", 2025). So H must be positive definite only on the null space of
the equations: the Hessian of the Lagrangian is used as it is, without a projection that would lose Newton's
rate of convergence. Linearly dependent rows do no harm, nor do rows that couple the ends.

The elastic program may violate every row at a price of one per unit, with the objective times ``share``:

    min over d, s   share (1/2 d^T (H + delta 1) d + c^T d) + sum s
    with   low <= J d + s_low - s_high <= high,   s >= 0,   x_low <= d <= x_high
"""

from dataclasses import dataclass

import numpy as np
import piqp  # type: ignore[import-untyped]
from scipy import sparse

from trajopt.transcription.nlp import Nlp

# Interior-point iterations of one program: those that can be solved take 10 to 30, detecting that there is no
# feasible point takes 30 to 40.
MOST_ITERATIONS = 40


@dataclass(frozen=True, kw_only=True)
class QuadraticProgram:
    """Numbers of one program: nonzeros of H (lower triangle) and of J in their patterns' order, c, bounds."""

    hessian: np.ndarray
    gradient: np.ndarray
    jacobian: np.ndarray
    low: np.ndarray
    high: np.ndarray
    x_low: np.ndarray
    x_high: np.ndarray


@dataclass(frozen=True, kw_only=True)
class QpStep:
    """A program's solution: step, multipliers of rows and of bounds, and ``missed``, the sum of slacks s.

    ``infeasible``: the rows contradict each other or the bounds. ``iterations`` are of the interior point.
    """

    d: np.ndarray
    lam_g: np.ndarray
    lam_x: np.ndarray
    solved: bool
    infeasible: bool
    iterations: int
    missed: float


class _Rows:
    """Some rows of the Jacobian as a matrix of fixed pattern, filled from all nonzeros in the NLP's order."""

    def __init__(self, nlp: Nlp, members: np.ndarray, n_unknowns: int) -> None:
        place = np.cumsum(members) - 1
        entries = np.flatnonzero(members[nlp.row])
        known = (np.arange(1.0, len(entries) + 1), (place[nlp.row[entries]], nlp.column[entries]))
        self.matrix = sparse.csc_matrix(known, shape=(int(members.sum()), n_unknowns))
        self.source = entries[self.matrix.data.astype(np.int64) - 1]

    def filled(self, nonzeros: np.ndarray) -> sparse.csc_matrix:
        self.matrix.data = nonzeros[self.source]
        return self.matrix


class _Curvature:
    """Upper triangle of H + delta 1 with its whole diagonal, filled from the lower one's nonzeros."""

    def __init__(self, pattern: tuple[np.ndarray, np.ndarray], n_unknowns: int) -> None:
        n, diagonal = n_unknowns, np.arange(n_unknowns, dtype=np.int64)
        row, column = (index.astype(np.int64) for index in pattern)
        keys = np.unique(np.concatenate([row * n + column, diagonal * (n + 1)]))
        starts = np.searchsorted(keys, np.arange(n + 1, dtype=np.int64) * n)
        self.matrix = sparse.csc_matrix((np.zeros(len(keys)), keys % n, starts), shape=(n, n))
        self.target = np.searchsorted(keys, row * n + column)
        self.diagonal = np.searchsorted(keys, diagonal * (n + 1))

    def filled(self, nonzeros: np.ndarray, delta: float) -> sparse.csc_matrix:
        data = np.zeros(len(self.matrix.data))
        data[self.target] = nonzeros
        data[self.diagonal] += delta
        self.matrix.data = data
        return self.matrix


class StageQp:
    """Programs of one NLP: patterns are set up once, further programs only change the numbers.

    ``pattern``: row and column of the nonzeros of H, if different from those of the NLP's Hessian.
    """

    def __init__(self, nlp: Nlp, pattern: tuple[np.ndarray, np.ndarray] | None = None) -> None:
        t = nlp.transcription
        self.n = len(t.lower_x)
        self.equal = t.lower_g == t.upper_g
        self.equations, self.inequalities = (_Rows(nlp, which, self.n) for which in (self.equal, ~self.equal))
        self.curvature = _Curvature(pattern or (nlp.hessian_row, nlp.hessian_column), self.n)
        self.slack = _slack(t.lower_g, t.upper_g)
        self.factorisation = piqp.KKTSolver.sparse_multistage
        self.solver: piqp.SparseSolver | None = None

    def solve(self, q: QuadraticProgram, delta: float, accuracy: float) -> QpStep:
        """The program as it is, to ``accuracy`` in its residuals and duality gap."""
        p = self.curvature.filled(q.hessian, delta)
        rows = {
            "A": self.equations.filled(q.jacobian),
            "b": q.low[self.equal],
            "G": self.inequalities.filled(q.jacobian),
            "h_l": q.low[~self.equal],
            "h_u": q.high[~self.equal],
            "x_l": q.x_low,
            "x_u": q.x_high,
        }
        if self.solver is None:
            self.solver = _solver(self.factorisation)
            _set_accuracy(self.solver, accuracy)
            self.solver.setup(p, q.gradient, **rows)
        else:
            _set_accuracy(self.solver, accuracy)
            self.solver.update(p, q.gradient, **rows)
        self.solver.solve()
        return self._step(self.solver.result, 1.0)

    def elastic(self, q: QuadraticProgram, delta: float, share: float, accuracy: float) -> QpStep:
        """The elastic program, by a general sparse factorisation, since slacks enlarge the stages."""
        count = self.slack.shape[1]
        curvature = share * self.curvature.filled(q.hessian, delta)
        solver = _solver(piqp.KKTSolver.sparse_ldlt)
        _set_accuracy(solver, accuracy)
        solver.setup(
            sparse.block_diag([curvature, sparse.csc_matrix((count, count))], format="csc"),
            np.concatenate([share * q.gradient, np.ones(count)]),
            A=sparse.hstack([self.equations.filled(q.jacobian), self.slack[self.equal]], format="csc"),
            b=q.low[self.equal],
            G=sparse.hstack([self.inequalities.filled(q.jacobian), self.slack[~self.equal]], format="csc"),
            h_l=q.low[~self.equal],
            h_u=q.high[~self.equal],
            x_l=np.concatenate([q.x_low, np.zeros(count)]),
            x_u=np.concatenate([q.x_high, np.full(count, np.inf)]),
        )
        solver.solve()
        return self._step(solver.result, share)

    def _step(self, result: piqp.Result, share: float) -> QpStep:
        n, lam_g = self.n, np.zeros(len(self.equal))
        lam_g[self.equal] = result.y
        lam_g[~self.equal] = result.z_u - result.z_l
        lam_x = result.z_bu[:n] - result.z_bl[:n]
        finite = all(np.isfinite(part).all() for part in (result.x, lam_g, lam_x))
        return QpStep(
            d=np.array(result.x[:n]),
            lam_g=lam_g / share,
            lam_x=lam_x / share,
            solved=finite and result.info.status == piqp.PIQP_SOLVED,
            infeasible=result.info.status == piqp.PIQP_PRIMAL_INFEASIBLE,
            iterations=int(result.info.iter),
            missed=float(np.sum(result.x[n:])),
        )


def _slack(low: np.ndarray, high: np.ndarray) -> sparse.csr_matrix:
    """Columns of the slacks (n_rows, n_slacks): one up for every lower bound, one down for every upper."""
    lower, upper = np.flatnonzero(np.isfinite(low)), np.flatnonzero(np.isfinite(high))
    rows = np.concatenate([lower, upper])
    signs = np.concatenate([np.ones(len(lower)), -np.ones(len(upper))])
    return sparse.csr_matrix((signs, (rows, np.arange(len(rows)))), shape=(len(low), len(rows)))


def _solver(factorisation: piqp.KKTSolver) -> piqp.SparseSolver:
    solver = piqp.SparseSolver()
    solver.settings.kkt_solver = factorisation
    solver.settings.max_iter = MOST_ITERATIONS
    return solver


def _set_accuracy(solver: piqp.SparseSolver, accuracy: float) -> None:
    solver.settings.eps_abs = accuracy
    solver.settings.eps_duality_gap_abs = accuracy
