"""The elastic problem: how near to feasible can an iterate come?

Every row may be violated at a price of one per scaled unit, and the objective is left out:

    min over x, s   sum s + prox/2 |x - centre|^2
    with   low <= g(x) + s_low - s_high <= high,   s >= 0,   bounds of x

(Nocedal and Wright, "Numerical Optimization", 2006, chapter 17.2.) A point where nothing is violated is
feasible. A minimum with a violation above zero is a certificate that the problem is infeasible near it; then
the multipliers, at most one in magnitude, say which rows and bounds stand against those that give way.
Steps of the solver are regular wherever it starts, as slacks make up for what the rows lack: where a solver
of the problem itself creeps, this takes 15 to 50 iterations. prox selects the nearest of equal minima; as it
may also hold the variables back, what is found is solved again from there with a smaller one, until the
violation stays.
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

# Weights of the distance from the start, of the first minimum and of those that are searched from there. With
# ten times the second, tall hops and long jumps that can be done end at a violation.
FAR, NEAR = 1e-4, 1e-6
# A violation of one row that is clear, and one that a solver can mend, in scaled units. Measured: points of
# feasible problems end below 1e-3, of infeasible ones above 1.2e-2: the gap is narrow near what can just be
# done, and a point between them is no verdict.
CLEAR, MENDED = 1e-2, 1e-3
# A minimum below this fraction of the last one says that prox had held that back: the violation may fall on.
HELD_BACK = 0.5
# Slacks start this far beyond the violations: well inside their bounds for the first barrier.
FIRST_SLACK = 1e-3
# A certificate needs few digits, the way to it fewer. Barriers are small, as both start near an iterate.
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
# Distance of the start from bounds, over the first barrier.
PUSH = 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class ElasticPoint:
    """Where the solver of the elastic problem ended, in scaled units.

    x: variables (n_unknowns,). gives (n_rows,): by how much each row gives way. weights (n_rows +
    n_unknowns,): multipliers of rows, then of bounds. minimum: it is one, not held back by prox. stopped: by
    the callback. iterations, and function_time in s: what was spent.
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
        """Sum of the violations that no solver would mend."""
        return float(self.gives[self.gives > MENDED].sum())

    @property
    def feasible(self) -> bool:
        """Whether hardly anything is violated."""
        return bool(self.gives.max(initial=0.0) <= MENDED) and not self.stopped

    @property
    def infeasible(self) -> bool:
        """Whether the violation is clear and cannot be reduced nearby: a certificate."""
        return self.minimum and bool(self.gives.max(initial=0.0) >= CLEAR)


def least_violation(
    nlp: Nlp, start: np.ndarray, callback: Callback, *, max_iterations: int, max_time: float
) -> ElasticPoint:
    """The least sum of violations near scaled variables ``start``, by IPOPT.

    Args:
        nlp: With an exact Hessian.
        start: Scaled variables (n_unknowns,).
        callback: As of a solver; the variables it may read are those of the NLP.
        max_iterations: Limit of iterations in all.
        max_time: Limit of wall time, s.
    """
    deadline, missed = time.perf_counter() + max_time, np.inf
    point, spent, seconds = None, 0, 0.0
    while True:
        prox, options, x = (FAR, _FIRST, start) if point is None else (NEAR, _SECOND, point.x)
        left = max(deadline - time.perf_counter(), LEAST_TIME)
        point = _solved(nlp, x, counted_from(spent, callback), prox, options, max_iterations - spent, left)
        spent, seconds = spent + point.iterations, seconds + point.function_time
        settled = prox == NEAR and point.missed > HELD_BACK * missed
        if settled or point.feasible or not point.minimum or spent >= max_iterations:
            break
        missed = point.missed
    return replace(point, minimum=point.minimum and settled, iterations=spent, function_time=seconds)


def counted_from(number: int, callback: Callback) -> Callback:
    """The callback of a solve that goes on after ``number`` iterations of another."""
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
    """One elastic problem with its centre at the start."""
    t = nlp.transcription
    x = np.clip(start, t.lower_x, t.upper_x)
    n, (rows, signs) = len(x), _slacks(t.lower_g, t.upper_g)
    values, n_slacks = np.asarray(nlp.engine.g(x)), len(rows)
    lacking = np.maximum(t.lower_g - values, 0.0) - np.maximum(values - t.upper_g, 0.0)
    first = np.maximum(signs * lacking[rows], 0.0) + FIRST_SLACK
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
    """Rows and signs (n_slacks,) of the slacks: one up for every lower bound, one down for every upper."""
    lower, upper = np.flatnonzero(np.isfinite(low)), np.flatnonzero(np.isfinite(high))
    rows = np.concatenate([lower, upper])
    return rows, np.concatenate([np.ones(len(lower)), -np.ones(len(upper))])


def _with_slacks(
    nlp: Nlp, rows: np.ndarray, signs: np.ndarray, centre: np.ndarray, prox: float
) -> _engine.Nlp:
    """The NLP's functions without its costs, slacks behind its variables, and the price of both."""
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
    """A pattern with further entries: all rows and columns, and where kept and added entries are."""

    def __init__(
        self, width: int, row: np.ndarray, column: np.ndarray, new_row: np.ndarray, new_column: np.ndarray
    ) -> None:
        old = row.astype(np.int64) * width + column
        new = new_row.astype(np.int64) * width + new_column
        self.keys = np.unique(np.concatenate([old, new]))
        self.row, self.column = (part.astype(np.int32) for part in np.divmod(self.keys, width))
        self.kept, self.added = (np.searchsorted(self.keys, part).astype(np.int32) for part in (old, new))


def _prices(centre: np.ndarray, n_slacks: int, prox: float, diagonal: np.ndarray) -> dict[str, Any]:
    """The objective as one group, a stage for every variable: price z + prox/2 (z - centre)^2."""
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
