"""``trajopt batch``: many cases of a problem, on this machine or a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Any

import click

from trajopt.cli.input import (
    COUNT,
    NOT_REACHED,
    THREADS,
    default_option,
    is_given,
    json_option,
    parse_settings,
    solver_option,
    tolerance_option,
)
from trajopt.cli.interruption import CANCELLED
from trajopt.cli.progress import runs_to_its_end
from trajopt.cli.report import console, plain_table, to_json
from trajopt.errors import InputError

if TYPE_CHECKING:
    from trajopt.study.batch.batch import BatchDataset
    from trajopt.study.batch.variation import BatchCase

# Options that choose the cases; with --resume alone they are those of the folder.
CHOOSING = ("values", "robots", "vary", "sample", "count", "seed")
# Cases that are named as they fail: more are in the index.
MOST_NAMED = 20
# Characters of why one failed; the index has all.
LONGEST = 120


@click.command("batch")
@click.argument("problem", required=False)
@click.option("--set", "values", multiple=True, metavar="NAME=VALUE", help="A parameter of all cases.")
@click.option("--robots", metavar="A,B", help="Robots, for problems that take one.")
@click.option("--vary", multiple=True, metavar="NAME=FIRST:LAST:COUNT", help="A grid; or NAME=A,B,...")
@click.option(
    "--sample",
    multiple=True,
    metavar="NAME=uniform(A,B)",
    help="Random values; also loguniform(A,B), normal(MEAN,DEVIATION).",
)
@default_option("--count", 0, "N", "Samples at each point of the grids.", kind=COUNT)
@default_option("--seed", 0, "K", "Of the samples.", kind=COUNT)
@click.option("--out", type=Path, metavar="DIR", help="Folder for the results.  [default: PROBLEM-batch]")
@click.option("--jobs", type=THREADS, metavar="N", help="Parallel processes.  [default: all processors]")
@click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler, e.g. tcp://127.0.0.1:8786.")
@click.option(
    "--start",
    type=click.Choice(["neighbours", "default"]),
    default="neighbours",
    show_default=True,
    help="Start from solutions of neighbours, or from the default guess.",
)
@solver_option
@tolerance_option
@default_option("--max-iterations", 500, "N", "Iteration limit of a solve.", kind=COUNT)
@default_option("--max-time", 60.0, "S", "Time limit of the solves from one start, s.")
@click.option("--resume", is_flag=True, help="Go on with the batch in --out.")
@click.option("--status", type=Path, metavar="DIR", help="Show how far the batch in DIR is.")
@click.option("--list", "only_list", is_flag=True, help="List the cases without solving.")
@json_option
def batch_command(
    problem: str | None,
    out: Path | None,
    jobs: int | None,
    scheduler: str | None,
    start: str,
    resume: bool,
    status: Path | None,
    only_list: bool,
    as_json: bool,
    **arguments: Any,
) -> int:
    """Solve many cases of a problem, over grids and samples of its parameters.

    Writes solution files, index.parquet with a row for each case, and failures.png. Exit status 0 when all
    cases are solved, 1 when not, 130 after Ctrl-C: the results so far are written, and --resume goes on.
    """
    if status is not None:
        return _status(status, problem, as_json)
    choosing = {name: arguments.pop(name) for name in CHOOSING}
    if problem is None and (not resume or out is None):
        raise InputError("PROBLEM is missing", "allowed: without it --resume --out DIR, or --status DIR")
    folder = out or Path(f"{problem}-batch")
    if problem is None:
        cases, settings = _asked_before(folder, (*CHOOSING, "start", *arguments))
    else:
        cases = _chosen(problem, choosing)
        settings = {**arguments, "neighbours": start == "neighbours"}
    if only_list:
        return _list(cases, as_json)
    complete = _run(cases, folder, settings, jobs, scheduler, resume)
    return _report(folder, as_json, complete)


def _chosen(problem: str, choosing: dict[str, Any]) -> list[BatchCase]:
    from trajopt.study.batch.variation import batch_cases

    if is_given("seed") and not choosing["sample"]:
        raise InputError("--seed has no effect here", "allowed: with --sample")
    words = choosing["robots"]
    robots = [] if words is None else [word.strip() for word in words.split(",")]
    return batch_cases(
        problem, **{**choosing, "robots": robots, "values": parse_settings(choosing["values"], "--set")}
    )


def _asked_before(folder: Path, names: Sequence[str]) -> tuple[list[BatchCase], dict[str, Any]]:
    """Cases and settings of the batch in a folder; raises `InputError` for options that would change them."""
    from trajopt.study.batch.records import looked_up_cases, read_request
    from trajopt.study.batch.solved_case import BatchSettings

    for name in names:
        if is_given(name):
            raise InputError(
                f"--{name.replace('values', 'set').replace('_', '-')} has no effect here",
                "allowed: with PROBLEM; --resume alone goes on with what was asked for",
            )
    head = read_request(folder)
    settings, known = dict(head["settings"]), {field.name for field in fields(BatchSettings)}
    if set(settings) != known:
        raise InputError(
            f"settings of the batch in {folder} are {', '.join(settings) or 'none'}",
            f"allowed: {', '.join(sorted(known))}",
        )
    return looked_up_cases(head), settings


def _run(
    cases: list[BatchCase],
    folder: Path,
    settings: dict[str, Any],
    jobs: int | None,
    scheduler: str | None,
    resume: bool,
) -> bool:
    """Solve the cases that have no row; False after Ctrl-C."""
    from trajopt.study.batch.engine import run_batch
    from trajopt.study.batch.records import BatchRecords
    from trajopt.study.batch.solved_case import BatchSettings
    from trajopt.study.display import TaskDisplay
    from trajopt.study.records import versions
    from trajopt.study.tasks import open_workers

    chosen = BatchSettings(**settings)

    def run(check: Callable[[], None]) -> None:
        with (
            open_workers(scheduler=scheduler, jobs=jobs) as workers,  # first: else a folder may be left
            BatchRecords(folder, cases, chosen, versions(), resume=resume) as records,
            TaskDisplay("batch", len(cases), len(records.solved)) as display,
        ):
            lines = _ProgressLines(display, len(cases), records.solved)
            for row in run_batch(cases, chosen, records, workers.watched(check, display.show)):
                lines.add(row, cases[row["case"]])

    return runs_to_its_end(run)


class _ProgressLines:
    """Lines on stderr: the first cases that are not solved, and each tenth of the batch."""

    def __init__(self, display: Any, total: int, known: dict[int, bool]) -> None:
        self._display, self._total = display, total
        self._done, self._solved, self._failed = len(known), sum(known.values()), 0

    def add(self, row: dict[str, Any], case: BatchCase) -> None:
        """Count a case that has ended."""
        before = 10 * self._done // self._total
        self._done += 1
        self._solved += row["success"]
        text = ""
        if not row["success"]:
            self._failed += 1
            if self._failed <= MOST_NAMED:
                why = shorten(row["detail"] or row["status"], LONGEST, placeholder=" ...")
                text = f"case {row['case']}: {case.name}: NOT solved, {why}"
            if self._failed == MOST_NAMED:
                text += "; further ones are in the index only"
        self._display.finished(text)
        if 10 * self._done // self._total > before:
            self._display.note(f"{self._done}/{self._total} cases, {self._solved} solved")


def _list(cases: list[BatchCase], as_json: bool) -> int:
    if as_json:
        shown = [{"problem": case.problem, "parameters": dict(case.values)} for case in cases]
        click.echo(to_json({"cases": shown}))
    else:
        for number, case in enumerate(cases):
            click.echo(f"{number} {case.name}")
        click.echo(f"{len(cases)} cases", err=True)
    return 0


def _status(folder: Path, problem: str | None, as_json: bool) -> int:
    from trajopt.study.batch.batch import dataset

    if problem is not None:
        raise InputError(f"--status is given with problem {problem}", "allowed: --status DIR alone")
    results = dataset(folder)
    _print(results, as_json, None)
    return 0


def _report(folder: Path, as_json: bool, complete: bool) -> int:
    from trajopt.study.batch.batch import dataset
    from trajopt.study.batch.report import plot_failures

    results = dataset(folder)
    title = f"{results.cases[0].problem}: {len(results)} of {results.index.num_rows} cases solved"
    _print(results, as_json, plot_failures(results.index, results.parameters, title, results.folder))
    if not complete:
        click.echo(f"trajopt: cancelled; go on with --resume --out {folder}", err=True)
        return CANCELLED
    return 0 if len(results) == len(results.cases) else NOT_REACHED


def _print(results: BatchDataset, as_json: bool, plot: Path | None) -> None:
    from trajopt.study.batch.report import outcomes, regions

    counts, parts = outcomes(results.index), regions(results.index, results.parameters)
    done, total = results.index.num_rows, len(results.cases)
    if as_json:
        shown = [
            {"parameter": part.parameter, "region": part.text, "cases": part.cases, "solved": part.solved}
            for part in parts
        ]
        figures = {"folder": str(results.folder), "cases": total, "done": done, "outcomes": dict(counts)}
        click.echo(to_json({**figures, "regions": shown, "plot": None if plot is None else str(plot)}))
        return
    out = console()
    words = ", ".join(f"{count} {word.replace('_', ' ')}" for word, count in counts.most_common())
    out.print(f"{done} of {total} cases done: {words or 'none'}", soft_wrap=True)
    rows = [(part.parameter, part.text, f"{part.solved} of {part.cases}") for part in parts]
    if rows:
        out.print(plain_table(("parameter", "region", "solved"), rows))
    for text in (f"index: {results.folder / 'index.parquet'}", *([f"plot: {plot}"] if plot else [])):
        out.print(text, soft_wrap=True)
