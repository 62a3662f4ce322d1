"""Tables and the figure of the comparison with Crocoddyl, from its measurements."""

from __future__ import annotations

import csv
import math
import statistics
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scripts.documents import table

OURS, CROCODDYL = "trajopt", "Crocoddyl"
# Of ours: the factorisation of its own on one thread and on two, and another.
STAGES, TWO, MUMPS = "stages", "2 threads", "mumps"
# What the examples run; with limits of torques that matter, their solver for these.
EXAMPLE, LIMITED, EXAMPLE_STEP = "FDDP", "BoxFDDP", 10.0
# Errors of ours are at most this part of Crocoddyl's.
PART = 0.01
COLUMNS = (
    *("task", "side", "method", "size", "detail", "seconds", "iterations", "solved"),
    *("end_m", "largest_m", "torque_nm"),
)
# Times that the figure names, s.
TICKS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
COLOURS = {"legendre:1": "#9fc5e8", "legendre:2": "#3d85c6", "legendre:3": "#0b5394", "legendre:4": "#351c75"}
THEIRS = "#cc0000"


@dataclass(frozen=True, kw_only=True)
class Setting:
    """How a task is solved: ``method`` is a scheme or a solver, ``size`` intervals a phase or ms a knot.

    detail: the linear solver of ours or its threads (`STAGES`, `TWO`, `MUMPS`), or the number of theirs.
    """

    task: str
    side: str
    method: str
    size: float
    detail: str

    @property
    def label(self) -> str:
        """Name in a table."""
        if self.side == OURS:
            return f"{self.method}@{self.size:g}"
        return f"{self.method}, {self.size:g} ms"


@dataclass(kw_only=True)
class Measured:
    """Times of a setting by round, s; its iterations, its verdict, errors in m and largest torque in N m."""

    setting: Setting
    seconds: list[float] = field(default_factory=list)
    iterations: int = 0
    solved: bool = False
    end: float = math.nan
    largest: float = math.nan
    torque: float = math.nan

    @property
    def median(self) -> float:
        """Median time, s."""
        return statistics.median(self.seconds)

    def ratios(self, other: Measured) -> tuple[float, float]:
        """This one's time over another's: median over the rounds, and of the least times."""
        by_round = (a / b for a, b in zip(self.seconds, other.seconds, strict=False))
        return statistics.median(by_round), min(self.seconds) / min(other.seconds)


def _of(found: Iterable[Measured], **wanted: Any) -> list[Measured]:
    return [m for m in found if all(getattr(m.setting, name) == value for name, value in wanted.items())]


def example(found: Sequence[Measured], task: str) -> Measured:
    """What ours is compared with: Crocoddyl's example on one thread, with the task's limits of torques."""
    known = _of(found, task=task, side=CROCODDYL, size=EXAMPLE_STEP, detail="1")
    by_method = {m.setting.method: m for m in known}
    return by_method.get(LIMITED, by_method[EXAMPLE])


def chosen(found: Sequence[Measured], task: str, detail: str = STAGES) -> Measured | None:
    """The fastest of ours whose largest error is a hundredth of the example's at the end, or less."""
    bound = PART * example(found, task).end
    ours = [m for m in _of(found, task=task, side=OURS, detail=detail) if m.solved and m.largest <= bound]
    return min(ours, key=lambda m: m.median, default=None)


def _two_threads(found: Sequence[Measured], task: str) -> str:
    """Ratio of times on two threads each; empty where that was not measured."""
    ours = chosen(found, task, TWO)
    theirs = _of(found, task=task, side=CROCODDYL, method=EXAMPLE, size=EXAMPLE_STEP, detail="2")
    return f"{ours.ratios(theirs[0])[0]:.2f}" if ours and theirs else ""


def summary(found: Sequence[Measured], tasks: Sequence[str]) -> Iterator[str]:
    """One line a task: Crocoddyl's example, ours at a hundredth of its error, and the ratio of times."""
    figures, ratios = ("iterations", "error [m]"), ("ratio", "of least times", "two threads each")
    titles = ("task", "Crocoddyl [s]", *figures, "ours", "[s]", *figures, *ratios)
    return table(titles, (_beside_example(found, task) for task in tasks))


def _beside_example(found: Sequence[Measured], task: str) -> Sequence[str]:
    theirs, ours = example(found, task), chosen(found, task)
    cells = [task, f"{theirs.median:.3f}", f"{theirs.iterations}", f"{theirs.end:.1e}"]
    if ours is None:
        return [*cells, "none reaches a hundredth", *[""] * 6]
    figures = f"`{ours.setting.label}`", f"{ours.median:.3f}", f"{ours.iterations}", f"{ours.largest:.1e}"
    return [*cells, *figures, *(f"{ratio:.2f}" for ratio in ours.ratios(theirs)), _two_threads(found, task)]


def knots(found: Sequence[Measured], tasks: Sequence[str]) -> Iterator[str]:
    """One line a task: the ratio of times by the length of knots, ours at their largest error or less."""
    sizes = sorted({m.setting.size for m in found if m.setting.side == CROCODDYL}, reverse=True)
    rows = ([task, *(_at_equal_errors(found, task, size) for size in sizes)] for task in tasks)
    return table(("task", *(f"{size:g} ms" for size in sizes)), rows)


def _at_equal_errors(found: Sequence[Measured], task: str, size: float) -> str:
    """Ratio of times for our fastest mesh; empty where there is none, or theirs did not converge."""
    method = example(found, task).setting.method
    theirs = _of(found, task=task, side=CROCODDYL, method=method, size=size, detail="1")
    if not theirs or not theirs[0].solved:
        return ""
    known = _of(found, task=task, side=OURS, detail=STAGES)
    equal = [m for m in known if m.solved and m.largest <= theirs[0].largest]
    ours = min(equal, key=lambda m: m.median, default=None)
    return "" if ours is None else f"{ours.ratios(theirs[0])[0]:.2f}"


def write_csv(found: Sequence[Measured], path: Path) -> None:
    """All measurements, times of all rounds."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        for m in found:
            s, times = m.setting, " ".join(f"{value:.5f}" for value in m.seconds)
            errors = (f"{value:.4g}" for value in (m.end, m.largest, m.torque))
            setting = s.task, s.side, s.method, f"{s.size:g}", s.detail
            writer.writerow([*setting, times, m.iterations, int(m.solved), *errors])


def read_csv(path: Path) -> list[Measured]:
    """What `write_csv` wrote."""
    with path.open(encoding="utf-8", newline="") as stream:
        return [
            Measured(
                setting=Setting(**{name: row[name] for name in COLUMNS[:5]} | {"size": float(row["size"])}),
                seconds=[float(value) for value in row["seconds"].split()],
                iterations=int(row["iterations"]),
                solved=row["solved"] == "1",
                end=float(row["end_m"]),
                largest=float(row["largest_m"]),
                torque=float(row["torque_nm"]),
            )
            for row in csv.DictReader(stream)
        ]


def draw(found: Sequence[Measured], tasks: Sequence[str], path: Path) -> None:
    """Time against the largest open-loop error, a panel for each task."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import FixedLocator, NullFormatter, StrMethodFormatter

    columns = 3
    figure = Figure(figsize=(11.0, 7.0), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(-(-len(tasks) // columns), columns, squeeze=False).ravel()
    for axes, task in zip(panels, tasks, strict=False):
        _panel(axes, found, task)
        axes.xaxis.set_major_locator(FixedLocator(TICKS))
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
    for axes in panels[len(tasks) :]:
        axes.remove()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    figure.savefig(path)


def _panel(axes: Any, found: Sequence[Measured], task: str) -> None:
    for method, colour in COLOURS.items():
        known = _known(_of(found, task=task, side=OURS, method=method, detail=STAGES))
        _curve(axes, known, colour, "o", f"ours, {method}", "{:g}")
    for method, marker in (("FDDP", "s"), ("BoxFDDP", "^"), ("mim SQP", "D")):
        known = _known(_of(found, task=task, side=CROCODDYL, method=method, detail="1"))
        _curve(axes, known, THEIRS, marker, f"Crocoddyl, {method}", "{:g} ms")
    axes.axhline(PART * example(found, task).end, color=THEIRS, linewidth=0.8, linestyle=":")
    axes.set(xscale="log", yscale="log", title=task)
    axes.set(xlabel="time of a solve [s]", ylabel="base off the plan [m]")
    axes.grid(which="both", alpha=0.25, linewidth=0.5)
    axes.margins(0.2, 0.12)


def _known(found: Iterable[Measured]) -> list[Measured]:
    measured = (m for m in found if m.solved and math.isfinite(m.largest))
    return sorted(measured, key=lambda m: m.setting.size)


def _curve(axes: Any, known: Sequence[Measured], colour: str, marker: str, label: str, sizes: str) -> None:
    x, y = [m.median for m in known], [m.largest for m in known]
    axes.plot(x, y, color=colour, marker=marker, markersize=4.5, linewidth=1.0, label=label)
    for m in known:
        place, look = (m.median, m.largest), {"fontsize": 6.5, "color": colour}
        axes.annotate(sizes.format(m.setting.size), place, (4, 3), textcoords="offset points", **look)
