"""From a transcription and compiled point functions to the engine's sparse NLP."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from trajopt import _engine
from trajopt.errors import InputError, shown
from trajopt.transcription.compilation import CompiledPoint
from trajopt.transcription.hessians import DEFAULT_HESSIAN
from trajopt.transcription.sparse_maps import DerivativeMap, hessian_map, jacobian_map
from trajopt.transcription.transcription import FunctionGroup, Transcription

if TYPE_CHECKING:
    from scipy import sparse


@dataclass(frozen=True, kw_only=True)
class Nlp:
    """The NLP in scaled variables and rows, ready to be solved.

    ``engine`` evaluates it and was built from ``parts``. ``row`` and ``column`` are the indices of the
    Jacobian's nonzeros, ``hessian_row`` and ``hessian_column`` those of the lower triangle of the
    Lagrangian's Hessian or its replacement; ``hessian`` is one of ``hessians.HESSIANS``.
    """

    transcription: Transcription
    engine: _engine.Nlp
    row: np.ndarray
    column: np.ndarray
    hessian_row: np.ndarray
    hessian_column: np.ndarray
    parts: Mapping[str, Any] = field(repr=False)
    hessian: str = DEFAULT_HESSIAN

    def jacobian(self, x: np.ndarray) -> "sparse.csr_matrix":
        """Jacobian (n_rows, n_unknowns) of the rows at scaled variables ``x`` (n_unknowns,)."""
        from scipy import sparse  # slow to import

        entries = np.array(self.engine.jacobian(x)), (self.row, self.column)
        return sparse.csr_matrix(entries, shape=(self.transcription.n_rows, len(x)))

    def lagrangian_hessian(self, x: np.ndarray, multipliers: np.ndarray) -> "sparse.csr_matrix":
        """Hessian (n_unknowns, n_unknowns) of f + multipliers . g at scaled variables ``x`` (n_unknowns,)."""
        from scipy import sparse  # slow to import

        entries = np.array(self.engine.hessian(x, 1.0, multipliers)), (self.hessian_row, self.hessian_column)
        lower = sparse.csr_matrix(entries, shape=(len(x), len(x)))
        return (lower + sparse.tril(lower, -1).T).tocsr()


class _Pattern:
    """Union of sparsity patterns, and the index of each entry among its sorted nonzeros."""

    def __init__(self, width: int) -> None:
        self.width, self.keys = width, [np.zeros(0, dtype=np.int64)]

    def add(self, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        key = row.astype(np.int64) * self.width + column
        self.keys.append(key.ravel())
        return key

    def close(self) -> tuple[np.ndarray, np.ndarray]:
        keys = np.sort(np.concatenate(self.keys))  # many times faster here than NumPy's unique
        self.sorted = keys[np.diff(keys, prepend=-1) > 0]
        return (self.sorted // self.width).astype(np.int32), (self.sorted % self.width).astype(np.int32)

    def places(self, key: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(np.searchsorted(self.sorted, key).astype(np.int32))


def assemble(
    transcription: Transcription,
    compiled: Mapping[int, CompiledPoint],
    threads: int = 1,
    hessian: str = DEFAULT_HESSIAN,
) -> Nlp:
    """Build the engine's NLP; ``compiled`` maps id(point function) to its compiled derivatives.

    Raises InputError unless ``threads`` is a whole number of at least 1.
    """
    if not isinstance(threads, (int, np.integer)) or threads < 1:
        raise InputError(f"threads is {shown(threads)}", "allowed: 1 or more")
    n = transcription.layout.n_unknowns
    jacobian, curvature = _Pattern(n), _Pattern(n)
    linear = transcription.linear
    linear_key = jacobian.add(linear.row, linear.indices)
    prepared = []
    for group in transcription.groups:
        point = compiled[id(group.point)]
        offset = transcription.layout.node_offset[group.stages]
        first = jacobian_map(point.first.pattern(3), group.gather, group.row_scale)
        second = hessian_map(point.second.pattern(0), group.gather)
        first_key = jacobian.add(group.rows[:, first.row], offset[:, None] + first.column[None, :])
        second_key = curvature.add(
            offset[:, None] + second.row[None, :], offset[:, None] + second.column[None, :]
        )
        prepared.append((group, point, offset, first, first_key, second, second_key))
    row, column = jacobian.close()
    hessian_row, hessian_column = curvature.close()
    constant = np.zeros(len(row))
    np.add.at(constant, jacobian.places(linear_key), linear.data)
    groups = [
        _engine_group(group, point, offset, first, jacobian.places(k1), second, curvature.places(k2))
        for group, point, offset, first, k1, second, k2 in prepared
    ]
    parts: dict[str, Any] = {
        "n_x": n,
        "n_g": transcription.n_rows,
        "a_indptr": linear.indptr,
        "a_indices": linear.indices,
        "a_data": linear.data,
        "jac_row": row,
        "jac_col": column,
        "jac_const": constant,
        "hess_row": hessian_row,
        "hess_col": hessian_column,
        "groups": groups,
        "threads": threads,
    }
    return Nlp(
        transcription=transcription,
        engine=_engine.Nlp(**parts),
        parts=parts,
        row=row,
        column=column,
        hessian_row=hessian_row,
        hessian_column=hessian_column,
        hessian=hessian,
    )


def _engine_group(
    group: FunctionGroup,
    point: CompiledPoint,
    offset: np.ndarray,
    first: DerivativeMap,
    jac_target: np.ndarray,
    second: DerivativeMap,
    hess_target: np.ndarray,
) -> dict[str, Any]:
    gather = group.gather
    return {
        "value": point.value,
        "first": point.first,
        "second": point.second,
        "x_offset": np.ascontiguousarray(offset, dtype=np.int32),
        "nloc": gather.shape[1],
        "gather_indptr": gather.indptr,
        "gather_indices": gather.indices,
        "gather_data": gather.data,
        "p": np.ascontiguousarray(group.parameters),
        "cost_weight": np.ascontiguousarray(group.cost_weight),
        "row": np.ascontiguousarray(group.rows, dtype=np.int32),
        "row_scale": np.ascontiguousarray(group.row_scale),
        "jac_indptr": first.indptr,
        "jac_src": first.source,
        "jac_coef": first.coefficient,
        "jac_target": jac_target,
        "hess_indptr": second.indptr,
        "hess_src": second.source,
        "hess_coef": second.coefficient,
        "hess_target": hess_target,
    }
