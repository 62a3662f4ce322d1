"""Rows of the NLP in order: names, places and bounds."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from trajopt.terms.interfaces import Rows
from trajopt.transcription.layout import Layout
from trajopt.transcription.sparse_maps import SparseMatrix


@dataclass(frozen=True, kw_only=True)
class RowInfo:
    """For every row: index of its block in ``names``, its stage, and its point (-1 at a node or gap)."""

    names: tuple[str, ...]
    block: np.ndarray
    stage: np.ndarray
    point: np.ndarray


@dataclass(frozen=True)
class LinearRows:
    """Linear rows at a node: ``coefficients`` (n, n_unknowns) over scaled variables, scaled bounds (n,)."""

    name: str
    node: int
    coefficients: SparseMatrix
    lower: np.ndarray
    upper: np.ndarray


def over_unknowns(layout: Layout, blocks: Iterable[tuple[int, np.ndarray]]) -> SparseMatrix:
    """Stack blocks (node, (n, size)) over single nodes into rows over all variables."""
    rows, columns, values, n = [], [], [], 0
    for node, block in blocks:
        local, n = np.nonzero(block), len(block)
        rows.append(local[0])
        columns.append(layout.node(node).start + local[1])
        values.append(block[local])
    entries = (np.concatenate(part) for part in (rows, columns, values))
    return SparseMatrix.of_entries((n, layout.n_unknowns), *entries)


@dataclass
class RowCollection:
    """Rows collected in order while transcribing, with their scaled bounds."""

    names: list[str] = field(default_factory=list)
    block: list[np.ndarray] = field(default_factory=list)
    stage: list[np.ndarray] = field(default_factory=list)
    point: list[np.ndarray] = field(default_factory=list)
    lower: list[np.ndarray] = field(default_factory=list)
    upper: list[np.ndarray] = field(default_factory=list)
    count: int = 0

    def add_blocks(self, blocks: Iterable[tuple[str, Rows]], stage: int, point: int) -> np.ndarray:
        """Append the rows of named blocks and return their indices."""
        parts = [
            self.add(name, stage, point, rows.lower / rows.unit, rows.upper / rows.unit)
            for name, rows in blocks
        ]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int32)

    def add(self, name: str, stage: int, point: int, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Append rows with these scaled bounds and return their indices."""
        if name not in self.names:
            self.names.append(name)
        n = len(lower)
        for target, value in ((self.block, self.names.index(name)), (self.stage, stage), (self.point, point)):
            target.append(np.full(n, value, dtype=np.int32))
        self.lower.append(lower)
        self.upper.append(upper)
        first, self.count = self.count, self.count + n
        return np.arange(first, self.count, dtype=np.int32)

    def info(self) -> RowInfo:
        """Block, stage and point of every row."""
        return RowInfo(
            names=tuple(self.names),
            block=np.concatenate(self.block),
            stage=np.concatenate(self.stage),
            point=np.concatenate(self.point),
        )
