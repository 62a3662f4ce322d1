"""The phases of a solution in time, as plots and replays show them."""

from __future__ import annotations

from dataclasses import dataclass

from trajopt.solution.solution import Solution


@dataclass(frozen=True, kw_only=True)
class PhaseSpan:
    """A phase by name with its start and end, s."""

    name: str
    start: float
    end: float


def phase_spans(solution: Solution) -> list[PhaseSpan]:
    """Return the phases in time order, numbered where the solution has no names for them."""
    names = solution.meta.get("phase_names") or []
    spans = []
    for rows in solution.phases:
        index = int(solution.phase[rows.start])
        name = str(names[index]) if index < len(names) else f"phase {index + 1}"
        start, end = solution.t[rows.start], solution.t[rows.stop - 1]
        spans.append(PhaseSpan(name=name, start=float(start), end=float(end)))
    return spans
