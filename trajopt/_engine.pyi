"""The extension of trajopt/solvers/engine: a sparse NLP of functions at many stages, and its solvers."""

from collections.abc import Callable, Mapping
from typing import Any, TypedDict

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Reals = NDArray[np.float64]
Indices = NDArray[np.int32]
# Changes with what a function becomes as a tape.
TAPE_VERSION: str

class Tape:
    """A function of scalar operations as a straight line of statements, run at eight points at once.

    Each expression is evaluated once; a product that is used once, in a sum, is rounded with it where the
    processor can. Raises ValueError for a function that is no SX function.
    """

    def __init__(self, function: ca.Function) -> None: ...
    @staticmethod
    def read(content: bytes, /) -> Tape:
        """The tape that `bytes` has written. Raises ValueError for anything else."""
    def bytes(self) -> bytes: ...
    def pattern(self, output: int, /) -> tuple[Indices, Indices]:
        """Rows and columns of an output's values."""
    def __call__(self, inputs: list[Reals], /) -> list[Reals]:
        """Values of each output (points, nonzeros) for inputs (points, nonzeros)."""
    @property
    def statements(self) -> int: ...
    @property
    def slots(self) -> int:
        """Intermediate values that are kept at a time, with inputs, constants and outputs."""

class Group(TypedDict):
    """One point function at n stages, on ``z = gather x[x_offset[k] : x_offset[k] + nloc]``.

    ``value(z, p) -> (L, phi)``, ``first(z, p) -> (L, phi, dense gradient of L, Jacobian of phi)``,
    ``second(z, p, sigma, lam) -> lower triangle of the Hessian of sigma L + lam . phi``. Stage k adds
    ``cost_weight[k] L`` to the objective and ``row_scale[j] phi[j]`` to row ``row[k, j]``. The Jacobian's
    nonzero ``jac_target[k, t]`` gains ``sum(jac_coef[e] * nonzeros[jac_src[e]])`` over the entries
    ``jac_indptr[t] <= e < jac_indptr[t + 1]``, with the scale of rows in ``jac_coef``; so does the Hessian.
    """

    value: Tape
    first: Tape
    second: Tape
    x_offset: Indices
    nloc: int
    gather_indptr: Indices
    gather_indices: Indices
    gather_data: Reals
    p: Reals
    cost_weight: Reals
    row: Indices
    row_scale: Reals
    jac_indptr: Indices
    jac_src: Indices
    jac_coef: Reals
    jac_target: Indices
    hess_indptr: Indices
    hess_src: Indices
    hess_coef: Reals
    hess_target: Indices

class Nlp:
    """Minimise f(x) with rows g(x): the groups' contributions and the linear rows ``A x``.

    ``jac_const`` is A on the Jacobian's pattern. Raises ValueError that names what does not fit.
    """

    def __init__(
        self,
        *,
        n_x: int,
        n_g: int,
        a_indptr: Indices,
        a_indices: Indices,
        a_data: Reals,
        jac_row: Indices,
        jac_col: Indices,
        jac_const: Reals,
        hess_row: Indices,
        hess_col: Indices,
        groups: list[Any],
        threads: int = 1,
    ) -> None: ...
    @property
    def n_x(self) -> int: ...
    @property
    def n_g(self) -> int: ...
    def f(self, x: Reals, /) -> float: ...
    def g(self, x: Reals, /) -> Reals: ...
    def gradient(self, x: Reals, /) -> Reals: ...
    def jacobian(self, x: Reals, /) -> Reals:
        """Nonzeros in the order of ``jac_row``, ``jac_col``."""
    def hessian(self, x: Reals, sigma: float, lam: Reals, /) -> Reals:
        """Nonzeros of ``sigma f + lam . g``, in the order of ``hess_row``, ``hess_col``."""
    def first_nonfinite(self, x: Reals, /) -> tuple[int, int, str, int] | None:
        """Where the first NaN or inf is: group, stage, output, index.

        The output is cost, rows, gradient, jacobian or hessian.
        """
    def set_group(
        self,
        group: int,
        gather_data: Reals,
        p: Reals,
        cost_weight: Reals,
        jac_coef: Reals,
        hess_coef: Reals,
    ) -> None:
        """Other numbers of a group at the same places. Raises ValueError for other sizes."""
    def set_linear(self, a_data: Reals, jac_const: Reals) -> None:
        """Other coefficients of the linear rows at the same places. Raises ValueError for other sizes."""
    def timings(self) -> dict[str, tuple[float, int]]:
        """Seconds and evaluations of value, first and second since the last solve began."""

class Iterate(TypedDict):
    """Variables, slacks of inequalities, multipliers of rows and bounds; what the next step needs."""

    x: Reals
    s: Reals
    y: Reals
    lower_x: Reals
    upper_x: Reals
    lower_s: Reals
    upper_s: Reals
    barrier: float
    regularization: float

class StepReport(TypedDict):
    """Residuals before a step, what it did, and rows ``after`` it; steps are zero without a factorisation."""

    primal: float
    dual: float
    complementarity: float
    primal_step: float
    dual_step: float
    regularization: float
    barrier: float
    after: float
    factorizations: int

class InteriorPoint:
    """Steps of a primal-dual interior-point method; see engine/interior_point.hpp.

    Bounds that are equal fix a variable or make an equality, the same in all calls. ``stage`` as in
    `solve_ipopt`. Raises ValueError for what does not fit.
    """

    def __init__(
        self, nlp: Nlp, lbx: Reals, ubx: Reals, lbg: Reals, ubg: Reals, stage: Indices, /
    ) -> None: ...
    @property
    def n_slacks(self) -> int: ...
    def complete(
        self,
        x: Reals,
        y: Reals,
        lbx: Reals,
        ubx: Reals,
        lbg: Reals,
        ubg: Reals,
        barrier: float,
        push: float,
    ) -> Iterate:
        """An iterate of these variables and multipliers of rows, at least ``push`` inside its bounds."""
    def steps(
        self,
        iterate: Iterate,
        lbx: Reals,
        ubx: Reals,
        lbg: Reals,
        ubg: Reals,
        compliance: Reals,
        barrier: float,
        most_barrier: float,
        fraction: float = 0.995,
        tolerance: float = 0.0,
        seconds: float = 0.0,
        steps: int = 1,
        least_steps: int = 1,
    ) -> tuple[Iterate, list[StepReport]]:
        """Newton steps; ``compliance`` of each row, 0 for a hard one.

        ``barrier``: the least, from which short steps go away, up to ``most_barrier``. No step begins after
        ``seconds`` (0: no limit), nor where residuals are below ``tolerance`` after ``least_steps``.
        """

# Instead of the stage of a variable that is in one row only, with positive curvature of its own: a slack.
ALONE: int

def solve_kkt(
    n_x: int,
    n_equal: int,
    n_unequal: int,
    stage: Indices,
    row: Indices,
    column: Indices,
    value: Reals,
    rhs: Reals,
    threads: int = 1,
) -> tuple[Reals, int] | None:
    """Solve a KKT system stage by stage; None where it is singular.

    Unknowns: n_x variables, slacks of n_unequal rows, multipliers of n_equal rows, then of the n_unequal.
    ``stage`` as in `solve_ipopt`; entries of one triangle. Returns the solution and the number of negative
    eigenvalues.
    """

WIDEST_REGISTER: int  # of this processor, in bytes: 64 (AVX-512), 32 (AVX2 with FMA) or 16

def use_registers(bytes: int) -> None:
    """Use the kernels for registers of 16, 32 or 64 bytes, for tests; at first those of the widest."""

def product_rate(n: int, depth: int) -> float:
    """Operations a second of the symmetric product, n by n of this depth, by which fronts are eliminated."""

def solve_ipopt(
    nlp: Nlp,
    x0: Reals,
    lbx: Reals,
    ubx: Reals,
    lbg: Reals,
    ubg: Reals,
    options: Mapping[str, str | int | float],
    callback: Callable[[dict[str, Any], Callable[[], Reals]], bool | None] | None,
    lam_g0: Reals | None = None,
    lam_x0: Reals | None = None,
    stage: Indices | None = None,
) -> dict[str, Any]:
    """Solve with IPOPT; multipliers given make it a warm start.

    ``stage`` of each variable, k of one of node k, -1 - k of one of stage k between nodes k and k + 1, or
    `ALONE`, has the linear systems factorised stage by stage instead of by IPOPT's linear solver.

    The result has x, g, lam_g, lam_x (Lagrangian ``f + lam_g . g + lam_x . x``), f, primal, dual,
    complementarity (IPOPT's own, unscaled), max_violation (of rows and bounds, recomputed),
    iterations, status (ApplicationReturnStatus), wall_time, function_time, timings (s and how often), and
    operations: floating-point ones that the systems solved stage by stage need. ``callback`` gets
    iteration, objective, primal, dual, barrier, step, regularization, line_search, restoration;
    False or KeyboardInterrupt stops with the current iterate, another exception is raised when the
    solver has stopped. Raises ValueError that names an unknown option or a value not allowed.
    """
