"""What a batch costs beside its solves, for the plan of large ones (docs/batch.md)."""

import resource
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import click
import numpy as np

import trajopt
from scripts.measure.shared import head, row
from trajopt.study.batch.engine import StartTree
from trajopt.study.batch.records import INDEX, BatchRecords
from trajopt.study.batch.solved_case import BatchSettings, CaseResult, solve_case
from trajopt.study.batch.variation import BatchCase, batch_cases

PROBLEM, ROBOT = "quadruped-trot", "go2"
# Cases of the tree, and rows that are written.
MANY, ROWS = 1_000_000, 10_000
JUMP, JUMPS = "quadruped-jump-forward", 12
# Problems of the throughput, what varies, and how many cases.
MANY_CASES = (
    ("ur5-reach", ["x=uniform(0.2,0.4)", "y=uniform(0.3,0.5)", "z=uniform(0.3,0.6)"], 200),
    ("solo12-jump", ["distance=uniform(0,0.3)"], 100),
)


@click.command("batches")
@click.option("--many", default=MANY, show_default=True, help="Cases of the tree.")
@click.option("--rows", default=ROWS, show_default=True, help="Rows that are written.")
def batches(many: int, rows: int) -> None:
    """Time a case, the tree of starts, the writing of rows; compare starts."""
    head("what", "figure")
    cases = _grid(20)
    begun = time.perf_counter()
    result = solve_case(cases[0], BatchSettings(), None)
    row("first case, functions maybe not in the cache", f"{time.perf_counter() - begun:.2f} s")
    begun = time.perf_counter()
    for case in cases:
        solve_case(case, BatchSettings(), None)
    row("a case after it, one process", f"{(time.perf_counter() - begun) / len(cases):.2f} s")
    row("solution file", f"{len(result.content or b'') / 1e3:.0f} kB")
    side = round(many**0.5)
    begun = time.perf_counter()
    StartTree(_square(side))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    row(f"tree of {side * side} cases", f"{time.perf_counter() - begun:.0f} s, {memory:.1f} GB at most")
    _rows(result, rows)
    _starts()
    _throughput()


def _grid(count: int) -> list[BatchCase]:
    return batch_cases(PROBLEM, robots=[ROBOT], vary=[f"speed=0.2:1.2:{count}"])


def _square(side: int) -> list[BatchCase]:
    values = np.linspace(0.2, 1.2, side).tolist()
    return [
        BatchCase(problem=PROBLEM, values={"speed": speed, "turn_rate": rate})
        for speed in values
        for rate in values
    ]


def _rows(result: CaseResult, rows: int) -> None:
    cases = _grid(rows)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place, "batch")
        with BatchRecords(folder, cases, BatchSettings(), {}, resume=False) as records:
            begun = time.perf_counter()
            for index in range(rows):
                records.add(index, result, start=None, attempts=1)
            seconds = time.perf_counter() - begun
        row("a row with its solution file, written", f"{1e3 * seconds / rows:.2f} ms")
        row("a row of the index", f"{(folder / INDEX).stat().st_size / rows:.0f} bytes")


def _starts() -> None:
    """Time and success of starts from neighbours against default guesses."""
    jumps = batch_cases(
        JUMP, sample=["distance=uniform(0,0.4)", "height=uniform(0,0.1)"], count=JUMPS, seed=1
    )
    for name, cases in ((f"{PROBLEM} {ROBOT}", _grid(20)), (JUMP, jumps)):
        for neighbours in (False, True):
            solved, seconds, iterations = _total(cases, neighbours)
            start = "neighbours" if neighbours else "default guesses"
            row(
                f"{len(cases)} cases of {name} from {start}",
                f"{solved} solved, {seconds:.1f} s of solvers, {iterations} iterations",
            )


def _total(cases: Sequence[BatchCase], neighbours: bool) -> tuple[int, float, int]:
    with tempfile.TemporaryDirectory() as place:
        found = trajopt.batch(cases, Path(place, "batch"), jobs=1, neighbours=neighbours)
        index = found.index
        seconds = sum(value or 0.0 for value in index["solver_time_s"].to_pylist())
        return len(found), seconds, sum(value or 0 for value in index["iterations"].to_pylist())


def _throughput() -> None:
    """Seconds a case one after the other in this process, and as batches."""
    head("cases", "one after the other [s a case]", "batch, 1 process", "batch, 2", "from default guesses, 2")
    for name, sample, count in MANY_CASES:
        cases = batch_cases(name, sample=sample, count=count, seed=1)
        trajopt.solve(trajopt.load(name))
        begun = time.perf_counter()
        for case in cases:
            trajopt.solve(trajopt.load(name, **case.values))
        seconds = [time.perf_counter() - begun]
        for jobs, neighbours in ((1, True), (2, True), (2, False)):
            with tempfile.TemporaryDirectory() as place:
                begun = time.perf_counter()
                trajopt.batch(cases, Path(place, "batch"), jobs=jobs, neighbours=neighbours)
                seconds.append(time.perf_counter() - begun)
        row(f"{count} of `{name}`", *(f"{total / count:.3f}" for total in seconds))
