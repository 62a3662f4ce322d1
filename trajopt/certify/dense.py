"""Worst figures of a motion at all times: sample between its samples, and more densely around the worst.

First one sample is added between each two neighbours of the file. Then each figure is sampled where the
parabola through its worst value and the neighbours has its vertex. All figures share all samples.
"""

from dataclasses import dataclass

import numpy as np

from trajopt.certify.contact_figures import ContactStarts, force_traces, place_traces
from trajopt.motion.consistency import REQUESTS, SAMPLED
from trajopt.motion.quantities import MotionQuantities
from trajopt.motion.solution import Solution
from trajopt.motion.traces import Trace, Traces

# Samples nearer than this fraction of an interval are the same.
LEAST_STEP = 1e-6
# Rounds of sampling around the worst: the second parabola is off by at most a tenth of the first's width.
ROUNDS = 2
# Local maxima of a figure sampled in each round: its highest sample may not be next to its highest peak.
PEAKS = 3


@dataclass(frozen=True, kw_only=True)
class DenseMotion:
    """A motion at samples of the file and between, in no order, with its figures there.

    ``plan`` has one row per sample; ``fractions`` (K,) locate the samples in their intervals.
    """

    plan: Solution
    fractions: np.ndarray
    traces: Traces


def figures_at(motion: MotionQuantities, starts: ContactStarts) -> Traces:
    """Return all figures that are judged at all times, at the samples of a motion."""
    return {
        **force_traces(motion),
        **motion.limit_traces,
        **place_traces(motion, starts),
        **motion.body_traces,
    }


def dense_motion(motion: MotionQuantities, traces: Traces, starts: ContactStarts) -> DenseMotion:
    """Sample a motion between its samples, at which its ``traces`` are known."""

    def look(numbers: np.ndarray, fractions: np.ndarray) -> DenseMotion:
        between = motion.between(numbers, fractions)
        return DenseMotion(plan=between.solution, fractions=fractions, traces=figures_at(between, starts))

    plan = motion.solution
    begin, end = plan.interval_t[plan.interval].T
    dense = DenseMotion(plan=plan, fractions=(plan.t - begin) / (end - begin), traces=traces)
    numbers, fractions = _gaps(plan.interval, dense.fractions)
    dense = _joined(dense, look(numbers, fractions))
    for _ in range(ROUNDS):
        numbers, fractions = _vertices(dense)
        if not len(numbers):
            break
        dense = _joined(dense, look(numbers, fractions))
    return dense


def _joined(one: DenseMotion, other: DenseMotion) -> DenseMotion:
    rows = {name: np.concatenate([getattr(one.plan, name), getattr(other.plan, name)]) for name in SAMPLED}
    traces = {
        name: Trace(
            values=np.concatenate([trace.values, other.traces[name].values]),
            counts=np.concatenate([trace.counts, other.traces[name].counts]),
            names=trace.names,
            margin=trace.margin,
        )
        for name, trace in one.traces.items()
    }
    return DenseMotion(
        plan=one.plan.with_arrays(impulse=None, impact_index=None, **dict.fromkeys(REQUESTS), **rows),
        fractions=np.concatenate([one.fractions, other.fractions]),
        traces=traces,
    )


def _gaps(numbers: np.ndarray, fractions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return interval numbers and fractions of the midpoints between neighbouring samples."""
    wide = (np.diff(numbers) == 0) & (np.diff(fractions) > LEAST_STEP)
    return numbers[:-1][wide], ((fractions[:-1] + fractions[1:]) / 2)[wide]


def _vertices(dense: DenseMotion) -> tuple[np.ndarray, np.ndarray]:
    """Return intervals and fractions of the vertices of parabolas through the worst samples of figures."""
    numbers, fractions = dense.plan.interval, dense.fractions
    order = np.lexsort((fractions, numbers))
    inner = (numbers[order[:-2]] == numbers[order[2:]]) & (np.diff(fractions[order], n=1)[:-1] > LEAST_STEP)
    inner &= np.diff(fractions[order], n=1)[1:] > LEAST_STEP
    before, middle, after = (order[i : len(order) - 2 + i][inner] for i in range(3))
    wanted: list[tuple[int, float]] = []
    for trace in dense.traces.values():
        for row, fraction in _peaks(trace, fractions, (before, middle, after)):
            wanted.append((int(numbers[row]), fraction))
    known: dict[int, list[float]] = {}
    for number, fraction in wanted:
        others = known.setdefault(number, [])
        if all(abs(fraction - other) > LEAST_STEP for other in others):
            others.append(fraction)
    chosen = [(number, fraction) for number, inside in known.items() for fraction in inside]
    return np.array([n for n, _ in chosen], dtype=int), np.array([f for _, f in chosen])


def _peaks(
    trace: Trace, fractions: np.ndarray, rows: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> list[tuple[int, float]]:
    """Return row and fraction of the vertices at the worst local maxima of a figure."""
    if not trace.counts.any():
        return []
    bad = trace.badness
    left, peak, right = (bad[order] for order in rows)
    high = np.isfinite(left) & np.isfinite(right) & (peak >= left) & (peak >= right)
    high &= peak > np.minimum(left, right)
    places = np.argwhere(high)
    if len(places) > PEAKS:
        places = places[np.argsort(-peak[high])[:PEAKS]]
    vertices = []
    for i, column in places:
        x = fractions[[order[i] for order in rows]]
        y = np.array([part[i, column] for part in (left, peak, right)])
        vertices.append((int(rows[1][i]), _vertex(x, y)))
    return [(row, fraction) for row, fraction in vertices if np.abs(fractions[row] - fraction) > LEAST_STEP]


def _vertex(x: np.ndarray, y: np.ndarray) -> float:
    """Return the vertex of the parabola through three points with a peak, clipped to the outer two."""
    left, right = (x[1] - x[0]) * (y[1] - y[2]), (x[1] - x[2]) * (y[1] - y[0])
    if not left - right > 0:
        return float(x[1])
    shift = 0.5 * ((x[1] - x[0]) * left - (x[1] - x[2]) * right) / (left - right)
    return float(np.clip(x[1] - shift, x[0], x[2]))
