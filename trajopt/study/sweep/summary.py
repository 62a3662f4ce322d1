"""What a sweep has found: a row per setting with medians and accuracy, the Pareto front, and tables."""

import csv
import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from rich.table import Table

from trajopt.motion.output import replacing
from trajopt.problem import Problem
from trajopt.robot.units import Units
from trajopt.study.display import figure_table
from trajopt.study.sweep.plan import SweepPlan
from trajopt.study.sweep.records import SweepResults, TimedRun
from trajopt.study.sweep.run import COLUMNS
from trajopt.study.sweep.setting import Setting

Figures = dict[str, float | None]
Point = tuple[float, float]
FOLDED = "dominated by"
RUNS, SETTINGS, FRONT = "runs.csv", "settings.csv", "front.csv"
RUN_FIGURES = tuple(entry.name for entry in fields(TimedRun) if entry.name != "setting")
SECONDS = ("wall_time", "start_time", "stage_two_time", "function_time", "build_time")
Row = dict[str, Any]
# A slower setting is on the front only if its error is smaller by this fraction: errors of one discretisation
# with different solvers or tolerances differ in the third digit.
GAIN = 0.05


@dataclass(frozen=True, kw_only=True)
class Summary:
    """A setting and its results.

    Args:
        runs: the best attempt from each start.
        median: the run of median time, with failed ones as the slowest; None before the first run.
        accuracy: of its solution, by column of `COLUMNS`.
        compiled: times to compile its functions, shared by all settings with the same ones.
        dominated_by: the setting on the front that dominates it most.
    """

    setting: Setting
    label: str
    is_default: bool
    runs: tuple[TimedRun, ...]
    median: TimedRun | None
    accuracy: Figures = field(default_factory=dict)
    compiled: dict[str, Any] = field(default_factory=dict)
    on_front: bool = False
    dominated_by: str = ""

    @property
    def solved(self) -> list[TimedRun]:
        """The runs with a solution."""
        return [run for run in self.runs if run.success]

    @property
    def time(self) -> float:
        """Median time of a solve, s; infinite if at least half of the runs failed, NaN without runs."""
        return math.nan if self.median is None else self.median.time

    @property
    def error(self) -> float:
        """Open-loop error of the worst phase, m; NaN if unknown or not finite."""
        value = self.accuracy.get("open_loop_m")
        return math.nan if value is None else value

    @property
    def is_measured(self) -> bool:
        """Whether both time and error are known."""
        return is_measured((self.time, self.error))

    @property
    def failure(self) -> str:
        """Status and detail of the first run without a solution; empty if there is none."""
        failed = [run for run in self.runs if not run.success]
        return f"{failed[0].status}: {failed[0].detail}".removesuffix(": ") if failed else ""

    def median_of(self, name: str) -> float | None:
        """Median of a figure over the runs with a solution."""
        known = [value for run in self.solved if (value := getattr(run, name)) is not None]
        return float(statistics.median(known)) if known else None


def median_run(results: SweepResults, setting: str, starts: Iterable[int]) -> TimedRun | None:
    """The run of the (upper) median time over all starts; failed ones are the slowest."""
    runs = [run for start in starts if (run := results.best(setting, start)) is not None]
    return sorted(runs, key=lambda run: (run.time, run.start))[len(runs) // 2] if runs else None


def summarize(plan: SweepPlan, results: SweepResults, starts: Sequence[int]) -> tuple[Summary, ...]:
    """Summaries of all settings of a plan, in its order."""
    rows = []
    for setting in plan.settings:
        name, median = setting.name, median_run(results, setting.name, starts)
        job, _, figures = results.accuracy.get(name, (None, False, {}))
        known = median is not None and median.success and job == median.job
        row = Summary(
            setting=setting,
            label=setting.label(plan.base),
            is_default=setting == plan.base,
            runs=tuple(run for start in starts if (run := results.best(name, start)) is not None),
            median=median,
            accuracy=dict(figures) if known else {},
            compiled=results.compiled.get(setting.functions, {}),
        )
        rows.append(row)
    points = [(row.time, row.error) for row in rows]
    best, over = set(front(points, GAIN)), dominators(points, GAIN)
    return tuple(
        replace(row, on_front=i in best, dominated_by="" if by is None else rows[by].label)
        for i, (row, by) in enumerate(zip(rows, over, strict=True))
    )


def disturbance(results: SweepResults) -> dict[str, Any]:
    """How steady the machine was: calibrations over the fastest one, and the runs out of bounds."""
    known, least = results.loads, results.least_load
    shares = [run.cpu_share for run in results.runs.values() if run.cpu_share is not None]
    if not known:
        return {"runs": len(results.runs), "disturbed": 0}
    return {
        "runs": len(results.runs),
        "disturbed": sum(run.disturbed for run in results.runs.values()),
        "calibration_s": least,
        "calibration_median": statistics.median(known) / least,
        "calibration_90": known[math.ceil(0.9 * len(known)) - 1] / least,
        "calibration_most": known[-1] / least,
        "least_cpu_share": min(shares),
    }


def is_measured(point: Point) -> bool:
    """Whether time and error are finite; other points are never on a front."""
    return all(math.isfinite(value) for value in point)


def front(points: Sequence[Point], gain: float = 0.0) -> list[int]:
    """Indices of the points on the front, fastest first.

    A point is on it if its error is smaller by a fraction ``gain`` than that of every faster one; 0 gives the
    Pareto front. Equal points are on it together. Unmeasured points are ignored.
    """
    kept: list[int] = []
    for i in sorted(
        (i for i, point in enumerate(points) if is_measured(point)), key=lambda i: (points[i], i)
    ):
        least = points[kept[-1]][1] if kept else math.inf
        if points[i][1] < (1 - gain) * least or (kept and points[i] == points[kept[-1]]):
            kept.append(i)
    return kept


def dominators(points: Sequence[Point], gain: float = 0.0) -> list[int | None]:
    """For each point, the one on the front that dominates it most; None for points on the front.

    It has the largest product of ratios among those that are not slower and, up to ``gain``, not less
    accurate. Unmeasured points have None too.
    """
    best = front(points, gain)
    dominating: list[int | None] = []
    for i, (time, error) in enumerate(points):
        over = [j for j in best if points[j][0] <= time and (1 - gain) * points[j][1] <= error]
        on_it = i in best or not is_measured(points[i])
        dominating.append(None if on_it else max(over, key=lambda j: _lead(points[j], (time, error))))
    return dominating


def _lead(first: Point, second: Point) -> float:
    """Logarithm of the product of ratios; infinite if an entry of the front's point is zero."""
    pairs = [(a, b) for a, b in zip(first, second, strict=True) if a != b]
    return sum(math.inf if a <= 0 else math.log(b / a) for a, b in pairs)


def _run_row(problem: str, setting: Setting, run: TimedRun) -> Row:
    figures = {
        f"{name}_s" if name.endswith("time") or name == "calibration" else name: getattr(run, name)
        for name in RUN_FIGURES
    }
    return {"problem": problem, "setting": run.setting, **setting.to_dict(), **figures}


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

    docs/front.md explains the columns. Raises InputError if they cannot be written.
    """
    robot, units, duration = problem.robot, Units(problem.robot), problem.schedule.duration
    default = next((row.time for row in summaries if row.is_default), math.nan)
    head = {"problem": name, "robot": robot.name, "kind": _motion_kind(problem), "n_velocities": robot.nv}
    rows = [{**head, **_setting_row(row, units, duration, default)} for row in summaries]
    settings = {summary.setting.name: summary.setting for summary in summaries}
    runs = [_run_row(name, settings[run.setting], run) for run in results.runs.values()]
    best = sorted((row for row in rows if row["on_front"]), key=lambda row: row["time_s"])
    write_csv(folder / RUNS, runs)
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
        "setting": f"{row.label}{' (base)' if row.is_default else ''}",
        "solved": f"{len(row.solved)}/{len(row.runs)}",
        "iter": "" if iterations is None else f"{iterations:g}",
        "time": f"{row.time:.3g} s" if math.isfinite(row.time) else "",
        "x default": f"{row.time / default:.2f}" if math.isfinite(row.time / default) else "",
        "error": f"{row.error:.1e} m" if math.isfinite(row.error) else "",
        "objective gap": "" if gap is None else f"{gap:+.1e}",
        FOLDED: note,
    }
