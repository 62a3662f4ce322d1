"""Violated rows by block, phase and node, and places where a function is not finite."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from trajopt.transcription.nlp import Nlp
from trajopt.transcription.transcription import Transcription


def row_violations(nlp: Nlp, x: np.ndarray) -> np.ndarray:
    """Violation of every row, then of every variable's bounds, in scaled units (n_rows + n_unknowns,)."""
    t = nlp.transcription
    g = np.asarray(nlp.engine.g(x))
    return np.concatenate([_outside(g, t.lower_g, t.upper_g), _outside(x, t.lower_x, t.upper_x)])


def _outside(values: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    return np.maximum(0.0, np.maximum(lower - values, values - upper))


def worst_blocks(t: Transcription, x: np.ndarray, violations: np.ndarray, count: int) -> list[dict[str, Any]]:
    """The ``count`` blocks of rows with the largest violation, each where it is worst.

    Each entry has ``block``, ``phase``, ``node`` (for a point, its interval), ``point`` (or None), ``time``
    in s and ``violation`` in natural units. A value that is not finite counts as the worst, and is None.
    """
    violations = np.where(np.isfinite(violations), violations, np.inf)
    rows = violations[: t.n_rows]
    entries = []
    for index, name in enumerate(t.rows.names):
        members = np.flatnonzero(t.rows.block == index)
        worst = members[np.argmax(rows[members])]
        entries.append((rows[worst], name, int(t.rows.stage[worst]), int(t.rows.point[worst])))
    bounds = violations[t.n_rows :]
    worst = int(np.argmax(bounds))
    node = int(np.searchsorted(t.layout.node_offset, worst, side="right")) - 1
    entries.append((bounds[worst], "bounds", node, -1))
    entries.sort(key=lambda entry: -entry[0])
    times = t.layout.times(x * t.scale)
    return [_describe(t, times, *entry) for entry in entries[:count]]


def _describe(
    t: Transcription, times: np.ndarray, violation: float, name: str, stage: int, point: int
) -> dict[str, Any]:
    layout = t.layout
    time = float(times[stage])
    if point >= 0:
        fraction = layout.scheme_of(layout.phase_at(stage)).c[point]
        time += float(fraction * (times[stage + 1] - times[stage]))
    return {
        "block": name,
        "phase": layout.schedule.phases[layout.phase_at(stage)].name,
        "node": stage,
        "point": point if point >= 0 else None,
        "time": time,
        "violation": float(violation) if np.isfinite(violation) else None,
    }


def nonfinite_place(nlp: Nlp, x: np.ndarray) -> str | None:
    """Description of the first function that is not finite at x, or None."""
    location = nlp.engine.first_nonfinite(x)
    if location is None:
        return None
    group, stage, output, index = location
    t = nlp.transcription
    members = t.groups[group]
    node = int(members.stages[stage])
    block = ""
    if output == "rows":
        block = f" of block '{t.rows.names[t.rows.block[members.rows[stage, index]]]}'"
    return f"{output}{block} in phase '{t.layout.schedule.phases[t.layout.phase_at(node)].name}', node {node}"


def describe_block(block: Mapping[str, Any]) -> str:
    """Text of one entry of `worst_blocks`."""
    place = "node" if block["point"] is None else "interval"
    size = "not finite" if block["violation"] is None else f"{block['violation']:.2e}"
    where = f"phase '{block['phase']}', {place} {block['node']}, t = {block['time']:.3f} s"
    return f"{block['block']} in {where}: {size}"
