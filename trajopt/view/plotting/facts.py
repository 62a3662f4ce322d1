"""What a solution is and how good it is, as a table: facts, figures of the check, accuracy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from trajopt.certify.accuracy.table import FIGURES as MEASURED
from trajopt.certify.energy import cost_of_transport, energy
from trajopt.certify.report import FIGURES, Tolerances
from trajopt.errors import TrajoptError
from trajopt.view.plotting.track import Track

# Units of those facts that have one.
UNITS = {
    "largest violation": "scaled",
    "phases": "s",
    "duration": "s",
    "time of the solver": "s",
    "energy drawn by joints": "J",
    "cost of transport": "1",
}


@dataclass(frozen=True, kw_only=True)
class FigureTable:
    """A table: ``title``, and ``rows`` of a name, a value for each solution, a unit and what is allowed.

    ``beyond`` are the (row, solution) whose value is beyond that.
    """

    title: str
    rows: tuple[tuple[str, tuple[str, ...], str, str], ...]
    beyond: frozenset[tuple[int, int]] = frozenset()


def sections(tracks: Sequence[Track]) -> tuple[FigureTable, ...]:
    """Facts, check and accuracy of the solutions; a figure that cannot be had is left empty."""
    return tuple(
        section for section in (_facts(tracks), _check(tracks), _accuracy(tracks)) if section is not None
    )


def _facts(tracks: Sequence[Track]) -> FigureTable:
    named = [_facts_of(track) for track in tracks]
    rows = [(name, tuple(facts[name] for facts in named), UNITS.get(name, ""), "") for name in named[0]]
    return FigureTable(title="solution", rows=tuple(row for row in rows if any(row[1])))


def _facts_of(track: Track) -> dict[str, str]:
    meta, plan = track.meta, track.solution
    drawn = _tried(lambda: energy(plan)) if track.is_finite else None
    transport = _tried(lambda: cost_of_transport(plan)) if track.is_finite else None
    solved = "solved" if meta["success"] else "NOT SOLVED"
    return {
        "problem": str(meta["problem"]),
        "robot": str(meta["robot"]),
        "parameters": ", ".join(f"{key} {_value(entry)}" for key, entry in meta["parameters"].items()),
        "status": f"{solved}: {str(meta['status']).replace('_', ' ')}",
        "advice": "" if meta["success"] else str(meta.get("advice", "")),
        "solver": f"{meta['solver']}, tolerance {meta['tolerance']:g}",
        "iterations": str(meta["iterations"]),
        "objective": _value(meta["objective"]),
        "largest violation": _value(meta.get("max_violation")),
        "variables, constraints": f"{meta.get('variables', '')}, {meta.get('constraints', '')}".strip(", "),
        "transcription": f"{meta['transcription']}, {plan.n_intervals} intervals",
        "phases": ", ".join(f"{phase.name} {phase.end - phase.start:.3g}" for phase in track.phases),
        "duration": f"{plan.t[-1] - plan.t[0]:.4g}",
        "time of the solver": _value(meta["wall_time_s"]),
        "energy drawn by joints": _value(drawn),
        "cost of transport": _value(transport if transport is not None and np.isfinite(transport) else None),
        "versions": ", ".join(f"{key} {entry}" for key, entry in meta["versions"].items()),
    }


def _value(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _tried(compute: Callable[[], float]) -> float | None:
    """The figure, or None where the solution cannot give it."""
    try:
        with np.errstate(all="ignore"):
            return float(compute())
    except (TrajoptError, ArithmeticError, ValueError, KeyError):
        return None


def _check(tracks: Sequence[Track]) -> FigureTable | None:
    reports = [track.report for track in tracks]
    if not any(reports):
        return None
    limits = Tolerances()
    rows: list[tuple[str, tuple[str, ...], str, str]] = []
    beyond: set[tuple[int, int]] = set()
    failures = [set() if report is None else set(report.failures()) for report in reports]
    for name, figure in FIGURES.items():
        values = [None if report is None else getattr(report, name) for report in reports]
        if all(value is None for value in values):
            continue
        limit = None if figure.tolerance is None else getattr(limits, figure.tolerance)
        least = figure.margin or figure.least
        allowed = "" if limit is None else f"{'≥' if least else '≤'} {-limit if figure.margin else limit:.0e}"
        beyond |= {(len(rows), i) for i, failed in enumerate(failures) if name in failed}
        texts = tuple("" if value is None else f"{value:.3g}" for value in values)
        rows.append((figure.text, texts, figure.unit, allowed))
    return FigureTable(title="check, by numeric Pinocchio alone", rows=tuple(rows), beyond=frozenset(beyond))


def _accuracy(tracks: Sequence[Track]) -> FigureTable | None:
    found = [track.accuracy for track in tracks]
    if not any(found):
        return None
    rows: list[tuple[str, tuple[str, ...], str, str]] = []
    for name, (text, unit) in MEASURED.items():
        values = [None if one is None else getattr(one, name) for one in found]
        if any(value is not None for value in values):
            rows.append((text, tuple("" if value is None else f"{value:.3g}" for value in values), unit, ""))
    return FigureTable(title="accuracy between points and in open loop", rows=tuple(rows))
