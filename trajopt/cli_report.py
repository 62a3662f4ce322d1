"""What the command line prints: JSON objects, the list of problems, the summary of a solve."""

from __future__ import annotations

import json
import math
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from trajopt.certify.report import Report
    from trajopt.family import Choice, Family, Parameter, RobotName
    from trajopt.solution import Solution

# Keys of a solution's meta that the JSON of a solve repeats as they are.
FROM_META = (
    "problem",
    "robot",
    "success",
    "status",
    "solver_status",
    "advice",
    "iterations",
    "objective",
    "variables",
    "constraints",
    "max_violation",
    "worst_blocks",
    "wall_time_s",
    "function_time_s",
    "build_time_s",
    "compile_time_s",
    "solver",
    "transcription",
    "tolerance",
    "seed",
    "perturb",
    "warm_start",
    "compile",
    "parameters",
)

# A cost of transport beyond this belongs to a motion on the spot, about which it says nothing.
MOST_TRANSPORT = 10.0

# The figures of a check that a summary shows, each with a short name.
KEY_FIGURES = {
    "base_residual": "base residual",
    "foot_drift": "drift",
    "open_loop_position": "open loop",
    "open_loop_orientation": "orientation",
    "open_loop_joints": "joints",
}


def results_console(pipe_width: int) -> Console:
    """A console for tables on stdout, of that many columns where it is no terminal, which tells no width."""
    console = Console(highlight=False, markup=False)
    if not sys.stdout.isatty():
        console.width = pipe_width
    return console


def to_json(value: object) -> str:
    """One JSON object as text; NaN and infinity become null."""
    return json.dumps(_finite(value), indent=2, allow_nan=False)


def _finite(value: object) -> object:
    if isinstance(value, Mapping):
        return {str(key): _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def solve_dict(solution: Solution, report: Report | None, file: Path | None) -> dict[str, Any]:
    """The JSON of a solve; ``accuracy`` and ``file`` are null where they could not be had."""
    from trajopt.power import cost_of_transport, energy

    meta = solution.meta
    return {
        **{key: meta[key] for key in FROM_META},
        "energy_j": energy(solution),
        "cost_of_transport": cost_of_transport(solution),
        "intervals": solution.n_intervals,
        "accuracy": None if report is None else report.to_dict(),
        "file": None if file is None else str(file),
    }


def list_dict(families: Mapping[str, Family]) -> dict[str, Any]:
    """The JSON of a list: problems with robot, phases and parameters."""
    return {
        "problems": [
            {
                "name": family.name,
                "robot": family.robot,
                "robots": list(family.robots),
                "phases": list(family.phases),
                "summary": family.summary,
                "parameters": [_described(parameter) for parameter in family.parameters],
            }
            for family in families.values()
        ]
    }


def _described(parameter: Parameter | Choice | RobotName) -> dict[str, Any]:
    """A parameter as JSON; a choice has no range."""
    common = {"unit": parameter.unit, "lower": parameter.lower, "upper": parameter.upper}
    return {**common, **vars(parameter)}


def family_heading(family: Family) -> str:
    """Name, robot, phases and summary of a family."""
    robots = f"robot{'s' * (len(family.robots) > 1)} {', '.join(family.robots)}"
    return f"{family.name} ({robots}; phases {', '.join(family.phases)})\n  {family.summary}"


def family_table(families: Mapping[str, Family]) -> Table:
    """One row a family: name, robots it is tested on, summary."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for title in ("problem", "robots", "what it is"):
        table.add_column(title, overflow="fold")
    for family in families.values():
        table.add_row(family.name, " ".join(family.robots), family.summary)
    return table


def parameter_table(family: Family) -> Table:
    """Parameters of a family with default, unit, range and meaning."""
    table = Table(box=None, pad_edge=False, padding=(0, 3, 0, 0))
    for title in ("  parameter", "default", "range", "meaning"):
        table.add_column(title, overflow="fold")
    for parameter in family.parameters:
        table.add_row(f"  {parameter.name}", _default(parameter), _range(parameter), parameter.meaning)
    return table


def _default(parameter: Parameter | Choice | RobotName) -> str:
    if isinstance(parameter.default, str):
        return parameter.default
    return "derived" if parameter.default is None else f"{parameter.default:g} {parameter.unit}".rstrip()


def _range(parameter: Parameter | Choice | RobotName) -> str:
    if parameter.lower is None or parameter.upper is None:
        return ", ".join(parameter.choices)
    return f"{parameter.lower:g} to {parameter.upper:g} {parameter.unit}".rstrip()


def summary(solution: Solution, report: Report | None, file: Path | None, notes: list[str]) -> str:
    """A solve in a few lines: what happened, how good it is, where the file is, what to do next."""
    meta = solution.meta
    lines = [_verdict(meta)]
    if not meta["success"]:
        lines.append(_line("advice", meta["advice"]))
        lines += [_line("worst", worst_block(block)) for block in meta["worst_blocks"]]
    grid = f"{meta['transcription']}, {solution.n_intervals} intervals"
    lines.append(_line("size", f"{meta['variables']} variables, {meta['constraints']} constraints; {grid}"))
    lines.append(_line("objective", _number(meta["objective"])))
    lines.append(_line("violation", f"{_number(meta['max_violation'])} (tolerance {meta['tolerance']:g})"))
    lines.append(_line("energy", _energy(solution)))
    lines.append(_line("times", _times(meta)))
    if report is not None:
        lines.append(_line("accuracy", accuracy_line(report)))
    lines += [_line("note", note) for note in notes]
    lines.append(_line("file", "none" if file is None else str(file)))
    if file is not None:
        name = shlex.quote(str(file))
        checks = [_line("next", f"trajopt check {name}"), _line("", f"trajopt replay {name}")]
        lines += checks if meta["success"] else [_line("next", f"trajopt diagnose {name}")]
    elif not meta["success"]:
        lines.append(_line("next", "the same command with --diagnose"))
    return "\n".join(lines)


def _verdict(meta: dict[str, Any]) -> str:
    found = "solved" if meta["success"] else f"NOT solved, {meta['status'].replace('_', ' ')}"
    own = "" if meta["success"] else f" ({meta['solver_status']})"
    count = f"{meta['solver']}, {meta['iterations']} iterations"
    return f"{meta['problem']} on {meta['robot']}: {found}{own}; {count}"


def _line(title: str, text: str) -> str:
    return f"  {title:10} {text}"


def worst_block(block: dict[str, Any]) -> str:
    """A block of rows at its worst place, in words."""
    place = "node" if block["point"] is None else "interval"
    size = "not finite" if block["violation"] is None else f"{block['violation']:.2e}"
    where = f"phase '{block['phase']}', {place} {block['node']}, t = {block['time']:.3f} s"
    return f"{block['block']} in {where}: {size}"


def _energy(solution: Solution) -> str:
    """What joints draw, and the cost of transport of robots that go somewhere."""
    from trajopt.power import cost_of_transport, energy

    drawn, transport = energy(solution), cost_of_transport(solution)
    way = f", cost of transport {transport:.3g}" if transport < MOST_TRANSPORT else ""
    return f"{drawn:.4g} J drawn by joints{way}"


def _times(meta: dict[str, Any]) -> str:
    return (
        f"solver {meta['wall_time_s']:.2f} s (functions {meta['function_time_s']:.2f} s), "
        f"build {meta['build_time_s']:.2f} s, compile {meta['compile_time_s']:.2f} s"
    )


def accuracy_line(report: Report) -> str:
    """The key figures of a check in one line."""
    from trajopt.certify.report import FIGURES

    parts = []
    for name, short in KEY_FIGURES.items():
        value = getattr(report, name)
        if value is not None:
            parts.append(f"{short} {value:.1e} {FIGURES[name].unit}")
    return ", ".join(parts)


def beyond(report: Report) -> str:
    """The figures beyond the check's tolerances in words, or an empty text."""
    from trajopt.certify.report import FIGURES

    return ", ".join(FIGURES[name].text for name in report.failures())


def _number(value: float | None) -> str:
    return "not finite" if value is None else f"{value:.6g}"
