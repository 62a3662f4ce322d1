"""Output of the command line: JSON objects, tables, the summary of a solve."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from typing_extensions import override

from trajopt.errors import without_nonfinite

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from trajopt.certify.check import Examination
    from trajopt.certify.report import CheckReport
    from trajopt.motion.solution import Solution

# Width in columns of a table that is written to a file or a pipe.
PIPE_WIDTH = 120
# Statistics of a solution that the JSON of a solve repeats unchanged.
STATED = (
    *("success", "converged", "status", "solver_status", "advice", "iterations", "objective", "variables"),
    *("constraints", "max_violation", "worst_blocks", "wall_time_s", "function_time_s", "build_time_s"),
    *("compile_time_s", "solver", "transcription", "tolerance", "seed", "perturb", "warm_start"),
)

# An argument in a message of the library: `name` or `name=value`.
ARGUMENT = re.compile(r"`([a-z_]+)(?:=([^`]*))?`")

# A cost of transport beyond this is that of a motion on the spot, for which it means nothing.
MOST_TRANSPORT = 10.0

# The figures of a check that a summary shows, each with a short name.
KEY_FIGURES = {
    "base_residual": "base residual",
    "foot_drift": "drift",
    "open_loop_position": "open loop",
    "open_loop_orientation": "orientation",
    "open_loop_joints": "joints",
}


@dataclass(frozen=True)
class SolveReport:
    """Result of a solve, with notes for its summary and additional entries for its JSON.

    examination: of the solution, where there is one.
    """

    solution: Solution
    reached: bool
    notes: list[str] = field(default_factory=list)
    extra: dict[str, Any] = field(default_factory=dict)
    examination: Examination | None = None


def to_json(value: object) -> str:
    """One JSON object as text; NaN and infinity become null."""
    return json.dumps(without_nonfinite(value), indent=2, allow_nan=False)


def solve_dict(solution: Solution, report: CheckReport | None, file: Path | None) -> dict[str, Any]:
    """Return the JSON of a solve; ``accuracy`` and ``file`` may be null."""
    from trajopt.motion.energy_use import cost_of_transport, energy

    return {
        "problem": solution.description.problem,
        "robot": solution.description.robot,
        **{key: getattr(solution.statistics, key) for key in STATED},
        "parameters": solution.description.parameters,
        "energy_j": energy(solution),
        "cost_of_transport": cost_of_transport(solution),
        "intervals": solution.n_intervals,
        "accuracy": None if report is None else report.to_dict(),
        "file": None if file is None else str(file),
    }


def printable(text: object) -> str:
    """Text for the terminal.

    Control characters, which a name from a file may have, appear as in Python's `repr`. Arguments that the
    library names in backticks become flags: ``--cycles 1`` for `cycles=1`.
    """
    escaped = "".join(
        each if each.isprintable() or each in "\n\t" else each.encode("unicode_escape").decode()
        for each in str(text)
    )
    return ARGUMENT.sub(_flag, escaped.replace("`to_dict()`", "--json"))


def _flag(argument: re.Match[str]) -> str:
    name, value = argument.groups()
    return f"--{name.replace('_', '-')}{'' if value is None else f' {value}'}"


def say(text: object = "", err: bool = False) -> None:
    """Print lines on stdout or stderr; what could steer a terminal is escaped."""
    click.echo(printable(text), err=err)


def console(width: int = PIPE_WIDTH) -> Console:
    """Return a console for tables, which escapes as `say`; ``width`` columns if stdout is not a terminal."""
    from rich.console import Console
    from rich.text import Text

    class EscapingConsole(Console):
        @override
        def render_str(self, text: str, **settings: Any) -> Text:
            return super().render_str(printable(text), **settings)

    shown = EscapingConsole(highlight=False, markup=False)
    if not shown.is_terminal:
        shown.width = width
    return shown


def plain_table(titles: Sequence[str], rows: Iterable[Sequence[str]], gap: int = 3, **column: Any) -> Table:
    """Return a table without lines; ``gap`` spaces between columns, which take ``column`` options of rich."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, gap, 0, 0))
    for title in titles:
        table.add_column(title, **(column or {"overflow": "fold"}))
    for row in rows:
        table.add_row(*row)
    return table


def solve_summary(solution: Solution, report: CheckReport | None, file: Path | None, notes: list[str]) -> str:
    """Summarise a solve in a few lines: status, accuracy, file, next commands."""
    from trajopt.transcription.violations import describe_block

    statistics = solution.statistics
    lines: list[tuple[str, str]] = []
    if not statistics.success:
        what, *rest = statistics.advice.splitlines() or [""]
        lines += [("fails", what), *(("where", each) for each in rest[:-1]), *(("try", e) for e in rest[-1:])]
        blocks = [] if statistics.converged else statistics.worst_blocks
        lines += [("worst", describe_block(block)) for block in blocks]
    grid = f"{statistics.transcription}, {solution.n_intervals} intervals"
    violation = f"{_number(statistics.max_violation)} (tolerance {statistics.tolerance:g})"
    times = (
        f"solver {statistics.wall_time_s:.2f} s (functions {statistics.function_time_s:.2f} s), "
        f"build {statistics.build_time_s:.2f} s, compile {statistics.compile_time_s:.2f} s"
    )
    lines += [
        ("size", f"{statistics.variables} variables, {statistics.constraints} constraints; {grid}"),
        ("objective", _number(statistics.objective)),
        ("violation", violation),
        ("energy", _energy(solution)),
        ("times", times),
    ]
    if report is not None:
        lines.append(("accuracy", _accuracy_line(report)))
    lines += [("note", note) for note in notes]
    lines.append(("file", "none" if file is None else str(file)))
    if file is not None:
        name = shlex.quote(str(file))
        checks = [("next", f"trajopt check {name}"), ("", f"trajopt replay {name}")]
        lines += checks if statistics.success else [("next", f"trajopt diagnose {name}")]
    elif not statistics.success:
        lines.append(("next", "the same command with --diagnose"))
    return "\n".join([_verdict(solution), *(f"  {title:10} {text}" for title, text in lines)])


def _verdict(solution: Solution) -> str:
    plan, statistics = solution.description, solution.statistics
    outcome = "solved"
    if not statistics.success and statistics.converged:
        outcome = f"solved at its points only, {statistics.status.replace('_', ' ')}"
    elif not statistics.success:
        outcome = f"NOT solved, {statistics.status.replace('_', ' ')} ({statistics.solver_status})"
    count = f"{statistics.solver}, {statistics.iterations} iterations"
    return f"{plan.problem} on {plan.robot}: {outcome}; {count}"


def _energy(solution: Solution) -> str:
    """Energy drawn by the joints, and for a robot that travels the cost of transport."""
    from trajopt.motion.energy_use import cost_of_transport, energy

    drawn, transport = energy(solution), cost_of_transport(solution)
    cost = f", cost of transport {transport:.3g}" if transport < MOST_TRANSPORT else ""
    return f"{drawn:.4g} J drawn by joints{cost}"


def _accuracy_line(report: CheckReport) -> str:
    """The key figures of a check in one line."""
    from trajopt.certify.report import FIGURES

    values = {name: getattr(report, name) for name in KEY_FIGURES}
    return ", ".join(
        f"{KEY_FIGURES[name]} {value:.1e} {FIGURES[name].unit}"
        for name, value in values.items()
        if value is not None
    )


def _number(value: float | None) -> str:
    return "not finite" if value is None else f"{value:.6g}"
