"""The elastic problem: find the least constraint violation near an iterate.

Every row may be violated at a cost of one per scaled unit, and the objective is dropped:

    min over x, s   sum s + prox/2 |x - centre|^2
    with   low <= g(x) + s_low - s_high <= high,   s >= 0,   bounds of x

(Nocedal and Wright, "Numerical Optimization", 2006, chapter 17.2.) A point without violation is feasible. A
minimum with a violation above zero certifies that the problem is locally infeasible; its multipliers, at most
one in magnitude, then tell which rows and bounds conflict with the violated ones.
The elastic problem is regular at any start, as slacks absorb all violations: it takes 15 to 50 iterations
where the problem itself stalls. The proximal term prox selects the nearest of equal minima. As it may also
hold the variables back, the problem is solved again from its solution with a smaller prox, until the
violation no longer falls.
"""

import time
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from trajopt import _engine
from trajopt.solvers.ipopt import IPOPT_OPTIONS
from trajopt.solvers.result import LEAST_TIME, Callback, Option
from trajopt.transcription.nlp import Nlp
from trajopt.transcription.sparse_maps import SparseMatrix

# Proximal weights of the first minimisation and of the following ones. With ten times the second, feasible
# tall hops and long jumps end at a violation.
FIRST_PROX, LATER_PROX = 1e-4, 1e-6
# Violation of one row, in scaled units, that is clear, and one that a solver can remove. Measured: feasible
# problems end below 1e-3, infeasible ones above 1.2e-2. The gap is narrow for barely feasible problems, and a
# point between the two is no verdict.
CLEAR_VIOLATION, REMOVABLE_VIOLATION = 1e-2, 1e-3
# If a minimum is below this fraction of the last one, prox held that back; the violation may fall further.
FALL_SHARE = 0.5
# Slacks start this far beyond the violations: well inside their bounds for the first barrier.
FIRST_SLACK = 1e-3
# A certificate needs few digits, and the first minimum even fewer. Barriers start small, near an iterate.
_FIRST: dict[str, Option] = {
    "mu_init": 1e-2,
    "tol": 1e-2,
    "constr_viol_tol": 1e-4,
    "dual_inf_tol": 1e-1,
    "compl_inf_tol": 1e-3,
}
_SECOND: dict[str, Option] = {
    "mu_init": 1e-3,
    "tol": 1e-3,
    "constr_viol_tol": 1e-4,
    "dual_inf_tol": 1e-2,
    "compl_inf_tol": 1e-4,
}
# Distance of the start from bounds, relative to the initial barrier parameter.
PUSH = 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class ElasticPoint:
    """Result of the elastic problem, in scaled units.

    Attributes:
        x: Variables (n_unknowns,).
        gives: Violation of each row (n_rows,).
        weights: Multipliers (n_rows + n_unknowns,) of rows, then of bounds.
        minimum: Whether it is a minimum that prox does not hold back.
        stopped: Whether the callback stopped the solve.
        iterations, function_time: Iterations and time (s) in functions that were spent.
    """

    x: np.ndarray
    gives: np.ndarray
    weights: np.ndarray
    minimum: bool
    stopped: bool
    iterations: int
    function_time: float

    @property
    def missed(self) -> float:
        """Sum of the violations that are too large for a solver to remove."""
        return float(self.gives[self.gives > REMOVABLE_VIOLATION].sum())

    @property
    def feasible(self) -> bool:
        """Whether no row is violated by more than `REMOVABLE_VIOLATION`."""
        return bool(self.gives.max(initial=0.0) <= REMOVABLE_VIOLATION) and not self.stopped

    @property
    def infeasible(self) -> bool:
        """Whether it certifies local infeasibility: a minimum with a clear violation."""
        return self.minimum and bool(self.gives.max(initial=0.0) >= CLEAR_VIOLATION)


def least_violation(
    nlp: Nlp, start: np.ndarray, callback: Callback, *, max_iterations: int, max_time: float
) -> ElasticPoint:
    """Minimise the sum of violations near scaled variables ``start``, by IPOPT.

    Args:
        nlp: The NLP, with an exact Hessian.
        start: Scaled variables (n_unknowns,).
        callback: Callback as of a solver; it reads the variables of the NLP, without slacks.
        max_iterations: Limit of iterations in total.
        max_time: Limit of wall time, s.
    """
    deadline, missed = time.perf_counter() + max_time, np.inf
    point, spent, seconds = None, 0, 0.0
    while True:
        prox, options, x = (FIRST_PROX, _FIRST, start) if point is None else (LATER_PROX, _SECOND, point.x)
        left = max(deadline - time.perf_counter(), LEAST_TIME)
        point = _solved(nlp, x, counted_from(spent, callback), prox, options, max_iterations - spent, left)
        spent, seconds = spent + point.iterations, seconds + point.function_time
        settled = prox == LATER_PROX and point.missed > FALL_SHARE * missed
        if settled or point.feasible or not point.minimum or spent >= max_iterations:
            break
        missed = point.missed
    return replace(point, minimum=point.minimum and settled, iterations=spent, function_time=seconds)


def counted_from(number: int, callback: Callback) -> Callback:
    """Return a callback that counts iterations from ``number``, for a solve that continues another."""
    return lambda figures, read: callback({**figures, "iteration": figures["iteration"] + number}, read)


def _solved(
    nlp: Nlp,
    start: np.ndarray,
    callback: Callback,
    prox: float,
    options: dict[str, Option],
    max_iterations: int,
    max_time: float,
) -> ElasticPoint:
    """Solve one elastic problem with its centre at the start."""
    t = nlp.transcription
    x = np.clip(start, t.lower_x, t.upper_x)
    n, (rows, signs) = len(x), _slacks(t.lower_g, t.upper_g)
    values, n_slacks = np.asarray(nlp.engine.g(x)), len(rows)
    missing = np.maximum(t.lower_g - values, 0.0) - np.maximum(values - t.upper_g, 0.0)
    first = np.maximum(signs * missing[rows], 0.0) + FIRST_SLACK
    push = PUSH * float(options["mu_init"])
    names = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")
    raw = _engine.solve_ipopt(
        _with_slacks(nlp, rows, signs, x, prox),
        np.concatenate([x, first]),
        np.concatenate([t.lower_x, np.zeros(n_slacks)]),
        np.concatenate([t.upper_x, np.full(n_slacks, np.inf)]),
        t.lower_g,
        t.upper_g,
        {
            **IPOPT_OPTIONS,
            "mu_strategy": "monotone",
            **dict.fromkeys(names, push),
            **options,
            "max_iter": max_iterations,
            "max_wall_time": max_time,
        },
        lambda figures, read: callback(figures, lambda: read()[:n]),
        stage=np.concatenate([t.layout.stage_numbers, np.full(n_slacks, _engine.ALONE, dtype=np.int32)]),
    )
    return ElasticPoint(
        x=raw["x"][:n],
        gives=np.bincount(rows, raw["x"][n:], minlength=t.n_rows),
        weights=np.concatenate([raw["lam_g"], raw["lam_x"][:n]]),
        minimum=raw["status"] == "Solve_Succeeded",
        stopped=raw["status"] == "User_Requested_Stop",
        iterations=raw["iterations"],
        function_time=raw["function_time"],
    )


def _slacks(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and signs (n_slacks,) of the slacks: +1 for each lower bound, -1 for each upper bound."""
    lower, upper = np.flatnonzero(np.isfinite(low)), np.flatnonzero(np.isfinite(high))
    rows = np.concatenate([lower, upper])
    return rows, np.concatenate([np.ones(len(lower)), -np.ones(len(upper))])


def _with_slacks(
    nlp: Nlp, rows: np.ndarray, signs: np.ndarray, centre: np.ndarray, prox: float
) -> _engine.Nlp:
    """Return the NLP without its costs, with slacks after its variables and the elastic objective."""
    old, n, count = nlp.parts, len(centre), len(rows)
    total, linear = n + count, nlp.transcription.linear
    columns = n + np.arange(count)
    whole = SparseMatrix.of_entries(
        (old["n_g"], total),
        np.concatenate([linear.row, rows]),
        np.concatenate([linear.indices, columns]),
        np.concatenate([old["a_data"], signs]),
    )
    jacobian = _Merged(total, old["jac_row"], old["jac_col"], rows, columns)
    hessian = _Merged(total, old["hess_row"], old["hess_col"], np.arange(total), np.arange(total))
    constant = np.zeros(len(jacobian.keys))
    constant[jacobian.kept] = old["jac_const"]
    constant[jacobian.added] = signs
    groups = [
        {
            **group,
            "cost_weight": np.zeros_like(group["cost_weight"]),
            "jac_target": jacobian.kept[group["jac_target"]],
            "hess_target": hessian.kept[group["hess_target"]],
        }
        for group in old["groups"]
    ]
    return _engine.Nlp(
        n_x=total,
        n_g=old["n_g"],
        a_indptr=whole.indptr,
        a_indices=whole.indices,
        a_data=whole.data,
        jac_row=jacobian.row,
        jac_col=jacobian.column,
        jac_const=constant,
        hess_row=hessian.row,
        hess_col=hessian.column,
        groups=[*groups, _prices(centre, count, prox, hessian.added)],
        threads=old["threads"],
    )


class _Merged:
    """A sparsity pattern with added entries: its rows and columns, and positions of old and new entries."""

    def __init__(
        self, width: int, row: np.ndarray, column: np.ndarray, new_row: np.ndarray, new_column: np.ndarray
    ) -> None:
        old = row.astype(np.int64) * width + column
        new = new_row.astype(np.int64) * width + new_column
        self.keys = np.unique(np.concatenate([old, new]))
        self.row, self.column = (part.astype(np.int32) for part in np.divmod(self.keys, width))
        self.kept, self.added = (np.searchsorted(self.keys, part).astype(np.int32) for part in (old, new))


def _prices(centre: np.ndarray, n_slacks: int, prox: float, diagonal: np.ndarray) -> dict[str, Any]:
    """Return the objective as one group with a stage per variable: price z + prox/2 (z - centre)^2."""
    z, p, sigma = ca.SX.sym("z"), ca.SX.sym("p", 3), ca.SX.sym("sigma")
    cost, nothing = p[0] * z + p[1] / 2 * (z - p[2]) ** 2, ca.SX(0, 1)
    slope = ca.densify(ca.gradient(cost, z))
    value = ca.Function("value", [z, p], [cost, nothing])
    first = ca.Function("first", [z, p], [cost, nothing, slope, nothing])
    second = ca.Function("second", [z, p, sigma, ca.SX.sym("lam", 0)], [sigma * p[1]])
    n, none = len(centre) + n_slacks, np.zeros(0)
    on_x, on_slacks = np.zeros(len(centre)), np.zeros(n_slacks)
    parameters = [
        np.concatenate([on_x, on_slacks + 1]),
        np.concatenate([on_x + prox, on_slacks]),
        np.concatenate([centre, on_slacks]),
    ]
    return {
        "value": _engine.Tape(value),
        "first": _engine.Tape(first),
        "second": _engine.Tape(second),
        "x_offset": np.arange(n, dtype=np.int32),
        "nloc": 1,
        "gather_indptr": np.array([0, 1], dtype=np.int32),
        "gather_indices": np.array([0], dtype=np.int32),
        "gather_data": np.ones(1),
        "p": np.column_stack(parameters).ravel(),
        "cost_weight": np.ones(n),
        "row": np.zeros((n, 0), dtype=np.int32),
        "row_scale": none,
        "jac_indptr": np.array([0], dtype=np.int32),
        "jac_src": none.astype(np.int32),
        "jac_coef": none,
        "jac_target": np.zeros((n, 0), dtype=np.int32),
        "hess_indptr": np.array([0, 1], dtype=np.int32),
        "hess_src": np.array([0], dtype=np.int32),
        "hess_coef": np.ones(1),
        "hess_target": diagonal[:, None].copy(),
    }
