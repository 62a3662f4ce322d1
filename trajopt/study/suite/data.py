"""Regression data: bands of objective and iterations for every pair, as text that can be reviewed.

A comma-separated table with one line per pair, sorted, columns padded; above it, after ``#``, the versions of
the software. Bands:

- objective: that from the default guess, plus or minus the fraction `OBJECTIVE_BAND`: planes between bodies
  are updated until it changes by less, and meshes with the grade differ by less.
- iterations: half to twice those of that solve on all its meshes, with a margin of at least `LEAST_MARGIN`:
  rounding, which differs between processors and compilers, changes them that much. If perturbed starts were
  run, the band extends down to half of their first decile and up to their ninth: where rounding leads one
  solve astray, others are not affected.
- physics: the result of the plan in MuJoCo (``tracked``, ``off``, ``fell``; empty if it is not simulated, or
  the robot is not legged), of which no later result may be worse.
"""

import csv
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import get_type_hints

from trajopt.errors import InputError
from trajopt.motion.output import replacing
from trajopt.solving.refinement import OBJECTIVE_CHANGE
from trajopt.study.suite.cases import Pair
from trajopt.study.suite.outcome import WORDS, Outcome, in_words, quantile
from trajopt.study.suite.run import SuiteSettings

OBJECTIVE_BAND = OBJECTIVE_CHANGE
FEWEST, MOST = 0.5, 2.0
LEAST_MARGIN = 5
# Significant digits of written objectives: far finer than the band.
DIGITS = 7
# Least half-width of the band of an objective: pure feasibility problems differ only by rounding.
OBJECTIVE_FLOOR = 1e-9


@dataclass(frozen=True, kw_only=True)
class PairBands(Pair):
    """One line: a pair, how it was solved (mesh: ``refined``, ``fixed``), and its inclusive bands."""

    mesh: str
    solver: str
    objective_low: float
    objective_high: float
    iterations_low: int
    iterations_high: int
    physics: str = ""


def entry_of(outcome: Outcome, settings: SuiteSettings) -> PairBands:
    """The line of a solved pair."""
    assert outcome.own is not None
    assert outcome.own.objective is not None
    iterations, objective = outcome.own.iterations, outcome.own.objective
    fewest = min(iterations - LEAST_MARGIN, math.floor(FEWEST * iterations))
    most = max(iterations + LEAST_MARGIN, math.ceil(MOST * iterations))
    others = sorted(start.iterations for start in outcome.starts if start.solved) or [iterations]
    width = max(OBJECTIVE_BAND * abs(objective), OBJECTIVE_FLOOR)
    return PairBands(
        problem=outcome.problem,
        robot=outcome.robot,
        mesh=_mesh(settings),
        solver=settings.solver,
        objective_low=_rounded(objective - width),
        objective_high=_rounded(objective + width),
        iterations_low=max(0, min(fewest, math.floor(FEWEST * quantile(others, 0.1)))),
        iterations_high=max(most, quantile(others, 0.9)),
        physics="" if outcome.physics is None else outcome.physics.word,
    )


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def deviation(outcome: Outcome, settings: SuiteSettings, entry: PairBands | None) -> str:
    """How a pair differs from its line, in words; empty if it does not.

    An unsolved pair always differs. The kind of mesh and the solver must match the line, since the bands of
    others do not apply.
    """
    if not outcome.ok:
        return f"{outcome.mode}: {outcome.detail}"
    if entry is None:
        return "no line of data"
    assert outcome.own is not None
    assert outcome.own.objective is not None
    solved_as, wanted = (_mesh(settings), settings.solver), (entry.mesh, entry.solver)
    if solved_as != wanted:
        return "solved on a {} mesh with {}, the data on a {} mesh with {}".format(*solved_as, *wanted)
    parts = []
    if not entry.objective_low <= outcome.own.objective <= entry.objective_high:
        parts.append(
            f"objective {outcome.own.objective:.{DIGITS}g}, "
            f"band {entry.objective_low:g} to {entry.objective_high:g}"
        )
    if not entry.iterations_low <= outcome.own.iterations <= entry.iterations_high:
        parts.append(
            f"{outcome.own.iterations} iterations, band {entry.iterations_low} to {entry.iterations_high}"
        )
    ranks = ("", *WORDS)
    if outcome.physics is not None and ranks.index(outcome.physics.word) < ranks.index(entry.physics):
        parts.append(f"{in_words(outcome.physics)}, the data say {entry.physics}")
    return "; ".join(parts)


def _mesh(settings: SuiteSettings) -> str:
    return "fixed" if settings.fixed_mesh else "refined"


def deviations(
    outcomes: Iterable[Outcome], settings: SuiteSettings, entries: Mapping[str, PairBands]
) -> dict[str, str]:
    """Differences of the pairs that are outside their bands."""
    texts = {outcome.name: deviation(outcome, settings, entries.get(outcome.name)) for outcome in outcomes}
    return {name: text for name, text in sorted(texts.items()) if text}


def updated(
    entries: Mapping[str, PairBands],
    outcomes: Sequence[Outcome],
    settings: SuiteSettings,
    names: Iterable[str],
) -> dict[str, PairBands]:
    """The lines, updated by ``outcomes``; a pair that failed keeps its old line.

    names: all pairs of the catalogue; lines of others are dropped.
    """
    new = {}
    for outcome in outcomes:
        if outcome.ok:
            entry = entry_of(outcome, settings)
            known_word = entries[outcome.name].physics if outcome.name in entries else ""
            new[outcome.name] = entry if outcome.physics is not None else replace(entry, physics=known_word)
    known = set(names)
    return {name: entry for name, entry in {**entries, **new}.items() if name in known}


def read(path: Path) -> tuple[dict[str, PairBands], dict[str, str]]:
    """Lines by pair, and the versions above them. Raises InputError for an invalid file."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not text"
        raise InputError(f"cannot read {path}: {reason}", "allowed: a file that `update` wrote") from None
    heads = (line[1:].partition(":") for line in lines if line.startswith("#"))
    versions = {name.strip(): value.strip() for name, colon, value in heads if colon}
    table = (re.sub(r"\s*,\s*", ",", line.strip()) for line in lines if not line.startswith("#"))
    rows = csv.DictReader(table)
    lacking = [column.name for column in fields(PairBands) if column.name not in (rows.fieldnames or ())]
    if set(lacking) - {"physics"}:
        raise InputError(
            f"{path} has no table of bands: column {lacking[0]} is missing",
            "allowed: a file that `update` wrote",
        )
    kinds = get_type_hints(PairBands)
    entries = [_entry(path, number, row, kinds) for number, row in enumerate(rows, 1)]
    return {entry.name: entry for entry in entries}, versions


def _entry(path: Path, number: int, row: Mapping[str, str], kinds: Mapping[str, type]) -> PairBands:
    try:
        row = {"physics": "", **row}
        entry = PairBands(**{name: kind(row[name]) for name, kind in kinds.items()})
        if entry.physics not in ("", *WORDS):
            raise ValueError(entry.physics)
    except (KeyError, TypeError, ValueError):
        names = ", ".join(column.name for column in fields(PairBands))
        raise InputError(f"line {number} of the table in {path} is not one", f"columns: {names}") from None
    return entry


def write_bands(path: Path, entries: Mapping[str, PairBands], versions: Mapping[str, str]) -> None:
    """Write the table. Raises InputError if it cannot be written."""
    titles = [field.name for field in fields(PairBands)]
    rows = [titles] + [
        [f"{each:.{DIGITS}g}" if isinstance(each, float) else str(each) for each in asdict(entry).values()]
        for _, entry in sorted(entries.items())
    ]
    widths = [max(len(row[column]) for row in rows) for column in range(len(titles))]
    head = [f"# {name}: {value}" for name, value in versions.items()]
    body = [
        ", ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
    with replacing(path) as unfinished:
        unfinished.write_text("\n".join([*head, *body]) + "\n", encoding="utf-8")
