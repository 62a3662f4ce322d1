"""Convex quadratic programs of one structure, solved at each tick by PIQP, ProxQP or OSQP.

    minimise x' P x / 2 + c' x    subject to    E x = e,   l <= G x <= u,   bounds on some x

PIQP (Schwan et al., CDC 2023) is an interior-point method for dense matrices. OSQP (Stellato et al.,
Mathematical Programming Computation 12, 2020) is set up once per structure; each tick only updates the values
and starts from the last solution. ProxQP (Bambade et al., RSS 2022), in the extra ``proxqp``, is an augmented
Lagrangian method for dense matrices; it starts from the solution of the equations alone, so that results do
not depend on earlier ticks. PIQP solves the programs for which OSQP or ProxQP do not converge.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from trajopt.errors import InputError, not_among

QpSolverName = Literal["osqp", "piqp", "proxqp"]
# Accuracy of scaled rows and stationarity: OSQP needs half as many iterations as for 1e-5, and the robots end
# in the same place; PIQP converges quadratically.
ACCURACY, EXACT = 1e-4, 1e-7
MOST_OSQP, MOST_PIQP = 400, 100
# Accuracy of ProxQP, whose last digits cost no more than the first.
PROXIMAL = 1e-6
# A scaled bound of this size or larger counts as none.
UNBOUNDED = 1e6
# The value that OSQP and ProxQP take for infinity.
OSQP_INFINITY = PROXQP_INFINITY = 1e20


@dataclass(frozen=True)
class QuadraticSolution:
    """The minimiser or last iterate ``x`` (n,), whether it is ``solved``, and the number of iterations."""

    x: np.ndarray
    solved: bool
    iterations: int


@dataclass(frozen=True, kw_only=True)
class QpRows:
    """Constraints on n unknowns x.

    ``equal`` (p, n) and ``value`` (p,) are E and e of E x = e; ``between`` (m, n), ``low`` and ``high`` (m,)
    are G, l and u of l <= G x <= u. ``bounded`` (b,) are indices of x, with bounds ``least`` and ``most``
    (b,). Bounds as large as `UNBOUNDED` count as none.
    """

    equal: np.ndarray
    value: np.ndarray
    between: np.ndarray
    low: np.ndarray
    high: np.ndarray
    bounded: np.ndarray
    least: np.ndarray
    most: np.ndarray

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Numbers of unknowns, equations, two-sided rows and bounded unknowns."""
        return self.between.shape[1], len(self.value), len(self.low), len(self.bounded)


class QuadraticSolver(ABC):
    """Solves a sequence of programs of one `QpRows.shape`."""

    def __init__(self, shape: tuple[int, int, int, int]) -> None:
        self.n = shape[0]

    def solve(self, p: np.ndarray, c: np.ndarray, rows: QpRows) -> QuadraticSolution:
        """Solve the program with symmetric P (n, n) and c (n,)."""
        if (rows.low > rows.high).any() or (rows.least > rows.most).any():
            return QuadraticSolution(np.zeros(self.n), False, 0)
        low, high = _without_large(rows.low, rows.high)
        least, most = _without_large(rows.least, rows.most)
        return self._solve(p, c, replace(rows, low=low, high=high, least=least, most=most))

    @abstractmethod
    def _solve(self, p: np.ndarray, c: np.ndarray, rows: QpRows) -> QuadraticSolution:
        pass


def _without_large(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.where(low <= -UNBOUNDED, -np.inf, low), np.where(high >= UNBOUNDED, np.inf, high)


def quadratic_solver(name: QpSolverName, shape: tuple[int, int, int, int]) -> QuadraticSolver:
    """The solver of that name for programs of a `QpRows.shape`. Raises `InputError` for an unknown name."""
    known: dict[str, type[QuadraticSolver]] = {"osqp": _Osqp, "piqp": _Piqp, "proxqp": _ProxQp}
    if name not in known:
        raise not_among(get_args(QpSolverName), str(name), f"solver of quadratic programs is {name!r}")
    return known[name](shape)


class _Osqp(QuadraticSolver):
    def __init__(self, shape: tuple[int, int, int, int]) -> None:
        super().__init__(shape)
        self._solver: Any = None
        self._second = _Piqp(shape)
        rows, columns = np.triu_indices(self.n)
        order = np.lexsort((rows, columns))  # the upper triangle column by column
        self._upper = rows[order], columns[order]

    def _solve(self, p: np.ndarray, c: np.ndarray, rows: QpRows) -> QuadraticSolution:
        a = np.vstack([rows.equal, rows.between, np.eye(self.n)[rows.bounded]])
        low = np.maximum(np.concatenate([rows.value, rows.low, rows.least]), -OSQP_INFINITY)
        high = np.minimum(np.concatenate([rows.value, rows.high, rows.most]), OSQP_INFINITY)
        if self._solver is None:
            self._solver = self._set_up(p, c, a, low, high)
        else:
            self._solver.update(Px=p[self._upper], Ax=a.T.ravel(), q=c, l=low, u=high)
        result = self._solver.solve(raise_error=False)
        if result.info.status_val == 1:
            return QuadraticSolution(np.array(result.x, dtype=float), True, int(result.info.iter))
        # PIQP distinguishes slow programs from infeasible ones.
        exact = self._second.solve(p, c, rows)
        if exact.solved:
            self._solver.warm_start(x=exact.x)
        return QuadraticSolution(exact.x, exact.solved, exact.iterations + int(result.info.iter))

    def _set_up(self, p: np.ndarray, c: np.ndarray, a: np.ndarray, low: np.ndarray, high: np.ndarray) -> Any:
        import osqp  # slow to import, like SciPy
        import scipy.sparse as sp

        m, n = a.shape
        pointers = np.concatenate([[0], np.cumsum(np.arange(1, n + 1))])
        upper = sp.csc_matrix((p[self._upper], self._upper[0], pointers), shape=(n, n))
        whole = sp.csc_matrix((a.T.ravel(), np.tile(np.arange(m), n), np.arange(n + 1) * m), shape=(m, n))
        solver = osqp.OSQP()
        solver.setup(
            upper, c, whole, low, high,
            verbose=False, eps_abs=ACCURACY, eps_rel=ACCURACY, max_iter=MOST_OSQP, check_termination=10,
            warm_starting=True, adaptive_rho=True, adaptive_rho_interval=50, polishing=False,
        )  # fmt: skip
        return solver


class _Piqp(QuadraticSolver):
    def __init__(self, shape: tuple[int, int, int, int]) -> None:
        super().__init__(shape)
        import piqp  # type: ignore[import-untyped]  # only where programs are solved

        self._solved, self._solver = piqp.PIQP_SOLVED, piqp.DenseSolver()
        self._solver.settings.eps_abs = EXACT
        self._solver.settings.eps_rel = EXACT
        self._solver.settings.max_iter = MOST_PIQP
        self._pattern: np.ndarray | None = None

    def _solve(self, p: np.ndarray, c: np.ndarray, rows: QpRows) -> QuadraticSolution:
        # An interior-point method needs an interior: equal bounds become equations.
        same, fixed = rows.low == rows.high, rows.least == rows.most
        used = ~same & (np.isfinite(rows.low) | np.isfinite(rows.high))
        pattern = np.concatenate([same, fixed, used])
        equal, value, between, low, high = rows.equal, rows.value, rows.between, rows.low, rows.high
        if same.any() or fixed.any():
            equal = np.vstack([equal, between[same], np.eye(self.n)[rows.bounded[fixed]]])
            value = np.concatenate([value, low[same], rows.least[fixed]])
        if not used.all():
            between, low, high = between[used], low[used], high[used]
        least, most = np.full(self.n, -np.inf), np.full(self.n, np.inf)
        free = rows.bounded[~fixed]
        least[free], most[free] = rows.least[~fixed], rows.most[~fixed]
        known = self._pattern is not None and np.array_equal(self._pattern, pattern)
        given = self._solver.update if known else self._solver.setup
        given(p, c, equal, value, between, low, high, least, most)
        self._pattern = pattern
        status = self._solver.solve()
        x = np.array(self._solver.result.x, dtype=float)
        solved = status == self._solved and bool(np.isfinite(x).all())
        return QuadraticSolution(x, solved, int(self._solver.result.info.iter))


class _ProxQp(QuadraticSolver):
    def __init__(self, shape: tuple[int, int, int, int]) -> None:
        super().__init__(shape)
        n, equations, between, bounded = shape
        self._proxqp = proxqp_package()
        self._solver = self._proxqp.dense.QP(n, equations, between + bounded)
        settings = self._solver.settings
        settings.eps_abs, settings.eps_rel = PROXIMAL, 0.0
        settings.initial_guess = self._proxqp.InitialGuess.EQUALITY_CONSTRAINED_INITIAL_GUESS
        self._second = _Piqp(shape)
        self._is_set_up = False

    def _solve(self, p: np.ndarray, c: np.ndarray, rows: QpRows) -> QuadraticSolution:
        between = np.vstack([rows.between, np.eye(self.n)[rows.bounded]])
        low = np.maximum(np.concatenate([rows.low, rows.least]), -PROXQP_INFINITY)
        high = np.minimum(np.concatenate([rows.high, rows.most]), PROXQP_INFINITY)
        given = self._solver.update if self._is_set_up else self._solver.init
        given(p, c, rows.equal, rows.value, between, low, high)
        self._is_set_up = True
        self._solver.solve()
        results = self._solver.results
        x, iterations = np.array(results.x, dtype=float), int(results.info.iter)
        if results.info.status == self._proxqp.PROXQP_SOLVED and np.isfinite(x).all():
            return QuadraticSolution(x, True, iterations)
        exact = self._second.solve(p, c, rows)
        return QuadraticSolution(exact.x, exact.solved, exact.iterations + iterations)


def proxqp_package() -> Any:
    """The module of ProxQP. Raises `InputError` if the package is not installed."""
    try:
        import proxsuite  # type: ignore[import-untyped]
    except ImportError as error:
        raise InputError(
            "the package proxsuite is not installed, which ProxQP is part of",
            "install it with: pip install proxsuite; or use the solver 'piqp'",
        ) from error
    return proxsuite.proxqp
