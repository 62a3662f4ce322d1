"""Resample the multipliers of a solution onto the rows and bounds of another mesh of the same problem.

The multiplier of a row at a collocation point is a quadrature weight times a function of time,
lambda_i = h b_i lambda(t_i). The multiplier of a defect is a costate, itself a function of time. The
multiplier of a row or bound at all nodes of a phase is the node spacing times a function of time (Hager,
"Runge-Kutta methods in optimal control and the transformed adjoint system", Numerische Mathematik, 2000).
These functions are interpolated linearly in the fraction of their phase. Rows are matched by name, phase,
place and number; rows without a match start at zero, as without a warm start. Multipliers of moment rows are
shared among the rows of the same term in the same part of the phase, since moments change in each round.
Planes that a link carries are laid anew along each motion, and their rows start at zero.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from trajopt.motion.grid import mesh_of
from trajopt.motion.solution import Solution
from trajopt.solvers.result import WarmMultipliers
from trajopt.terms.moments import MomentConstraint, PlaneSide
from trajopt.transcription.layout import Layout
from trajopt.transcription.row_collection import RowInfo
from trajopt.transcription.timeline import StageKind
from trajopt.transcription.transcription import Transcription

# Fraction of an interval by which its points are moved inwards, since neighbouring intervals share an end.
INWARD_SHIFT = 1e-9


# Rows with the same block, phase, kind of place and number of rows are samples of one function.
_Key = tuple[str, int, str, int]


@dataclass(frozen=True)
class _Block:
    """Rows of one block at one place: their indices, fraction of the phase, and quadrature weight."""

    key: _Key
    rows: np.ndarray
    fraction: float
    weight: float


def with_multipliers(
    solution: Solution, transcription: Transcription, rows: np.ndarray, bounds: np.ndarray
) -> Solution:
    """Return the solution with its multipliers and their row labels; unchanged unless all are finite."""
    if not (np.isfinite(rows).all() and np.isfinite(bounds).all()):
        return solution
    info = transcription.rows
    return replace(
        solution,
        statistics=replace(solution.statistics, row_names=tuple(info.names)),
        row_multiplier=rows,
        bound_multiplier=bounds,
        row_place=np.column_stack([info.block, info.stage, info.point]),
    )


def resampled_multipliers(transcription: Transcription, solution: Solution) -> WarmMultipliers | None:
    """Return the solution's multipliers on the rows and bounds of ``transcription``; None if none fit."""
    if solution.row_multiplier is None or solution.bound_multiplier is None:
        return None
    old = _layout_of(transcription.layout, solution, solution.bound_multiplier)
    if old is None or (info := _rows_of(old, solution)) is None:
        return None
    new = transcription.layout
    rows, bounds = np.zeros(transcription.n_rows), np.zeros(new.n_unknowns)
    exchanged = transcription.problem.moment_constraints
    names = {term.name for term in exchanged}
    lasting = (block for block in _blocks(new, transcription.rows) if block.key[0] not in names)
    _resample(_blocks(old, info), solution.row_multiplier, lasting, rows)
    for term in exchanged:
        if isinstance(term, PlaneSide) and term.body is not None:
            continue
        before, after = (_at_moments(*known, term) for known in ((old, info), (new, transcription.rows)))
        _spread(before, solution.row_multiplier, after, rows)
    _resample(_nodes(old), solution.bound_multiplier, _nodes(new), bounds)
    return WarmMultipliers(lam_g=rows, lam_x=bounds)


def _resample(old: Iterable[_Block], known: np.ndarray, new: Iterable[_Block], result: np.ndarray) -> None:
    """Write the multipliers of new blocks to ``result``: linear interpolation, constant extrapolation."""
    members: defaultdict[_Key, list[_Block]] = defaultdict(list)
    for block in old:
        members[block.key].append(block)
    fractions = {key: [each.fraction for each in blocks] for key, blocks in members.items()}
    values = {
        key: np.array([known[each.rows] / each.weight for each in blocks]) for key, blocks in members.items()
    }
    for block in new:
        if block.key in members:
            columns, times = values[block.key].T, fractions[block.key]
            samples = [np.interp(block.fraction, times, column) for column in columns]
            result[block.rows] = block.weight * np.array(samples)


def _at_moments(layout: Layout, info: RowInfo, term: MomentConstraint) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows (n,) of a term and their intervals (n, 2), in fractions of its phase."""
    phase = layout.schedule.names.index(term.during)
    known = info.names.index(term.name) if term.name in info.names else -1
    stages = layout.intervals_of(phase)
    rows = np.flatnonzero((info.block == known) & np.isin(info.stage, stages))
    edges = np.array(layout.mesh.phases[phase].fractions)
    index = np.searchsorted(stages, info.stage[rows])
    return rows, np.column_stack([edges[index], edges[index + 1]])


def _spread(
    old: tuple[np.ndarray, np.ndarray],
    known: np.ndarray,
    new: tuple[np.ndarray, np.ndarray],
    result: np.ndarray,
) -> None:
    """Share the multipliers of moment rows among the new rows of the same interval, preserving their sum."""
    (rows, spans), (places, others) = old, new
    if not (len(rows) and len(places)):
        return
    overlap = np.minimum(spans[:, None, 1], others[:, 1]) - np.maximum(spans[:, None, 0], others[:, 0])
    overlap = np.where(overlap > 0, overlap, overlap == overlap.max(axis=1, keepdims=True))  # or the next one
    result[places] = known[rows] @ (overlap / overlap.sum(axis=1, keepdims=True))


def _layout_of(layout: Layout, solution: Solution, bounds: np.ndarray) -> Layout | None:
    """Return the layout on the solution's mesh; None if its number of variables differs."""
    mesh = mesh_of(solution)
    if len(mesh.phases) != len(layout.mesh.phases):
        return None
    old = replace(layout, mesh=mesh)
    return old if len(bounds) == old.n_unknowns else None


def _rows_of(old: Layout, solution: Solution) -> RowInfo | None:
    """Return the labels of the rows of the solution's multipliers; None if they do not fit the layout."""
    if solution.row_place is None:
        return None
    block, stage, point = solution.row_place.T
    points = [old.scheme_of(old.phase_at(k)).s for k in range(old.n_stages + 1)]
    outside = (stage < 0) | (stage > old.n_stages) | (point < -1)
    outside |= point >= np.array(points)[np.clip(stage, 0, old.n_stages)]
    if outside.any():
        return None
    return RowInfo(names=solution.statistics.row_names, block=block, stage=stage, point=point)


def _blocks(layout: Layout, info: RowInfo) -> Iterator[_Block]:
    """Yield all rows, grouped by block and place."""
    edges = np.flatnonzero(np.any(np.diff([info.block, info.stage, info.point], axis=1), axis=0)) + 1
    for rows in np.split(np.arange(len(info.block)), edges):
        if len(rows):
            block, stage, point = (int(each[rows[0]]) for each in (info.block, info.stage, info.point))
            yield _block(layout, info.names[block], stage, point, rows)


def _block(layout: Layout, name: str, k: int, point: int, rows: np.ndarray) -> _Block:
    transition = k < layout.n_stages and layout.stages[k].kind is not StageKind.INTERVAL
    if point >= 0:
        phase, (start, end) = _interval_in_phase(layout, k)
        method = layout.scheme_of(phase)
        c = float(method.c[point])
        inner = start + (c + INWARD_SHIFT * (0.5 - c)) * (end - start)
        weight = layout.steps[k] * method.b1[point]
        return _Block((name, phase, "point", len(rows)), rows, inner, weight)
    if name == "defect" and not transition:
        phase, (_, end) = _interval_in_phase(layout, k)
        return _Block((name, phase, "defect", len(rows)), rows, end, 1.0)
    if transition:
        kind = layout.stages[k].kind.value
        return _Block((name, int(layout.phase_of[k]), kind, len(rows)), rows, 0.0, 1.0)
    return _at_node(layout, name, k, rows)


def _at_node(layout: Layout, name: str, k: int, rows: np.ndarray) -> _Block:
    """Return a block at a node; the first and last node of a phase are separate kinds of place."""
    place = layout.timeline.places[k]
    if place is None:
        return _Block((name, layout.phase_at(k), "repeated", len(rows)), rows, 0.0, 1.0)
    phase, index = place
    mesh = layout.mesh.phases[phase]
    if index in (0, mesh.count):
        return _Block((name, phase, "first" if index == 0 else "last", len(rows)), rows, 0.0, 1.0)
    key = (name, phase, "node", len(rows))
    spacing = (mesh.widths[index - 1] + mesh.widths[index]) / 2
    return _Block(key, rows, mesh.fractions[index], layout.schedule.phases[phase].duration * spacing)


def _nodes(layout: Layout) -> Iterator[_Block]:
    """Yield the variables of every node; no other variables have bounds."""
    for k in range(layout.n_stages + 1):
        node = layout.node(k)
        yield _at_node(layout, "node", k, np.arange(node.start, node.stop))


def _interval_in_phase(layout: Layout, k: int) -> tuple[int, tuple[float, float]]:
    """Return the phase of an interval, and the interval's start and end as fractions of it."""
    phase = int(layout.phase_of[k])
    index = k - int(layout.intervals_of(phase)[0])
    fractions = layout.mesh.phases[phase].fractions
    return phase, (fractions[index], fractions[index + 1])
