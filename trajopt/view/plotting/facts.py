"""Tables about a solution: facts, figures of the check, accuracy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trajopt.certify.accuracy.table import FIGURES as MEASURED
from trajopt.certify.report import FIGURES, Tolerances
from trajopt.motion.energy_use import cost_of_transport, energy
from trajopt.view.plotting.track import Track, tried

# Name, a value for each solution, unit, and tolerance.
_Row = tuple[str, tuple[str, ...], str, str]
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
    """A table: ``title``, and ``rows``.

    ``beyond`` are the (row, solution) whose value is beyond its tolerance.
    """

    title: str
    rows: tuple[_Row, ...]
    beyond: frozenset[tuple[int, int]] = frozenset()


def title_of(tracks: Sequence[Track]) -> str:
    """Return problem and robot; of several problems their names."""
    names = dict.fromkeys(track.solution.description.problem for track in tracks)
    return f"{', '.join(names)} on {tracks[0].solution.description.robot}"


def state_of(track: Track) -> str:
    """Describe a solution in a line: status, solver and grid."""
    plan, statistics = track.solution, track.solution.statistics
    objective = statistics.objective
    parts = [
        "solved" if statistics.success else f"not solved, {_status(track)}",
        f"{statistics.solver}, {statistics.iterations} iterations",
        "" if objective is None else f"objective {objective:.6g}",
        f"{statistics.transcription}, {plan.n_intervals} interval{'s' * (plan.n_intervals > 1)}",
        f"{plan.t[-1] - plan.t[0]:.3g} s",
    ]
    return "  \u00b7  ".join(part for part in parts if part)


def failure_of(track: Track) -> str:
    """Say how a solution failed; empty if it did not."""
    failed = not track.solution.success and not track.is_simulated
    parts = [
        f"NOT SOLVED ({_status(track)}): the last iterate" if failed else "",
        "" if track.is_finite else "NOT FINITE: what is finite is shown",
    ]
    return "; ".join(part for part in parts if part)


def _status(track: Track) -> str:
    return track.solution.statistics.status.replace("_", " ")


def sections(tracks: Sequence[Track]) -> tuple[FigureTable, ...]:
    """Facts, check and accuracy of the solutions; missing figures are left empty."""
    return tuple(
        section for section in (_facts(tracks), _check(tracks), _accuracy(tracks)) if section is not None
    )


def _facts(tracks: Sequence[Track]) -> FigureTable:
    named = [_facts_of(track) for track in tracks]
    rows = [(name, tuple(facts[name] for facts in named), UNITS.get(name, ""), "") for name in named[0]]
    return FigureTable(title="solution", rows=tuple(row for row in rows if any(row[1])))


def _facts_of(track: Track) -> dict[str, str]:
    plan, description, statistics = track.solution, track.solution.description, track.solution.statistics
    drawn = tried(lambda: float(energy(plan))) if track.is_finite else None
    transport = tried(lambda: float(cost_of_transport(plan))) if track.is_finite else None
    solved = "solved" if statistics.success else "NOT SOLVED"
    return {
        "problem": description.problem,
        "robot": description.robot,
        "parameters": ", ".join(f"{key} {_value(entry)}" for key, entry in description.parameters.items()),
        "status": f"{solved}: {_status(track)}",
        "advice": "" if statistics.success else statistics.advice,
        "solver": f"{statistics.solver}, tolerance {statistics.tolerance:g}",
        "iterations": str(statistics.iterations),
        "objective": _value(statistics.objective),
        "largest violation": _value(statistics.max_violation),
        "variables, constraints": f"{statistics.variables}, {statistics.constraints}"
        if statistics.variables
        else "",
        "transcription": f"{statistics.transcription}, {plan.n_intervals} intervals",
        "phases": ", ".join(f"{phase.name} {phase.end - phase.start:.3g}" for phase in track.phases),
        "duration": f"{plan.t[-1] - plan.t[0]:.4g}",
        "time of the solver": _value(statistics.wall_time_s),
        "energy drawn by joints": _value(drawn),
        "cost of transport": _value(transport if transport is not None and np.isfinite(transport) else None),
        "versions": ", ".join(f"{key} {entry}" for key, entry in statistics.versions.items()),
    }


def _value(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _check(tracks: Sequence[Track]) -> FigureTable | None:
    reports = [track.report for track in tracks]
    limits = Tolerances()
    rows: list[_Row] = []
    beyond: set[tuple[int, int]] = set()
    failures = [set() if report is None else set(report.failures()) for report in reports]
    for name, figure in FIGURES.items():
        limit = None if figure.tolerance is None else getattr(limits, figure.tolerance)
        least = figure.margin or figure.least
        allowed = "" if limit is None else f"{'≥' if least else '≤'} {-limit if figure.margin else limit:.0e}"
        if values := _values(reports, name):
            beyond |= {(len(rows), i) for i, failed in enumerate(failures) if name in failed}
            rows.append((figure.text, values, figure.unit, allowed))
    title = "check, by numeric Pinocchio alone"
    return FigureTable(title=title, rows=tuple(rows), beyond=frozenset(beyond)) if any(reports) else None


def _accuracy(tracks: Sequence[Track]) -> FigureTable | None:
    measured = [track.accuracy for track in tracks]
    named = ((text, _values(measured, name), unit, "") for name, (text, unit) in MEASURED.items())
    rows = tuple(row for row in named if row[1])
    title = "accuracy between points and in open loop"
    return FigureTable(title=title, rows=rows) if any(measured) else None


def _values(figures: Sequence[object | None], name: str) -> tuple[str, ...]:
    """A figure of each solution as text, empty if unknown; no row if unknown for all."""
    values = [getattr(one, name, None) for one in figures]
    known = any(value is not None for value in values)
    return tuple("" if value is None else f"{value:.3g}" for value in values) if known else ()
