"""``trajopt sweep``: one problem at many settings, timed, its accuracy measured, the front drawn."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.console import Console

from trajopt.cli.input import COUNT, THREADS, parse_settings
from trajopt.cli.report import to_json
from trajopt.solving.interruption import CANCELLED, interruptible

if TYPE_CHECKING:
    from trajopt.study.sweep.plan import Plan
    from trajopt.study.sweep.records import Asked, Records
    from trajopt.study.sweep.summary import Scale, Summary

NOT_REACHED = 1
# Columns of the table where it goes to a file or a pipe, which tells no width: no column is folded.
PIPE_WIDTH = 150
PLOT = "front.png"


def _values(kind: Callable[[str], Any], what: str) -> Callable[..., tuple[Any, ...]]:
    """A callback that splits a list at its commas."""

    def split(ctx: click.Context, option: click.Parameter, text: str | None) -> tuple[Any, ...]:
        words = [] if text is None else [word.strip() for word in text.split(",")]
        try:
            found = tuple(kind(word) for word in words)
        except ValueError:
            raise click.BadParameter(f"'{text}' is no list of {what}", ctx, option) from None
        if text is not None and not all(words):
            raise click.BadParameter(f"'{text}' has an empty entry", ctx, option)
        return found

    return split


WORD_LIST, COUNT_LIST = _values(str, "words"), _values(int, "whole numbers")
NUMBER_LIST = _values(float, "numbers")


@click.command("sweep")
@click.argument("problem")
@click.option("--set", "values", multiple=True, metavar="NAME=VALUE", help="A parameter of the problem.")
@click.option("--transcription", callback=WORD_LIST, metavar="A,B", help="Schemes, e.g. legendre:1,radau:2.")
@click.option("--intervals", callback=COUNT_LIST, metavar="N,M", help="Numbers over the whole schedule.")
@click.option("--solver", callback=WORD_LIST, metavar="A,B", help="ipopt, fatrop, sqp.")
@click.option("--tol", "tolerance", callback=NUMBER_LIST, metavar="T,U", help="Tolerances.")
@click.option("--hessian", callback=WORD_LIST, metavar="A,B", help="exact, gauss-newton, limited-memory.")
@click.option("--compile", callback=WORD_LIST, metavar="A,B", help="none, quick, fast.")
@click.option("--cone", callback=WORD_LIST, metavar="A,B", help="smooth, pyramid: friction of points.")
@click.option("--model", callback=WORD_LIST, metavar="A,B", help="full, two-stage: torques after the motion.")
@click.option("--start", callback=WORD_LIST, metavar="A,B", help="cold, warm: from half the intervals.")
@click.option("--also", multiple=True, metavar="WORDS", help="One more: 'legendre:1@10 fatrop 1e-3'.")
@click.option("--full", is_flag=True, help="All combinations of what is named.")
@click.option(
    "--repeats", type=COUNT, default=2, metavar="K", show_default=True, help="Perturbed starts of a setting."
)
@click.option(
    "--perturb",
    "sigma",
    type=float,
    default=0.1,
    metavar="SIGMA",
    show_default=True,
    help="Their noise, scaled units.",
)
@click.option(
    "--max-iterations", type=COUNT, default=500, metavar="N", show_default=True, help="Of each solve."
)
@click.option("--max-time", type=float, default=60.0, metavar="S", show_default=True, help="Of each solve.")
@click.option(
    "--reference",
    "reference_time",
    type=float,
    default=300.0,
    metavar="S",
    show_default=True,
    help="Time for the converged reference; 0: none.",
)
@click.option("--jobs", type=THREADS, default=1, metavar="N", show_default=True, help="Timed processes.")
@click.option("--output-dir", type=Path, metavar="DIR", help="Results.  [default: PROBLEM-sweep]")
@click.option("--resume", is_flag=True, help="Go on in --output-dir.")
@click.option("--list", "only_list", is_flag=True, help="List the settings and run none.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
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
    """Solve PROBLEM at many settings: how long each takes, how accurate it is, which are worth having.

    An axis with one value holds for all settings; axes with several values are varied one at a time around
    the problem's own setting, schemes with intervals as a grid. Without any a default plan is run. Writes
    runs.csv, settings.csv, front.csv and front.png. Exit status 0 when the problem's own setting was solved,
    1 when not, 130 after Ctrl-C: what is done by then is written, and --resume goes on from it.
    """
    from trajopt.problem.catalogue import families
    from trajopt.problem.family import choose
    from trajopt.study.suite.versions import versions
    from trajopt.study.sweep.cores import cores_for
    from trajopt.study.sweep.plan import AXES, make_plan
    from trajopt.study.sweep.records import Asked, Records
    from trajopt.study.sweep.summary import Scale

    chosen = parse_settings(values, "--set")
    loaded = choose(families(), problem).load(chosen)
    named = {axis: arguments.pop(axis) for axis in AXES}
    plan = make_plan(loaded, named, also=also, full=full)
    asked = Asked(problem=problem, values=chosen, **arguments)
    cores = cores_for(jobs)
    if only_list:
        _print_plan(plan, asked, as_json)
        return 0
    folder = output_dir or Path(f"{problem}-sweep")
    records = Records(folder, asked.head(plan, versions()), resume=resume)
    output = Output(problem, plan, asked, records, Scale.of(loaded))
    complete = _run(output, cores)
    rows = output.write()
    output.print(rows, complete, as_json)
    if not complete:
        click.echo(f"trajopt: cancelled; --resume --output-dir {folder} goes on", err=True)
        return CANCELLED
    return 0 if any(row.is_default and math.isfinite(row.time) for row in rows) else NOT_REACHED


@dataclass(frozen=True)
class Output:
    """What is written and printed at the end of a sweep, complete or not."""

    problem: str
    plan: Plan
    asked: Asked
    records: Records
    scale: Scale

    def write(self) -> tuple[Summary, ...]:
        """The tables and the plot, from what is recorded."""
        from trajopt.study.sweep.plot import plot
        from trajopt.study.sweep.summary import summarize
        from trajopt.study.sweep.tables import write_tables

        found, folder = self.records.found, self.records.folder
        rows = summarize(self.plan, found, self.asked.starts)
        write_tables(folder, self.problem, found, rows, self.scale)
        plot(rows, f"{self.problem} on {self.scale.robot}", folder / PLOT)
        return rows

    def print(self, rows: Sequence[Summary], complete: bool, as_json: bool) -> None:
        """The table, or one JSON object."""
        from trajopt.study.sweep.summary import disturbance
        from trajopt.study.sweep.tables import setting_rows, table

        found = self.records.found
        quiet = disturbance(found)
        if as_json:
            settings = setting_rows(self.problem, rows, self.scale)
            click.echo(
                to_json(
                    {
                        "problem": self.problem,
                        "complete": complete,
                        "folder": str(self.records.folder),
                        "settings": settings,
                        "front": [row.label for row in rows if row.on_front],
                        "reference": found.reference,
                        "machine": quiet,
                        "left_out": list(self.plan.left_out),
                    }
                )
            )
            return
        console = Console(highlight=False, markup=False)
        if not sys.stdout.isatty():
            console.width = PIPE_WIDTH
        console.print(table(rows))
        for text in (*_notes(self.plan, found.reference, quiet), f"tables and plot in {self.records.folder}"):
            console.print(text, soft_wrap=True)


def _notes(plan: Plan, reference: dict[str, Any] | None, quiet: dict[str, Any]) -> list[str]:
    """What to know beside the table."""
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
    return notes


def _run(output: Output, cores: Sequence[int]) -> bool:
    """Run what is missing; False after Ctrl-C."""
    from trajopt.study.sweep.display import Lines
    from trajopt.study.sweep.engine import Sweep
    from trajopt.study.sweep.process import Pool

    count = len(output.plan.settings)
    complete = True
    with interruptible() as interruption, interruption.recording():
        try:
            with Lines(f"sweep of {output.problem}") as shown, Pool(cores, interruption.check) as pool:
                shown.note(
                    f"{count} settings, {len(output.asked.starts)} starts each: "
                    f"{count * len(output.asked.starts)} runs, {len(cores)} at a time, "
                    f"on core {', '.join(map(str, cores))}"
                )
                Sweep(output.asked, output.plan, output.records, pool, shown).run()
        except KeyboardInterrupt:
            complete = False
        interruption.answer()  # also one that came when all was done
    return complete


def _print_plan(plan: Plan, asked: Asked, as_json: bool) -> None:
    runs = len(plan.settings) * len(asked.starts)
    if as_json:
        settings = [{"label": setting.label(plan.base), **setting.to_dict()} for setting in plan.settings]
        click.echo(to_json({"settings": settings, "runs": runs, "left_out": list(plan.left_out)}))
        return
    for setting in plan.settings:
        click.echo(setting.label(plan.base) + (" (default)" if setting == plan.base else ""))
    for text in plan.left_out:
        click.echo(f"left out: {text}", err=True)
    click.echo(f"{len(plan.settings)} settings, {runs} runs", err=True)
