"""Ranges of variables, rows, derivatives and multipliers in the solver's units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from trajopt.solving.diagnosis.snapshot import Snapshot

# Row or column norms that differ from one by this factor slow a solver down, because its tolerances then have
# different meanings in different rows.
FAR_NORM = 1e4
# Relative magnitude below which entries are rounding; those of scaled functions are of order one.
ROUNDING = 1e-13


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Smallest and largest magnitude of entries above rounding; 0 if there are none."""

    smallest: float
    largest: float

    @classmethod
    def of(cls, values: np.ndarray) -> Spread:
        """Return the spread of an array."""
        magnitudes = np.abs(values)
        magnitudes = magnitudes[magnitudes > ROUNDING * max(1.0, magnitudes.max(initial=0.0))]
        return cls(
            smallest=float(magnitudes.min()) if len(magnitudes) else 0.0,
            largest=float(magnitudes.max(initial=0.0)),
        )

    @property
    def far(self) -> float:
        """Largest factor between a magnitude and one."""
        return max(self.largest, 1 / self.smallest) if self.smallest > 0 else 1.0

    def __str__(self) -> str:
        return f"{self.smallest:.0e} to {self.largest:.0e}"


@dataclass(frozen=True, kw_only=True)
class BlockScale:
    """Scale of a block of rows: count, norms and entries of its Jacobian, multipliers (or None)."""

    block: str
    rows: int
    row_norm: Spread
    entries: Spread
    multiplier: Spread | None


@dataclass(frozen=True, kw_only=True)
class KindScale:
    """Scale of the variables of one kind.

    value: scaled values. unit: SI value of a scaled unit. column_norm: of the Jacobian.
    hessian: diagonal entries of the Lagrangian's Hessian.
    """

    kind: str
    unknowns: int
    value: Spread
    unit: Spread
    column_norm: Spread
    hessian: Spread


@dataclass(frozen=True, kw_only=True)
class Scaling:
    """Scales of blocks and kinds, those with norms farthest from one first."""

    blocks: tuple[BlockScale, ...]
    kinds: tuple[KindScale, ...]
    jacobian: Spread
    hessian: Spread
    gradient: Spread

    @property
    def worst_blocks(self) -> tuple[BlockScale, ...]:
        """Blocks with row norms or multipliers beyond `FAR_NORM`."""
        return tuple(
            block
            for block in self.blocks
            if block.row_norm.far > FAR_NORM
            or (block.multiplier is not None and block.multiplier.largest > FAR_NORM)
        )

    @property
    def worst_kinds(self) -> tuple[KindScale, ...]:
        """Kinds of variables with values or column norms beyond `FAR_NORM`."""
        return tuple(k for k in self.kinds if k.column_norm.far > FAR_NORM or k.value.largest > FAR_NORM)


def scaling(snapshot: Snapshot) -> Scaling:
    """Return the scales at one iterate."""
    jacobian, hessian = snapshot.jacobian, snapshot.hessian
    rows, columns = sparse.linalg.norm(jacobian, axis=1), sparse.linalg.norm(jacobian, axis=0)
    return Scaling(
        blocks=_blocks(snapshot, rows),
        kinds=_kinds(snapshot, columns, hessian.diagonal()),
        jacobian=Spread.of(jacobian.data),
        hessian=Spread.of(hessian.data),
        gradient=Spread.of(snapshot.gradient),
    )


def _blocks(snapshot: Snapshot, norms: np.ndarray) -> tuple[BlockScale, ...]:
    info, known = snapshot.transcription.rows, snapshot.row_multiplier
    members = [np.flatnonzero(info.block == index) for index in range(len(info.names))]
    blocks = [
        BlockScale(
            block=name,
            rows=len(rows),
            row_norm=Spread.of(norms[rows]),
            entries=Spread.of(snapshot.jacobian[rows].data),
            multiplier=None if known is None else Spread.of(known[rows]),
        )
        for name, rows in zip(info.names, members, strict=True)
    ]
    return tuple(sorted(blocks, key=lambda block: -block.row_norm.far))


def _kinds(snapshot: Snapshot, norms: np.ndarray, diagonal: np.ndarray) -> tuple[KindScale, ...]:
    labels = np.array([label.kind for label in snapshot.names.unknown_labels])
    free = ~snapshot.fixed
    members = {kind: np.flatnonzero((labels == kind) & free) for kind in dict.fromkeys(labels.tolist())}
    kinds = [
        KindScale(
            kind=kind,
            unknowns=len(variables),
            value=Spread.of(snapshot.x[variables]),
            unit=Spread.of(snapshot.transcription.scale[variables]),
            column_norm=Spread.of(norms[variables]),
            hessian=Spread.of(diagonal[variables]),
        )
        for kind, variables in members.items()
        if len(variables)
    ]
    return tuple(sorted(kinds, key=lambda one: -one.column_norm.far))
