"""``trajopt suite``: every problem on every robot, and how that compares with before."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.console import Console

from trajopt.cli.input import COUNT, THREADS
from trajopt.cli.report import to_json
from trajopt.errors import InputError
from trajopt.solution.output import check_output
from trajopt.solving.interruption import CANCELLED, interruptible

if TYPE_CHECKING:
    from trajopt.study.suite.cases import Case
    from trajopt.study.suite.outcome import Outcome
    from trajopt.study.suite.records import Records
    from trajopt.study.suite.settings import Settings

NOT_REACHED = 1
# Columns of the table where it goes to a file or a pipe, which tells no width: no column is folded.
PIPE_WIDTH = 170
# Options that take every word up to the next option, as in ``--robots solo12 go2``.
LISTS = ("--problems", "--robots")


class ListCommand(click.Command):
    """A command whose ``LISTS`` take several words, separated by spaces or commas, or are repeated."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Give every word of a list its own option."""
        spread: list[str] = []
        current = ""
        for word in args:
            name, equals, value = word.partition("=")
            if name in LISTS:
                current = name
                spread += _each(name, value) if equals else []
            elif word.startswith("-"):
                current = ""
                spread.append(word)
            elif current:
                spread += _each(current, word)
            else:
                spread.append(word)
        missing = next((name for name in LISTS if name in args and name not in spread), None)
        return super().parse_args(ctx, [*spread, missing] if missing else spread)


def _each(option: str, words: str) -> list[str]:
    return [part for word in words.split(",") if word.strip() for part in (option, word.strip())]


@click.command(cls=ListCommand)
@click.option("--problems", multiple=True, metavar="GLOB...", help="Names or patterns.  [default: all]")
@click.option("--robots", multiple=True, metavar="NAME...", help="Robots, or .py files.  [default: all]")
@click.option(
    "--perturbed",
    type=COUNT,
    default=0,
    metavar="K",
    show_default=True,
    help="Noisy starts of each pair.",
)
@click.option(
    "--sigma", type=float, default=0.1, metavar="SIGMA", show_default=True, help="Their noise, scaled units."
)
@click.option("--jobs", type=THREADS, metavar="N", help="Processes at a time.  [default: the processors]")
@click.option("--solver", default="ipopt", metavar="NAME", show_default=True, help="ipopt, fatrop or sqp.")
@click.option(
    "--max-iterations", type=COUNT, default=500, metavar="N", show_default=True, help="Iteration limit."
)
@click.option(
    "--max-time",
    type=float,
    default=300.0,
    metavar="S",
    show_default=True,
    help="Time limit of a solve.",
)
@click.option("--compile", default="quick", metavar="LEVEL", show_default=True, help="none, quick or fast.")
@click.option("--simulate", is_flag=True, help="Run what is solved of legged robots in MuJoCo, too.")
@click.option("--output-dir", type=Path, metavar="DIR", help="Write results and solution files there.")
@click.option("--resume", is_flag=True, help="Go on from the results in --output-dir.")
@click.option("--update", type=Path, metavar="FILE", help="Write the pairs' bands to FILE.")
@click.option("--compare", type=Path, metavar="FILE", help="Compare with the bands in FILE.")
@click.option("--list", "only_list", is_flag=True, help="List the pairs and run none.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def suite(
    problems: tuple[str, ...],
    robots: tuple[str, ...],
    jobs: int | None,
    output_dir: Path | None,
    resume: bool,
    update: Path | None,
    compare: Path | None,
    only_list: bool,
    as_json: bool,
    **arguments: Any,
) -> int:
    """Run every problem on every robot it is for, and print what was found.

    Each pair is solved from its own guess at default settings, checked, and solved from --perturbed noisy
    starts. With --simulate the plan of every legged robot is run in MuJoCo, too. Exit status 0 when all pairs
    are solved and within the check (and within their bands with --compare; without them --simulate allows no
    fall), 1 when not, 130 after Ctrl-C: what is done by then is printed.
    """
    from trajopt.problem.catalogue import families
    from trajopt.study.suite.cases import select
    from trajopt.study.suite.records import Records
    from trajopt.study.suite.settings import Settings
    from trajopt.study.suite.versions import versions

    settings = Settings(**arguments)
    cases = select(families(), problems, robots)
    if only_list:
        _print_cases(cases, as_json)
        return 0
    if resume and output_dir is None:
        raise InputError("--resume has no results to go on from", "allowed: with --output-dir DIR")
    if settings.simulate:
        from trajopt.certify.simulation.bodies import mujoco_package

        mujoco_package()  # refused before anything is run
    bands = Bands(update, compare)
    records = Records(output_dir, settings, versions())
    outcomes, complete = _run(cases, settings, records, resume, jobs or _processors())
    outside = bands.compare(outcomes, settings)
    if as_json:
        click.echo(to_json(_found(outcomes, settings, complete, outside)))
    else:
        _print(outcomes, outside)
    if complete:
        bands.update(outcomes, settings)
        fallen = compare is None and any(_fell(outcome) for outcome in outcomes)
        return NOT_REACHED if outside or fallen or not all(outcome.ok for outcome in outcomes) else 0
    click.echo(f"trajopt: cancelled, {len(outcomes)} of {len(cases)} pairs are done", err=True)
    return CANCELLED


def _fell(outcome: Outcome) -> bool:
    from trajopt.study.suite.physics import FELL

    return outcome.physics is not None and outcome.physics.word == FELL


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _run(
    cases: Sequence[Case], settings: Settings, records: Records, resume: bool, jobs: int
) -> tuple[list[Outcome], bool]:
    """Outcomes sorted by pair, and whether they are all: Ctrl-C leaves those that are done."""
    from trajopt.study.suite.display import Recorded, display
    from trajopt.study.suite.pool import run_all
    from trajopt.study.suite.records import left

    missing, known = left(cases, records.open(resume=resume))
    outcomes, complete = list(known), True
    jobs = max(1, min(jobs, len(missing)))
    with interruptible() as interruption, interruption.recording():
        try:
            with (
                display(len(cases), len(known), jobs, settings.perturbed) as shown,
                closing(
                    run_all(
                        missing,
                        settings,
                        jobs=jobs,
                        display=Recorded(shown, records),
                        folder=records.folder,
                        known=records.unfinished(),
                        check=interruption.check,
                    )
                ) as running,
            ):
                for outcome in running:
                    records.add(outcome)
                    outcomes.append(outcome)
            records.close()
        except KeyboardInterrupt:
            complete = False
        interruption.answer()  # also one that came when all was done
    return sorted(outcomes, key=lambda outcome: outcome.name), complete


class Bands:
    """The files of --update and --compare; both are tried before anything is run."""

    def __init__(self, update: Path | None, compare: Path | None) -> None:
        from trajopt.study.suite import data

        self._data = data
        self._target = None if update is None else check_output(update)
        self._old = data.read(update)[0] if update is not None and update.exists() else {}
        self._entries = None if compare is None else data.read(compare)[0]

    def compare(self, outcomes: Sequence[Outcome], settings: Settings) -> dict[str, str] | None:
        """What is outside its bands by pair; None where nothing is compared."""
        return None if self._entries is None else self._data.deviations(outcomes, settings, self._entries)

    def update(self, outcomes: Sequence[Outcome], settings: Settings) -> None:
        """Write the bands of the pairs that are solved; the others keep theirs."""
        from trajopt.problem.catalogue import families
        from trajopt.study.suite.cases import all_cases
        from trajopt.study.suite.versions import versions

        if self._target is not None:
            names = [case.name for case in all_cases(families())]
            entries = self._data.updated(self._old, outcomes, settings, names)
            self._data.write(self._target, entries, versions())


def _print_cases(cases: Sequence[Case], as_json: bool) -> None:
    if as_json:
        click.echo(to_json({"pairs": [{"problem": case.problem, "robot": case.robot} for case in cases]}))
        return
    width = max(len(case.problem) for case in cases)
    for case in cases:
        click.echo(f"{case.problem:{width}}  {case.robot}")
    click.echo(f"{len(cases)} pairs", err=True)


def _found(
    outcomes: Sequence[Outcome], settings: Settings, complete: bool, outside: dict[str, str] | None
) -> dict[str, Any]:
    from trajopt.study.suite.table import to_dict
    from trajopt.study.suite.versions import versions

    return {"complete": complete, "outside": outside, **to_dict(outcomes, settings, versions())}


def _print(outcomes: Sequence[Outcome], outside: dict[str, str] | None) -> None:
    from trajopt.study.suite.table import summary_lines, table

    console = Console(highlight=False, markup=False)
    if not sys.stdout.isatty():
        console.width = PIPE_WIDTH
    if outcomes:
        console.print(table(outcomes, console.width))
    for text in summary_lines(outcomes):
        console.print(text, soft_wrap=True)
    for name, text in (outside or {}).items():
        console.print(f"outside its bands: {name}: {text}", soft_wrap=True)
