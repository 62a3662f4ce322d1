"""Outcomes as lines, as a table, as figures over all pairs, and as JSON."""

import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from rich.table import Table

from trajopt.study.display import figure_table
from trajopt.study.suite.outcome import WORDS, Outcome, in_words
from trajopt.study.suite.run import SuiteSettings

# Least width of a table that names the check's worst figures.
NAMED_WIDTH = 140
PHYSICS = ("physics", "base end", "most", "slips")
STARTS = ("starts", "50 %", "90 %", "worst", "optima", "motions")
COLUMNS = (
    *("problem", "robot", "solved", "meshes", "iter", "time", "objective"),
    *("check", "by its figure", "failure", *PHYSICS, *STARTS),
)


def outcome_line(outcome: Outcome) -> str:
    """One line on a pair."""
    parts = []
    if outcome.own is not None:
        verdict = "solved" if outcome.ok else "NOT solved"
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
    """The pairs, sorted, in ``width`` columns; a narrow table omits the name of the check's worst figure.

    ``check`` is that figure over its tolerance. Columns on perturbed starts (such as median, 90 % and worst
    of their iterations) and on physics (the base's distance from the plan, at the end and at most, and
    stances that slid) appear only if there are any.
    """
    hidden = set() if width >= NAMED_WIDTH else {"by its figure"}
    if all(outcome.physics is None for outcome in outcomes):
        hidden |= set(PHYSICS)
    if not any(outcome.starts for outcome in outcomes):
        hidden |= set(STARTS)
    rows = [_cells(outcome) for outcome in sorted(outcomes, key=lambda one: (one.problem, one.robot))]
    left = ("problem", "robot", "solved", "by its figure", "failure", "physics")
    shown = [{title: cell for title, cell in row.items() if title not in hidden} for row in rows]
    return figure_table(shown, left, whole=("problem", "robot"))


def _cells(outcome: Outcome) -> dict[str, str]:
    run = outcome.own
    cells = dict.fromkeys(COLUMNS, "") | {
        "problem": outcome.problem,
        "robot": outcome.robot,
        "solved": "yes" if outcome.ok else "NO",
        "failure": outcome.mode,
    }
    if run is not None:
        objective = "not finite" if run.objective is None else f"{run.objective:.5g}"
        cells |= {
            "meshes": str(run.meshes),
            "iter": str(run.iterations),
            "time": f"{run.wall_time:.2f} s",
        }
        cells |= {"objective": objective, "by its figure": run.figure}
        cells["check"] = "" if run.used is None else f"{run.used:.2g}"
    physics, starts = outcome.physics, outcome.perturbed()
    if physics is not None and physics.word:
        lengths = [
            "" if length is None else f"{1e3 * length:.1f} mm"
            for length in (physics.base_error_end, physics.base_error_max)
        ]
        cells |= dict(zip(PHYSICS, (physics.word, *lengths, str(physics.slips)), strict=True))
    if starts.count:
        cells["starts"] = f"{starts.solved}/{starts.count}"
    if starts.solved:
        figures = (starts.median_iterations, starts.iterations_90, starts.most_iterations)
        counts = (*figures, starts.optima, starts.motions)
        cells |= {title: f"{count:g}" for title, count in zip(STARTS[1:], counts, strict=True)}
    return cells


def summary(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Figures over all pairs; iterations from the default guess, of legged robots and of others."""
    starts = [attempt for outcome in outcomes for attempt in outcome.starts]
    per_pair = [outcome.perturbed() for outcome in outcomes if outcome.starts]
    solved = [outcome.own for outcome in outcomes if outcome.own is not None and outcome.ok]
    words = [outcome.physics.word for outcome in outcomes if outcome.physics is not None]
    return {
        "pairs": len(outcomes),
        "problems": len({outcome.problem for outcome in outcomes}),
        "robots": len({outcome.robot for outcome in outcomes}),
        "solved": sum(outcome.ok for outcome in outcomes),
        "failures": dict(Counter(outcome.mode for outcome in outcomes if outcome.mode)),
        "median_iterations_legged": _median([one.iterations for one in solved if one.legged]),
        "median_iterations_fixed_base": _median([one.iterations for one in solved if not one.legged]),
        "median_time_s": _median([one.wall_time for one in solved]),
        "physics": {word: words.count(word) for word in reversed(WORDS)} if words else None,
        "perturbed": len(starts),
        "perturbed_solved": sum(attempt.solved for attempt in starts),
        "perturbed_failures": dict(Counter(attempt.mode for attempt in starts if attempt.mode)),
        "least_share_of_starts": min((pair.solved / pair.count for pair in per_pair), default=None),
    }


def _median(values: Sequence[float]) -> float | None:
    return statistics.median(values) if values else None


def summary_lines(outcomes: Sequence[Outcome]) -> list[str]:
    """The figures over all pairs in words, and one line per failure."""
    total = summary(outcomes)
    lines = [
        f"{total['pairs']} pairs ({total['problems']} problems, {total['robots']} robots): "
        f"{total['solved']} solved from their default guess"
    ]
    kinds = {"legged": total["median_iterations_legged"], "fixed base": total["median_iterations_fixed_base"]}
    medians = [f"{kind} {median:g}" for kind, median in kinds.items() if median is not None]
    if medians:
        lines.append(f"median iterations: {', '.join(medians)}; median time {total['median_time_s']:.2f} s")
    if total["physics"] is not None:
        counted = ", ".join(f"{count} {word}" for word, count in total["physics"].items())
        lines.append(f"physics: {counted}")
    if total["perturbed"]:
        share = total["perturbed_solved"] / total["perturbed"]
        modes = "".join(f", {mode} {count}" for mode, count in total["perturbed_failures"].items())
        lines.append(
            f"perturbed starts: {total['perturbed_solved']} of {total['perturbed']} solved ({share:.1%}), "
            f"worst pair {total['least_share_of_starts']:.0%}{modes}"
        )
    lines += [
        f"failed: {outcome.name}: {outcome.mode}: {outcome.detail}" for outcome in outcomes if outcome.mode
    ]
    return lines


def to_dict(
    outcomes: Sequence[Outcome], settings: SuiteSettings, versions: Mapping[str, str]
) -> dict[str, Any]:
    """JSON-able results of a suite."""
    ordered = sorted(outcomes, key=lambda one: (one.problem, one.robot))
    return {
        "versions": dict(versions),
        "settings": asdict(settings),
        "summary": summary(ordered),
        "pairs": [outcome.to_dict() for outcome in ordered],
    }
