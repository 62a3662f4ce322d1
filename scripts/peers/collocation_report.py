"""Tables of the comparison of collocation, from its measurements."""

from __future__ import annotations

import csv
import math
import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from scripts.documents import table

OURS = "trajopt"
# A plan of ours with an objective above this many times the median of all meshes is another local optimum.
WORSE = 1.05
COLUMNS = (
    *("task", "side", "method", "intervals", "solved", "build_s", "seconds", "processor"),
    *("along", "end", "objective", "beyond"),
)


@dataclass(kw_only=True)
class Measured:
    """A setting, and its times by round, s; errors and objective as of `scripts.peers.open_loop.measure`."""

    task: str
    side: str
    method: str
    intervals: int
    solved: bool = False
    build: float = math.nan
    seconds: list[float] = field(default_factory=list)
    processor: list[float] = field(default_factory=list)
    along: float = math.nan
    end: float = math.nan
    objective: float = math.nan
    beyond: float = math.nan

    @property
    def label(self) -> str:
        """Name in a table."""
        return f"{self.side} `{self.method}@{self.intervals}`"

    @property
    def median(self) -> float:
        """Median time of the solver, s."""
        return statistics.median(self.seconds)


def chosen(found: Sequence[Measured], theirs: Measured) -> Measured | None:
    """The fastest of ours whose largest error is at most theirs, and that is no worse optimum of ours."""
    ours = [m for m in found if m.task == theirs.task and m.side == OURS and m.solved]
    usual = WORSE * statistics.median(m.objective for m in ours)
    accurate = (m for m in ours if m.along <= theirs.along and m.objective <= usual)
    return min(accurate, key=lambda m: m.median, default=None)


def summary(found: Sequence[Measured]) -> Iterator[str]:
    """One line a task and method of theirs: the finest mesh, beside the fastest of ours at its error or less.

    The last column has the ratios of times on all meshes of theirs.
    """
    titles = ("task", "theirs", "[s]", "error", "objective", "ours", "[s]", "error", "objective")
    return table((*titles, "theirs / ours", "of processor", "on all meshes"), _compared(found))


def _compared(found: Sequence[Measured]) -> Iterator[Sequence[str]]:
    for method in dict.fromkeys((m.task, m.side, m.method) for m in found if m.side != OURS):
        meshes = [m for m in found if (m.task, m.side, m.method) == method]
        pairs = [(m, ours) for m in meshes if m.solved and (ours := chosen(found, m))]
        ratios = [m.median / ours.median for m, ours in pairs]
        bounds = f"{min(ratios):.3g} to {max(ratios):.3g}" if ratios else ""
        yield [*_beside_ours(max(meshes, key=lambda m: m.intervals), found), bounds]


def _beside_ours(m: Measured, found: Sequence[Measured]) -> Sequence[str]:
    cells = [m.task, m.label, f"{m.median:.4f}", f"{m.along:.1e}", f"{m.objective:.5g}"]
    ours = chosen(found, m)
    if not m.solved or ours is None:
        return [*cells, "" if m.solved else "(theirs not converged)", *[""] * 5]
    ratios = m.median / ours.median, statistics.median(m.processor) / statistics.median(ours.processor)
    figures = f"{ours.median:.4f}", f"{ours.along:.1e}", f"{ours.objective:.5g}"
    return [*cells, f"`{ours.method}@{ours.intervals}`", *figures, *(f"{ratio:.3g}" for ratio in ratios)]


def write_csv(found: Sequence[Measured], path: Path) -> None:
    """All measurements, with the times of all rounds."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        for m in found:
            times = [" ".join(f"{value:.5f}" for value in values) for values in (m.seconds, m.processor)]
            figures = [f"{value:.6g}" for value in (m.along, m.end, m.objective, m.beyond)]
            names = [m.task, m.side, m.method, m.intervals, int(m.solved), f"{m.build:.4f}"]
            writer.writerow([*names, *times, *figures])


def read_csv(path: Path) -> list[Measured]:
    """What `write_csv` wrote."""
    with path.open(encoding="utf-8", newline="") as stream:
        return [
            Measured(
                **{name: row[name] for name in COLUMNS[:3]},
                intervals=int(row["intervals"]),
                solved=row["solved"] == "1",
                build=float(row["build_s"]),
                **{name: [float(time) for time in row[name].split()] for name in COLUMNS[6:8]},
                **{name: float(row[name]) for name in COLUMNS[8:]},
            )
            for row in csv.DictReader(stream)
        ]
