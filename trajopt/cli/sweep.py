"""``trajopt sweep``: time and accuracy of one problem at many settings, and their Pareto front."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from trajopt.cli.input import (
    COUNT,
    NOT_REACHED,
    THREADS,
    default_option,
    json_option,
    parse_settings,
)
from trajopt.cli.interruption import CANCELLED
from trajopt.cli.progress import runs_to_its_end
from trajopt.cli.report import console, to_json

if TYPE_CHECKING:
    from trajopt.study.sweep.plan import SweepPlan
    from trajopt.study.sweep.records import SweepRecords, SweepRequest
    from trajopt.study.sweep.summary import Summary

# Width in columns of a table that is written to a file or a pipe: no column is folded.
PIPE_WIDTH = 150
PLOT = "front.png"


def _values(kind: Callable[[str], Any], what: str) -> Callable[..., tuple[Any, ...]]:
    """A callback that splits a list at its commas."""

    def split(ctx: click.Context, option: click.Parameter, text: str | None) -> tuple[Any, ...]:
        words = [] if text is None else [word.strip() for word in text.split(",")]
        try:
            parts = tuple(kind(word) for word in words)
        except ValueError:
            raise click.BadParameter(f"'{text}' is not a list of {what}", ctx, option) from None
        if text is not None and not all(words):
            raise click.BadParameter(f"'{text}' has an empty entry", ctx, option)
        return parts

    return split


WORD_LIST, COUNT_LIST = _values(str, "words"), _values(int, "whole numbers")
NUMBER_LIST = _values(float, "numbers")


@click.command("sweep")
@click.argument("problem")
@click.option("--set", "values", multiple=True, metavar="NAME=VALUE", help="A parameter of the problem.")
@click.option("--transcription", callback=WORD_LIST, metavar="A,B", help="Schemes, e.g. legendre:1,radau:2.")
@click.option("--intervals", callback=COUNT_LIST, metavar="N,M", help="Numbers of intervals in all.")
@click.option("--solver", callback=WORD_LIST, metavar="A,B", help="Names of solvers.")
@click.option("--tolerance", callback=NUMBER_LIST, metavar="T,U", help="Tolerances.")
@click.option("--hessian", callback=WORD_LIST, metavar="A,B", help="exact, gauss-newton, limited-memory.")
@click.option("--cone", callback=WORD_LIST, metavar="A,B", help="smooth, pyramid: of point contacts.")
@click.option("--model", callback=WORD_LIST, metavar="A,B", help="full, two-stage: torques after the motion.")
@click.option("--start", callback=WORD_LIST, metavar="A,B", help="cold, warm: start from half the intervals.")
@click.option("--also", multiple=True, metavar="WORDS", help="Another setting: 'legendre:1@10 pyramid 1e-3'.")
@click.option("--full", is_flag=True, help="All combinations of the values given.")
@default_option("--repeats", 2, "K", "Perturbed starts per setting.", kind=COUNT)
@default_option("--perturb", 0.1, "SIGMA", "Noise of perturbed starts, scaled units.", to="sigma")
@default_option("--max-iterations", 500, "N", "Iteration limit of a solve.", kind=COUNT)
@default_option("--max-time", 60.0, "S", "Time limit of a solve, s.")
@default_option("--reference", 300.0, "S", "Time for the converged reference; 0: none.", to="reference_time")
@default_option("--jobs", 1, "N", "Timed processes in parallel.", kind=THREADS)
@click.option(
    "--output-dir", type=Path, metavar="DIR", help="Folder for the results.  [default: PROBLEM-sweep]"
)
@click.option("--resume", is_flag=True, help="Continue the sweep in --output-dir.")
@click.option("--list", "only_list", is_flag=True, help="List the settings without solving.")
@json_option
def sweep(
    problem: str,
    values: tuple[str, ...],
    also: tuple[str, ...],
    full: bool,
    jobs: int,
    output_dir: Path | None,
    resume: bool,
    only_list: bool,
    as_json: bool,
    **arguments: Any,
) -> int:
    """Benchmark settings: time, accuracy, Pareto front.

    An axis with one value holds for all settings; axes with several values are varied one at a time around
    the base setting, schemes and intervals as a grid. Without any axis a default plan is run. The base
    setting has the problem's own scheme and intervals; solve refines a mesh instead. Writes runs.csv,
    settings.csv, front.csv and front.png. Exit status 0 when the base setting was solved, 1 when not, 130
    after Ctrl-C: the results so far are written, and --resume continues from them.
    """
    from trajopt.study.records import versions
    from trajopt.study.sweep.engine import cores_for
    from trajopt.study.sweep.plan import AXES, make_plan
    from trajopt.study.sweep.plot import plot
    from trajopt.study.sweep.records import SweepRecords, SweepRequest
    from trajopt.study.sweep.summary import summarize, write_tables

    named = {axis: arguments.pop(axis) for axis in AXES}
    request = SweepRequest(problem=problem, values=parse_settings(values, "--set"), **arguments)
    loaded = request.load()
    plan = make_plan(loaded, named, also=also, full=full)
    cores = cores_for(jobs)
    if only_list:
        _print_plan(plan, request, as_json)
        return 0
    folder = output_dir or Path(f"{problem}-sweep")
    records = SweepRecords(folder, request.head(plan, versions()), resume=resume)
    complete = _run(request, plan, records, cores)
    rows = summarize(plan, records.results, request.starts)
    settings = write_tables(records.folder, problem, loaded, records.results, rows)
    plot(rows, f"{problem} on {loaded.robot.name}", records.folder / PLOT)
    if as_json:
        click.echo(to_json({"problem": problem, "complete": complete, **_found(plan, records, settings)}))
    else:
        _print(plan, records, rows)
    if not complete:
        click.echo(f"trajopt: cancelled; continue with --resume --output-dir {folder}", err=True)
        return CANCELLED
    return 0 if any(row.is_default and math.isfinite(row.time) for row in rows) else NOT_REACHED


def _run(request: SweepRequest, plan: SweepPlan, records: SweepRecords, cores: Sequence[int]) -> bool:
    """Run the missing tasks; False after Ctrl-C."""
    from trajopt.study.display import TaskDisplay
    from trajopt.study.sweep.engine import Sweep

    settings, starts = len(plan.settings), len(request.starts)

    def run(check: Callable[[], None]) -> None:
        with TaskDisplay(f"sweep of {request.problem}") as display:
            display.note(
                f"{settings} settings, {starts} starts each: {settings * starts} runs, "
                f"{len(cores)} at a time, on core {', '.join(map(str, cores))}"
            )
            Sweep(request, plan, records, cores, display, (check,)).run()

    return runs_to_its_end(run)


def _found(plan: SweepPlan, records: SweepRecords, settings: Sequence[dict[str, Any]]) -> dict[str, Any]:
    from trajopt.study.sweep.summary import disturbance

    return {
        "folder": str(records.folder),
        "settings": settings,
        "front": [row["label"] for row in settings if row["on_front"]],
        "reference": records.results.reference,
        "machine": disturbance(records.results),
        "left_out": plan.left_out,
    }


def _print(plan: SweepPlan, records: SweepRecords, rows: Sequence[Summary]) -> None:
    """Print the table, with notes below it."""
    from trajopt.study.sweep.summary import disturbance, summary_table

    reference, quiet = records.results.reference, disturbance(records.results)
    notes = [f"left out: {text}" for text in plan.left_out]
    if reference is not None:
        notes.append(f"reference: {reference['text']}")
    if "calibration_90" in quiet:
        notes.append(
            f"machine: a fixed load took {1e3 * quiet['calibration_s']:.2f} ms at best, "
            f"{quiet['calibration_median']:.2f} times that in the median, "
            f"{quiet['calibration_90']:.2f} at 90 %; "
            f"{quiet['disturbed']} of {quiet['runs']} runs were disturbed"
        )
    shown, run = console(PIPE_WIDTH), [row for row in rows if row.runs]
    if run:
        shown.print(summary_table(run))
    else:
        notes.insert(0, f"no run has ended of {len(rows)} settings")
    for text in (*notes, f"tables and plot in {records.folder}"):
        shown.print(text, soft_wrap=True)


def _print_plan(plan: SweepPlan, request: SweepRequest, as_json: bool) -> None:
    runs = len(plan.settings) * len(request.starts)
    if as_json:
        settings = [{"label": setting.label(plan.base), **setting.to_dict()} for setting in plan.settings]
        click.echo(to_json({"settings": settings, "runs": runs, "left_out": list(plan.left_out)}))
        return
    for setting in plan.settings:
        click.echo(setting.label(plan.base) + (" (base)" if setting == plan.base else ""))
    for text in plan.left_out:
        click.echo(f"left out: {text}", err=True)
    click.echo(f"{len(plan.settings)} settings, {runs} runs", err=True)
