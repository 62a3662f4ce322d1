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
    """Return the phases in time order."""
    return [
        PhaseSpan(
            name=solution.phase_names[int(solution.phase[rows.start])],
            start=float(solution.t[rows.start]),
            end=float(solution.t[rows.stop - 1]),
        )
        for rows in solution.phases
    ]
