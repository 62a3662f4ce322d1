"""Small optimal control problems in the engine's grouped form, and the same as one casadi expression."""

from dataclasses import dataclass, field

import casadi as ca
import numpy as np
from scipy import sparse

from trajopt import _engine

INFINITY = np.inf


@dataclass
class Group:
    """Point function phi(z), L(z) at z = gather x[offset : offset + nloc], and where its rows go."""

    cost: ca.Function  # (z, p) -> L
    rows: ca.Function  # (z, p) -> phi
    gather: sparse.csr_matrix
    offset: list[int]
    row: np.ndarray
    row_scale: np.ndarray
    weight: np.ndarray
    p: np.ndarray


@dataclass
class GroupedProblem:
    """Groups, linear part A x, bounds, start and stage sizes."""

    n_x: int
    n_g: int
    groups: list[Group]
    linear: sparse.csr_matrix
    lbx: np.ndarray
    ubx: np.ndarray
    lbg: np.ndarray
    ubg: np.ndarray
    x0: np.ndarray
    nx: np.ndarray
    nu: np.ndarray
    ng: np.ndarray
    patterns: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    def expression(self) -> dict[str, ca.SX]:
        """The whole problem as x, f, g."""
        x, g, f = ca.SX.sym("x", self.n_x), ca.SX.zeros(self.n_g), ca.SX(0)
        for group in self.groups:
            for k, offset in enumerate(group.offset):
                z = ca.mtimes(ca.DM(group.gather.toarray()), x[offset : offset + group.gather.shape[1]])
                f += group.weight[k] * group.cost(z, group.p[k])
                phi = group.rows(z, group.p[k])
                for j, row in enumerate(group.row[k]):
                    g[int(row)] += group.row_scale[j] * phi[j]
        return {"x": x, "f": f, "g": g + ca.mtimes(ca.DM(self.linear), x)}


def functions(group: Group) -> tuple[ca.Function, ca.Function, ca.Function]:
    """Value, first and second derivatives of a group's point function, as the engine calls them."""
    z, p = ca.SX.sym("z", group.gather.shape[0]), ca.SX.sym("p", group.p.shape[1])
    sigma, lam = ca.SX.sym("sigma"), ca.SX.sym("lam", group.row.shape[1])
    cost, phi = group.cost(z, p), group.rows(z, p)
    gamma = sigma * cost + ca.dot(lam, phi)
    first = [cost, phi, ca.densify(ca.gradient(cost, z)), ca.jacobian(phi, z)]
    return (
        ca.Function("value", [z, p], [cost, phi]),
        ca.Function("first", [z, p], first),
        ca.Function("second", [z, p, sigma, lam], [ca.tril(ca.hessian(gamma, z)[0])]),
    )


def _map(entries: dict[tuple[int, int], list[tuple[int, float]]]) -> tuple[np.ndarray, ...]:
    """Targets (row, column), and the CSR of their sources and coefficients."""
    targets = sorted(entries)
    counts = [len(entries[t]) for t in targets]
    flat = [pair for t in targets for pair in entries[t]]
    return (
        np.array([t[0] for t in targets], dtype=np.int32),
        np.array([t[1] for t in targets], dtype=np.int32),
        np.concatenate([[0], np.cumsum(counts)]).astype(np.int32),
        np.array([s for s, _ in flat], dtype=np.int32),
        np.array([c for _, c in flat], dtype=float),
    )


def _jacobian_map(pattern: ca.Sparsity, group: Group) -> tuple[np.ndarray, ...]:
    gather, entries = group.gather.toarray(), {}
    for source, (j, i) in enumerate(zip(*pattern.get_triplet(), strict=True)):
        for m in np.flatnonzero(gather[i]):
            entries.setdefault((j, int(m)), []).append((source, group.row_scale[j] * gather[i, m]))
    return _map(entries)


def _hessian_map(pattern: ca.Sparsity, group: Group) -> tuple[np.ndarray, ...]:
    gather, entries = group.gather.toarray(), {}
    for source, (i, j) in enumerate(zip(*pattern.get_triplet(), strict=True)):
        for a, b in {(i, j), (j, i)}:
            for m in np.flatnonzero(gather[a]):
                for n in np.flatnonzero(gather[b]):
                    if m >= n:
                        entries.setdefault((int(m), int(n)), []).append((source, gather[a, m] * gather[b, n]))
    return _map(entries)


def arguments(problem: GroupedProblem, threads: int = 1) -> dict[str, object]:
    """Keyword arguments of ``_engine.Nlp``."""
    jacobian, hessian, prepared = set(), set(), []
    linear = problem.linear.tocoo()
    jacobian.update(zip(linear.row.tolist(), linear.col.tolist(), strict=True))
    for group in problem.groups:
        made = functions(group)
        first, second = (
            _jacobian_map(made[1].sparsity_out(3), group),
            _hessian_map(made[2].sparsity_out(0), group),
        )
        at_stage = [
            (
                [(int(group.row[k, j]), o + int(m)) for j, m in zip(*first[:2], strict=True)],
                [(o + int(m), o + int(n)) for m, n in zip(*second[:2], strict=True)],
            )
            for k, o in enumerate(group.offset)
        ]
        for rows, curvature in at_stage:
            jacobian.update(rows)
            hessian.update(curvature)
        sources = [_engine.Tape(function) for function in made]
        prepared.append((group, sources, first, second, at_stage))
    jac_place = {key: place for place, key in enumerate(sorted(jacobian))}
    hess_place = {key: place for place, key in enumerate(sorted(hessian))}
    constant = np.zeros(len(jac_place))
    for row, column, value in zip(linear.row, linear.col, linear.data, strict=True):
        constant[jac_place[int(row), int(column)]] += value
    jac_row, jac_col = np.array(sorted(jacobian), dtype=np.int32).T.copy()
    hess_row, hess_col = np.array(sorted(hessian), dtype=np.int32).reshape(-1, 2).T.copy()
    problem.patterns = {"jacobian": (jac_row, jac_col), "hessian": (hess_row, hess_col)}
    groups = [
        {
            "value": sources[0], "first": sources[1], "second": sources[2],
            "x_offset": np.array(group.offset, dtype=np.int32),
            "nloc": group.gather.shape[1],
            "gather_indptr": group.gather.indptr.astype(np.int32),
            "gather_indices": group.gather.indices.astype(np.int32),
            "gather_data": group.gather.data,
            "p": group.p, "cost_weight": group.weight,
            "row": group.row.astype(np.int32), "row_scale": group.row_scale,
            "jac_indptr": first[2], "jac_src": first[3], "jac_coef": first[4],
            "jac_target": np.array([[jac_place[k] for k in s[0]] for s in at_stage], dtype=np.int32),
            "hess_indptr": second[2], "hess_src": second[3], "hess_coef": second[4],
            "hess_target": np.array([[hess_place[k] for k in s[1]] for s in at_stage], dtype=np.int32),
        }
        for group, sources, first, second, at_stage in prepared
    ]  # fmt: skip
    csr = problem.linear
    return {
        "n_x": problem.n_x, "n_g": problem.n_g, "threads": threads, "groups": groups,
        "a_indptr": csr.indptr.astype(np.int32), "a_indices": csr.indices.astype(np.int32),
        "a_data": csr.data,
        "jac_row": jac_row, "jac_col": jac_col, "jac_const": constant,
        "hess_row": hess_row, "hess_col": hess_col,
    }  # fmt: skip


def cart_pole(n: int = 20, force_limit: float = 12.0) -> GroupedProblem:
    """Swing-up in n Euler steps with a speed limit as a row and limits on force and position.

    Unknowns are in units of ``UNIT``; stage k is (position, angle, speed, rate), force. Rows of stage
    k are the gap x_(k+1) - F(x_k, u_k) = 0 and one path row; the last stage has a goal row.
    """
    unit, h = np.array([0.5, 2.0, 2.0, 4.0, 10.0]), 2.0 / n
    z, p = ca.SX.sym("z", 5), ca.SX.sym("p", 1)
    q, theta, v, w, force = ca.vertsplit(z)
    s, c = ca.sin(theta), ca.cos(theta)
    denominator = 1 + 0.3 * s**2
    a = (force + 0.3 * s * (0.5 * w**2 + 9.81 * c)) / denominator
    b = -(force * c + 0.3 * 0.5 * w**2 * s * c + 1.3 * 9.81 * s) / (0.5 * denominator)
    step = z[:4] + h * ca.vertcat(v, w, a, b)
    swing = Group(
        cost=ca.Function("L", [z, p], [h * (p * force**2 / 100 + 0.1 * w**2 + 0.01 * q**2)]),
        rows=ca.Function("phi", [z, p], [ca.vertcat(-step, v * v + 0.1 * c)]),
        gather=sparse.csr_matrix(np.diag(unit)),
        offset=[5 * k for k in range(n)],
        row=np.array([[5 * k + j for j in range(5)] for k in range(n)]),
        row_scale=np.concatenate([1 / unit[:4], [0.25]]),
        weight=1.0 + 0.01 * np.arange(n),
        p=np.linspace(1.0, 1.5, n)[:, None],
    )
    y, none = ca.SX.sym("y", 2), ca.SX.sym("p", 0)
    mix = np.array([[0.0, 1.0, 0.0, 0.2], [0.0, 0.0, 0.5, 1.0]]) * unit[:4]  # not a selection of unknowns
    goal = Group(
        cost=ca.Function("L", [y, none], [5 * (1 + ca.cos(y[0])) + y[1] ** 2]),
        rows=ca.Function("phi", [y, none], [ca.sin(y[0]) + y[1] ** 2]),
        gather=sparse.csr_matrix(mix),
        offset=[5 * n],
        row=np.array([[5 * n]]),
        row_scale=np.array([2.0]),
        weight=np.ones(1),
        p=np.zeros((1, 0)),
    )
    n_x, n_g = 5 * n + 4, 5 * n + 1
    linear = sparse.lil_matrix((n_g, n_x))
    for k in range(n):
        linear[range(5 * k, 5 * k + 4), range(5 * k + 5, 5 * k + 9)] = 1.0
    linear[4, 0] = 0.3
    lower, upper = -INFINITY * np.ones(n_x), INFINITY * np.ones(n_x)
    lower[4 : 5 * n : 5], upper[4 : 5 * n : 5] = -force_limit / unit[4], force_limit / unit[4]
    upper[5 * np.arange(1, n + 1)] = 1.2
    lower[:4] = upper[:4] = 0.0
    lower_g, upper_g = np.zeros(n_g), np.zeros(n_g)
    lower_g[4 : 5 * n : 5], upper_g[4 : 5 * n : 5] = -INFINITY, 2.5
    lower_g[-1], upper_g[-1] = -0.4, 0.4
    start = np.zeros((n + 1, 5))
    start[:, 1] = np.linspace(0, np.pi, n + 1) / unit[1]
    start[:, 4] = 0.1
    return GroupedProblem(
        n_x=n_x, n_g=n_g, groups=[swing, goal], linear=sparse.csr_matrix(linear),
        lbx=lower, ubx=upper, lbg=lower_g, ubg=upper_g, x0=start.ravel()[:n_x],
        nx=np.full(n + 1, 4, dtype=np.int32), nu=np.array([1] * n + [0], dtype=np.int32),
        ng=np.ones(n + 1, dtype=np.int32),
    )  # fmt: skip


def logarithm_well() -> GroupedProblem:
    """Minimise (x - 3)^2 - log(1 - x), no number beyond x = 1, from where Newton's first step goes there."""
    y, none = ca.SX.sym("y"), ca.SX.sym("p", 0)
    well = Group(
        cost=ca.Function("L", [y, none], [(y - 3) ** 2 - ca.log(1 - y)]),
        rows=ca.Function("phi", [y, none], [ca.SX(0, 1)]),
        gather=sparse.csr_matrix([[1.0]]),
        offset=[1],
        row=np.zeros((1, 0), dtype=int),
        row_scale=np.zeros(0),
        weight=np.ones(1),
        p=np.zeros((1, 0)),
    )
    free = np.full(2, np.inf)
    return GroupedProblem(
        n_x=2, n_g=1, groups=[well], linear=sparse.csr_matrix([[-1.0, 1.0]]),
        lbx=-free, ubx=free, lbg=np.zeros(1), ubg=np.zeros(1), x0=np.array([-5.0, -5.0]),
        nx=np.ones(2, dtype=np.int32), nu=np.zeros(2, dtype=np.int32), ng=np.zeros(2, dtype=np.int32),
    )  # fmt: skip


def dense(shape, place, values):
    matrix = np.zeros(shape)
    np.add.at(matrix, place, values)
    return matrix


def dense_jacobian(nlp, problem, x):
    return dense((problem.n_g, problem.n_x), problem.patterns["jacobian"], nlp.jacobian(x))
