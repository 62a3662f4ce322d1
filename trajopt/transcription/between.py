"""Rows of terms between collocation points and between nodes, where the NLP does not impose them."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from trajopt._engine import Tape
from trajopt.transcription.timeline import StageKind
from trajopt.transcription.transcription import FunctionGroup, Transcription

# Moments at which a gap between points is evaluated, as fractions of it.
INSIDE = (1 / 3, 2 / 3)


@dataclass(frozen=True, kw_only=True)
class RowsBetween:
    """Rows of a point function at the same fraction of several intervals.

    Args:
        stages: the intervals (n,).
        fraction: fraction of the intervals.
        numbers: rows of the NLP (n_rows,) that state the same in the first of them.
        values: the rows over their units (n, n_rows).
    """

    stages: np.ndarray
    fraction: float
    numbers: np.ndarray
    values: np.ndarray

    def excess(self, transcription: Transcription) -> np.ndarray:
        """Violations (n, n_rows) over the unit, or over half the range of two bounds if that is smaller."""
        lower, upper = transcription.lower_g[self.numbers], transcription.upper_g[self.numbers]
        half = (upper - lower) / 2
        size = np.where((half > 0) & (half < 1), half, 1.0)
        return np.maximum(0.0, np.maximum(lower - self.values, self.values - upper) / size)


def rows_between(
    transcription: Transcription, values: Mapping[int, Tape], x: np.ndarray, names: frozenset[str]
) -> Iterator[RowsBetween]:
    """Evaluate the blocks of rows of these names between the points, or nodes, at which they are imposed.

    Args:
        transcription: the transcription.
        values: compiled values of point functions by their id.
        x: scaled variables (n_unknowns,).
        names: names of blocks of rows.
    """
    rows = transcription.rows
    chosen = np.array([name in names for name in rows.names])
    for group in transcription.groups:
        numbers = group.rows[0]
        own = chosen[rows.block[numbers]]
        if own.any() and rows.point[numbers[0]] <= 0:  # all points of an interval state the same
            between = _between_nodes if rows.point[numbers[0]] < 0 else _between_points
            for stages, fraction, given in between(transcription, values[id(group.point)], group, x):
                scaled = (given * group.row_scale)[:, own]
                yield RowsBetween(stages=stages, fraction=fraction, numbers=numbers[own], values=scaled)


def _fractions(transcription: Transcription, stage: int, points: bool) -> np.ndarray:
    """Fractions of an interval between its points, or its nodes; ends that are no points are included."""
    scheme = transcription.layout.scheme_of(int(transcription.layout.phase_of[stage]))
    edges = np.unique(np.concatenate([[0.0], scheme.c if points else np.zeros(0), [1.0]]))
    inner = [edges[:-1] + part * np.diff(edges) for part in INSIDE]
    ends = [end for end in (0.0, 1.0) if points and end not in scheme.c]
    return np.sort(np.concatenate([*inner, ends]))


def _windows(transcription: Transcription, stages: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Scaled variables (n, window) of intervals of one phase."""
    layout = transcription.layout
    size = layout.window_size(int(stages[0]))
    return np.asarray(x[layout.node_offset[stages][:, None] + np.arange(size)])


def _between_points(
    transcription: Transcription, point: Tape, group: FunctionGroup, x: np.ndarray
) -> Iterator[tuple[np.ndarray, float, np.ndarray]]:
    layout, stages = transcription.layout, group.stages
    loads = tuple(contact.name for contact in layout.contacts[int(layout.phase_of[stages[0]])])
    windows = _windows(transcription, stages, x)
    times, steps = layout.node_times[stages], layout.steps[stages]
    for fraction in _fractions(transcription, int(stages[0]), points=True).tolist():
        gather = transcription.collocation.moment_gather(int(stages[0]), fraction, loads)
        parameters = group.parameters.copy()
        for function, columns in group.varying:
            parameters[:, columns] = [function(time) for time in (times + fraction * steps).tolist()]
        _, rows = point([windows @ gather.toarray().T, parameters])
        yield stages, fraction, rows


def _between_nodes(
    transcription: Transcription, point: Tape, group: FunctionGroup, x: np.ndarray
) -> Iterator[tuple[np.ndarray, float, np.ndarray]]:
    """Rows of a node function in the intervals at whose ends it states the same."""
    layout, lower, upper = transcription.layout, transcription.lower_g, transcription.upper_g
    place = {int(stage): index for index, stage in enumerate(group.stages)}
    pairs = [
        (place[k], place[k + 1])
        for k in place
        if k + 1 in place
        and layout.stages[k].kind is StageKind.INTERVAL
        and np.array_equal(lower[group.rows[place[k]]], lower[group.rows[place[k + 1]]])
        and np.array_equal(upper[group.rows[place[k]]], upper[group.rows[place[k + 1]]])
    ]
    for phase in sorted({int(layout.phase_of[group.stages[begin]]) for begin, _ in pairs}):
        ends = np.array([pair for pair in pairs if int(layout.phase_of[group.stages[pair[0]]]) == phase])
        first = group.stages[ends[:, 0]]
        for fraction in _fractions(transcription, int(first[0]), points=False).tolist():
            nodes = np.array([_node(transcription, int(stage), fraction, x) for stage in first])
            weights = np.array([1 - fraction, fraction])
            parameters = np.einsum("j,njp->np", weights, group.parameters[ends])
            _, rows = point([nodes, np.ascontiguousarray(parameters)])
            yield first, fraction, rows


def _node(transcription: Transcription, stage: int, fraction: float, x: np.ndarray) -> np.ndarray:
    """Variables (size,) of a node at a fraction of an interval."""
    layout, form = transcription.layout, transcription.layout.forms[stage]
    gather = transcription.collocation.moment_gather(stage, fraction, ())
    z = (_windows(transcription, np.array([stage]), x) @ gather.toarray().T)[0]
    rotations, nv = len(form.rotations), form.coordinates.nv
    time_scales = layout.node(stage).start + form.time_scales
    scales = x[time_scales] * transcription.scale[time_scales]
    scale = 1.0 if form.time_scale is None else float(scales[form.time_scale])
    xi, rate = z[rotations : rotations + nv], z[rotations + nv : rotations + 2 * nv] / scale
    q, v, _ = form.coordinates.local_to_pinocchio(
        *(part[None] for part in (z[:rotations], xi, rate, 0 * rate))
    )
    state = form.coordinates.node_from_pinocchio(q[0], v[0])
    additive = rotations + np.arange(len(form.additive))
    state[additive] = xi[form.coordinates.additive_index]  # whole turns are kept
    return form.node(state, scales)
