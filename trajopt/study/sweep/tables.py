"""The tables of a sweep: one row per run, per setting, and per setting of the front."""

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from rich.table import Table

from trajopt.problem import Problem
from trajopt.robot.units import Units
from trajopt.solution.output import replacing
from trajopt.study.display import figure_table
from trajopt.study.sweep.records import SweepResults, TimedRun
from trajopt.study.sweep.run import COLUMNS
from trajopt.study.sweep.setting import Setting
from trajopt.study.sweep.summary import Summary

FOLDED = "dominated by"
RUNS, SETTINGS, FRONT = "runs.csv", "settings.csv", "front.csv"
RUN_FIGURES = tuple(entry.name for entry in fields(TimedRun) if entry.name != "setting")
SECONDS = ("wall_time", "start_time", "stage_two_time", "function_time", "build_time")
Row = dict[str, Any]


def run_rows(problem: str, settings: Sequence[Setting], results: SweepResults) -> list[Row]:
    """All runs in order, disturbed attempts included."""
    by_name = {setting.name: setting for setting in settings}
    rows = []
    for run in results.runs.values():
        setting = by_name[run.setting]
        figures = {
            f"{name}_s" if name.endswith("time") or name == "calibration" else name: getattr(run, name)
            for name in RUN_FIGURES
        }
        rows.append({"problem": problem, "setting": run.setting, **setting.to_dict(), **figures})
    return rows


def setting_rows(name: str, problem: Problem, summaries: Sequence[Summary]) -> list[Row]:
    """One row per setting of the problem with this name; docs/front.md explains the columns."""
    robot, units = problem.robot, Units(problem.robot)
    default = next((row.time for row in summaries if row.is_default), math.nan)
    head = {"problem": name, "robot": robot.name, "kind": _motion_kind(problem), "n_velocities": robot.nv}
    return [{**head, **_setting_row(row, units, problem.schedule.duration, default)} for row in summaries]


def _motion_kind(problem: Problem) -> str:
    """``arm`` (a fixed base), ``gait`` (periodic), ``flight`` (a phase without contacts) or ``stance``."""
    if problem.robot.base == "fixed":
        return "arm"
    if problem.periodicity is not None:
        return "gait"
    flies = any(not phase.contacts for phase in problem.schedule.phases)
    return "flight" if flies else "stance"


def _setting_row(row: Summary, units: Units, duration: float, default: float) -> Row:
    setting, first = row.setting, next((run for run in row.runs if run.start == 0), None)
    times = [run.time for run in row.solved]
    return {
        "label": row.label,
        **setting.to_dict(),
        "is_default": row.is_default,
        "points": setting.points,
        "intervals_per_natural_time": setting.intervals * units.time / duration,
        "natural_time_s": units.time,
        "length_m": units.length,
        "variables": row.median_of("variables"),
        "constraints": row.median_of("constraints"),
        "runs": len(row.runs),
        "solved": len(row.solved),
        "success_rate": len(row.solved) / len(row.runs) if row.runs else None,
        "disturbed": sum(run.disturbed for run in row.runs),
        "iterations": row.median_of("iterations"),
        "time_s": row.time,
        "relative_time": row.time / default,
        "calibration_s": row.median_of("calibration"),
        "time_least_s": min(times, default=None),
        "time_most_s": max(times, default=None),
        "time_own_guess_s": None if first is None else first.time,
        **{f"{name}_s": row.median_of(name) for name in SECONDS},
        "compile_time_s": row.compiled.get("compile_time"),
        "functions_compiled": row.compiled.get("functions_compiled"),
        "max_violation": None if row.median is None else row.median.max_violation,
        "objective": None if row.median is None else row.median.objective,
        **{column: row.accuracy.get(column) for column in COLUMNS.values()},
        "error_m": row.error,
        "relative_error": row.error / units.length,
        "on_front": row.on_front,
        "dominated_by": row.dominated_by,
        "failure": row.failure,
    }


def write_tables(
    folder: Path, name: str, problem: Problem, results: SweepResults, summaries: Sequence[Summary]
) -> list[Row]:
    """Write ``runs.csv``, ``settings.csv`` and ``front.csv``; returns the rows of the second.

    Raises InputError if they cannot be written.
    """
    rows = setting_rows(name, problem, summaries)
    best = sorted((row for row in rows if row["on_front"]), key=lambda row: row["time_s"])
    write_csv(folder / RUNS, run_rows(name, [summary.setting for summary in summaries], results))
    write_csv(folder / SETTINGS, rows)
    write_csv(folder / FRONT, best, list(rows[0]))
    return rows


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]], columns: Sequence[str] | None = None) -> None:
    """Write a table atomically; booleans as 1 and 0, unknown and non-finite values as empty."""
    titles = list(columns or (rows[0] if rows else ()))
    with replacing(path) as unfinished, unfinished.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, titles, lineterminator="\n")
        writer.writeheader()
        writer.writerows({title: _cell(value) for title, value in row.items()} for row in rows)


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, float):
        return f"{value:.6g}" if math.isfinite(value) else ""
    return str(value)


def summary_table(summaries: Iterable[Summary]) -> Table:
    """Table of the settings: those of the front first, fastest first; then by time, failed ones last."""
    rows = list(summaries)
    default = next((row.time for row in rows if row.is_default), math.nan)
    ordered = sorted(rows, key=lambda row: (not row.on_front, not row.is_measured, _last(row.time)))
    return figure_table([_cells(row, default) for row in ordered], ("setting", FOLDED), fold=(FOLDED,))


def _last(time: float) -> float:
    """A time to sort by; unknown ones come last."""
    return time if math.isfinite(time) else math.inf


def _cells(row: Summary, default: float) -> dict[str, str]:
    iterations = row.median_of("iterations")
    gap = row.accuracy.get("objective_gap")
    note = row.dominated_by or ("front" if row.on_front else row.failure or "error not known")
    return {
        "setting": f"{row.label}{' (default)' if row.is_default else ''}",
        "solved": f"{len(row.solved)}/{len(row.runs)}",
        "iter": "" if iterations is None else f"{iterations:g}",
        "time": f"{row.time:.3g} s" if math.isfinite(row.time) else "",
        "x default": f"{row.time / default:.2f}" if math.isfinite(row.time / default) else "",
        "error": f"{row.error:.1e} m" if math.isfinite(row.error) else "",
        "objective gap": "" if gap is None else f"{gap:+.1e}",
        FOLDED: note,
    }
