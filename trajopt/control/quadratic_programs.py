"""Convex quadratic programs of one structure, solved tick by tick: PIQP or OSQP.

    minimise x' P x / 2 + c' x    subject to    l <= A x <= u

OSQP (Stellato et al., Mathematical Programming Computation 12, 2020) is set up once per structure, starts
from the last solution, and takes new values alone; where it does not converge PIQP decides. PIQP (Schwan et
al., CDC 2023) is an interior-point method for dense matrices.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import osqp
import piqp  # type: ignore[import-untyped]
import scipy.sparse as sp

from trajopt.errors import not_among

QpSolverName = Literal["osqp", "piqp"]
# Accuracy of rows over their natural units, and of stationarity: OSQP needs half as many iterations as for
# 1e-5, and robots end where they did; PIQP is quadratic at its end.
ACCURACY, EXACT = 1e-4, 1e-7
MOST_OSQP, MOST_PIQP = 400, 100
# A bound as large as this, over natural units, is none.
UNBOUNDED = 1e6


@dataclass(frozen=True)
class QuadraticSolution:
    """A minimiser ``x`` (n,), or the last iterate; whether it is one; and the iterations."""

    x: np.ndarray
    solved: bool
    iterations: int


class QuadraticSolver(ABC):
    """Solves programs with ``n`` unknowns and ``m`` rows, one after the other."""

    def __init__(self, n: int, m: int) -> None:
        self.n, self.m = n, m

    def solve(
        self, p: np.ndarray, c: np.ndarray, a: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> QuadraticSolution:
        """Solve with P (n, n) symmetric, c (n,), A (m, n) and bounds (m,), see `UNBOUNDED`."""
        if (low > high).any():
            return QuadraticSolution(np.zeros(self.n), False, 0)
        low, high = np.where(low <= -UNBOUNDED, -np.inf, low), np.where(high >= UNBOUNDED, np.inf, high)
        return self._solve(p, c, a, low, high)

    @abstractmethod
    def _solve(
        self, p: np.ndarray, c: np.ndarray, a: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> QuadraticSolution:
        pass


def quadratic_solver(name: QpSolverName, n: int, m: int) -> QuadraticSolver:
    """A solver by its name. Raises `InputError`."""
    known: dict[str, type[QuadraticSolver]] = {"osqp": _Osqp, "piqp": _Piqp}
    if name not in known:
        raise not_among(get_args(QpSolverName), str(name), f"solver of quadratic programs is {name!r}")
    return known[name](n, m)


class _Osqp(QuadraticSolver):
    def __init__(self, n: int, m: int) -> None:
        super().__init__(n, m)
        self._solver: osqp.OSQP | None = None
        self._second: _Piqp | None = None
        rows, columns = np.triu_indices(n)
        order = np.lexsort((rows, columns))  # the upper triangle column by column
        self._upper = rows[order], columns[order]

    def _solve(
        self, p: np.ndarray, c: np.ndarray, a: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> QuadraticSolution:
        low, high = np.maximum(low, -1e20), np.minimum(high, 1e20)
        if self._solver is None:
            self._solver = self._set_up(p, c, a, low, high)
        else:
            self._solver.update(Px=p[self._upper], Ax=a.T.ravel(), q=c, l=low, u=high)
        found = self._solver.solve(raise_error=False)
        if found.info.status_val != 1:
            return self._exact(p, c, a, low, high, int(found.info.iter))
        return QuadraticSolution(np.array(found.x, dtype=float), True, int(found.info.iter))

    def _exact(
        self,
        p: np.ndarray,
        c: np.ndarray,
        a: np.ndarray,
        low: np.ndarray,
        high: np.ndarray,
        iterations: int,
    ) -> QuadraticSolution:
        """What PIQP finds where OSQP does not converge: it tells slow programs from infeasible ones."""
        self._second = self._second or _Piqp(self.n, self.m)
        found = self._second.solve(p, c, a, low, high)
        if found.solved and self._solver is not None:
            self._solver.warm_start(x=found.x)
        return QuadraticSolution(found.x, found.solved, found.iterations + iterations)

    def _set_up(
        self, p: np.ndarray, c: np.ndarray, a: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> osqp.OSQP:
        pointers = np.concatenate([[0], np.cumsum(np.arange(1, self.n + 1))])
        upper = sp.csc_matrix((p[self._upper], self._upper[0], pointers), shape=(self.n, self.n))
        whole = sp.csc_matrix(
            (a.T.ravel(), np.tile(np.arange(self.m), self.n), np.arange(self.n + 1) * self.m),
            shape=(self.m, self.n),
        )
        solver = osqp.OSQP()
        solver.setup(
            upper, c, whole, low, high,
            verbose=False, eps_abs=ACCURACY, eps_rel=ACCURACY, max_iter=MOST_OSQP, check_termination=10,
            warm_starting=True, adaptive_rho=True, adaptive_rho_interval=50, polishing=False,
        )  # fmt: skip
        return solver


class _Piqp(QuadraticSolver):
    def __init__(self, n: int, m: int) -> None:
        super().__init__(n, m)
        self._solver = piqp.DenseSolver()
        self._solver.settings.eps_abs = EXACT
        self._solver.settings.eps_rel = EXACT
        self._solver.settings.max_iter = MOST_PIQP
        self._rows: np.ndarray | None = None

    def _solve(
        self, p: np.ndarray, c: np.ndarray, a: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> QuadraticSolution:
        equal, bounded = low == high, (low < high) & (np.isfinite(low) | np.isfinite(high))
        given = (p, c, a[equal], low[equal], a[bounded], low[bounded], high[bounded])
        rows = np.stack([equal, bounded])
        if self._rows is None or (self._rows != rows).any():
            self._solver.setup(*given)
            self._rows = rows
        else:
            self._solver.update(*given)
        status = self._solver.solve()
        x = np.array(self._solver.result.x, dtype=float)
        solved = status == piqp.PIQP_SOLVED and bool(np.isfinite(x).all())
        return QuadraticSolution(x, solved, int(self._solver.result.info.iter))
