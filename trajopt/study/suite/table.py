"""Outcomes as one line each, as a table, as figures over all, and as JSON."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from rich.table import Table

from trajopt.study.suite.outcome import Outcome
from trajopt.study.suite.physics import WORDS, in_words
from trajopt.study.suite.settings import SuiteSettings

# Columns of a table with the names of the figures, of the longest ones.
NAMED_WIDTH = 140


def line(outcome: Outcome) -> str:
    """One pair in a line."""
    parts = []
    if outcome.own is not None:
        verdict = "solved" if outcome.own.solved else "NOT solved"
        parts.append(f"{verdict}, {outcome.own.iterations} iterations, {outcome.own.wall_time:.2f} s")
    if outcome.mode:
        parts.append(f"{outcome.mode} ({outcome.detail})")
    if outcome.physics is not None and (outcome.physics.word or outcome.physics.detail):
        parts.append(in_words(outcome.physics))
    if outcome.starts:
        starts = outcome.perturbed()
        parts.append(f"{starts.solved} of {starts.count} perturbed starts")
    return f"{outcome.name}: {'; '.join(parts)}"


def outcome_table(outcomes: Sequence[Outcome], width: int) -> Table:
    """The pairs, sorted, in ``width`` columns: without room the worst figure of the check has no name.

    ``check`` is the part of its tolerance that this figure uses. Columns on perturbed starts (median, 90 %
    and worst of their iterations among them) and on physics (the base's distance from the plan at its end and
    at most, and stances that slid) only where there are some.
    """
    perturbed = any(outcome.starts for outcome in outcomes)
    found = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for title in ("problem", "robot"):
        longest = max((len(getattr(outcome, title)) for outcome in outcomes), default=0)
        found.add_column(title, no_wrap=True, min_width=longest)
    found.add_column("solved", no_wrap=True)
    for title in ("iter", "time", "objective", "check"):
        found.add_column(title, justify="right", no_wrap=True)
    named = width >= NAMED_WIDTH
    if named:
        found.add_column("by its figure", no_wrap=True)
    found.add_column("failure", no_wrap=True)
    physics = any(outcome.physics is not None for outcome in outcomes)
    if physics:
        found.add_column("physics", no_wrap=True)
        for title in ("base end", "most", "slips"):
            found.add_column(title, justify="right", no_wrap=True)
    if perturbed:
        for title in ("starts", "50 %", "90 %", "worst", "optima", "motions"):
            found.add_column(title, justify="right", no_wrap=True)
    for outcome in sorted(outcomes, key=lambda one: (one.problem, one.robot)):
        own = [*_cells(outcome, named), *(_physics_cells(outcome) if physics else ())]
        found.add_row(*own, *(_start_cells(outcome) if perturbed else ()))
    return found


def _cells(outcome: Outcome, named: bool) -> list[str]:
    own, check = outcome.own, outcome.check
    cells = [outcome.problem, outcome.robot, "yes" if outcome.solved else "NO"]
    if own is None:
        cells += ["", "", ""]
    else:
        objective = "not finite" if own.objective is None else f"{own.objective:.5g}"
        cells += [str(own.iterations), f"{own.wall_time:.2f} s", objective]
    judged = check if outcome.solved else None
    cells.append("" if judged is None or judged.used is None else f"{judged.used:.2g}")
    if named:
        cells.append("" if judged is None else judged.figure)
    return [*cells, outcome.mode]


def _physics_cells(outcome: Outcome) -> list[str]:
    found = outcome.physics
    if found is None or not found.word:
        return ["", "", "", ""]
    lengths = [
        "" if length is None else f"{1e3 * length:.1f} mm"
        for length in (found.base_error_end, found.base_error_max)
    ]
    return [found.word, *lengths, str(found.slips)]


def _start_cells(outcome: Outcome) -> list[str]:
    starts = outcome.perturbed()
    if not starts.count:
        return [""] * 6
    figures = (starts.median_iterations, starts.iterations_90, starts.most_iterations)
    found = [str(starts.optima), str(starts.motions)] if starts.solved else ["", ""]
    cells = ["" if figure is None else f"{figure:g}" for figure in figures]
    return [f"{starts.solved}/{starts.count}", *cells, *found]


def summary(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Figures over all pairs; iterations over those solved from their own guess, legged and others apart."""
    starts = [attempt for outcome in outcomes for attempt in outcome.starts]
    per_pair = [outcome.perturbed() for outcome in outcomes if outcome.starts]
    return {
        "pairs": len(outcomes),
        "problems": len({outcome.problem for outcome in outcomes}),
        "robots": len({outcome.robot for outcome in outcomes}),
        "solved": sum(outcome.solved for outcome in outcomes),
        "within_check": sum(outcome.ok for outcome in outcomes),
        "failures": dict(Counter(outcome.mode for outcome in outcomes if outcome.mode)),
        "median_iterations_legged": _median(outcomes, legged=True),
        "median_iterations_fixed_base": _median(outcomes, legged=False),
        "physics": _words(outcomes),
        "perturbed": len(starts),
        "perturbed_solved": sum(attempt.solved for attempt in starts),
        "perturbed_failures": dict(Counter(attempt.mode for attempt in starts if attempt.mode)),
        "least_share_of_starts": min((pair.solved / pair.count for pair in per_pair), default=None),
    }


def _words(outcomes: Sequence[Outcome]) -> dict[str, int] | None:
    """How many plans physics tracked, left off and let fall; None where nothing was simulated."""
    words = [outcome.physics.word for outcome in outcomes if outcome.physics is not None]
    return {word: words.count(word) for word in reversed(WORDS)} if words else None


def _median(outcomes: Sequence[Outcome], *, legged: bool) -> float | None:
    found = [
        outcome.own.iterations
        for outcome in outcomes
        if outcome.own is not None and outcome.own.solved and outcome.grid and outcome.grid.legged == legged
    ]
    return statistics.median(found) if found else None


def summary_lines(outcomes: Sequence[Outcome]) -> list[str]:
    """The figures over all pairs in words, and what failed, one line a pair."""
    found = summary(outcomes)
    lines = [
        f"{found['pairs']} pairs ({found['problems']} problems, {found['robots']} robots): "
        f"{found['solved']} solved from their own guess, {found['within_check']} within the check"
    ]
    kinds = {"legged": found["median_iterations_legged"], "fixed base": found["median_iterations_fixed_base"]}
    medians = [f"{kind} {median:g}" for kind, median in kinds.items() if median is not None]
    if medians:
        lines.append(f"median iterations: {', '.join(medians)}")
    if found["physics"] is not None:
        counted = ", ".join(f"{count} {word}" for word, count in found["physics"].items())
        lines.append(f"physics: {counted}")
    if found["perturbed"]:
        share = found["perturbed_solved"] / found["perturbed"]
        lines.append(
            f"perturbed starts: {found['perturbed_solved']} of {found['perturbed']} solved ({share:.1%}), "
            f"worst pair {found['least_share_of_starts']:.0%}{_modes(found['perturbed_failures'])}"
        )
    lines += [
        f"failed: {outcome.name}: {outcome.mode}: {outcome.detail}" for outcome in outcomes if outcome.mode
    ]
    return lines


def _modes(failures: Mapping[str, int]) -> str:
    return "".join(f", {mode} {count}" for mode, count in failures.items())


def to_dict(
    outcomes: Sequence[Outcome], settings: SuiteSettings, versions: Mapping[str, str]
) -> dict[str, Any]:
    """The JSON of a suite."""
    ordered = sorted(outcomes, key=lambda one: (one.problem, one.robot))
    return {
        "versions": dict(versions),
        "settings": asdict(settings),
        "summary": summary(ordered),
        "pairs": [outcome.to_dict() for outcome in ordered],
    }
