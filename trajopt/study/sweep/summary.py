"""One row per setting: medians over its runs, the accuracy of the median run, and what dominates it."""

import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from trajopt.study.sweep.plan import SweepPlan
from trajopt.study.sweep.records import SweepResults, TimedRun
from trajopt.study.sweep.setting import Setting

Figures = dict[str, float | None]


@dataclass(frozen=True, kw_only=True)
class Summary:
    """A setting and its results.

    Args:
        runs: the best attempt from each start.
        median: the run of median time, with failed ones as the slowest; None before the first run.
        accuracy: of its solution, by column of `figures.COLUMNS`.
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
    def objectives(self) -> tuple[float, float]:
        """Time and error: the setting's point for the front."""
        return self.time, self.error

    @property
    def is_measured(self) -> bool:
        """Whether both time and error are known."""
        return is_measured(self.objectives)

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
    rows = [_summary(plan, results, starts, setting) for setting in plan.settings]
    points = [row.objectives for row in rows]
    best = set(front(points, GAIN))
    over = dominators(points, GAIN)
    return tuple(
        replace(row, on_front=i in best, dominated_by="" if by is None else rows[by].label)
        for i, (row, by) in enumerate(zip(rows, over, strict=True))
    )


def _summary(plan: SweepPlan, results: SweepResults, starts: Sequence[int], setting: Setting) -> Summary:
    name = setting.name
    median = median_run(results, name, starts)
    job, _, figures = results.accuracy.get(name, (None, False, {}))
    known = median is not None and median.success and job == median.job
    return Summary(
        setting=setting,
        label=setting.label(plan.base),
        is_default=setting == plan.base,
        runs=tuple(run for start in starts if (run := results.best(name, start)) is not None),
        median=median,
        accuracy=dict(figures) if known else {},
        compiled=results.compiled.get(setting.functions, {}),
    )


def disturbance(results: SweepResults) -> dict[str, Any]:
    """How steady the machine was: calibrations over the fastest one, and the runs out of bounds."""
    known = sorted(run.calibration for run in results.runs.values() if run.calibration is not None)
    shares = [run.cpu_share for run in results.runs.values() if run.cpu_share is not None]
    least = min([*known, *results.calibrations], default=math.nan)
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


Point = tuple[float, float]

# A slower setting is on the front only if its error is smaller by this fraction: errors of one discretisation
# with different solvers or tolerances differ in the third digit.
GAIN = 0.05


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
