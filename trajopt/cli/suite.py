"""``trajopt suite``: every problem on every robot, compared with regression data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from trajopt.cli.input import (
    COUNT,
    NOT_REACHED,
    THREADS,
    controller_option,
    default_option,
    json_option,
    solver_option,
)
from trajopt.cli.interruption import CANCELLED
from trajopt.cli.progress import runs_to_its_end
from trajopt.cli.report import console, to_json
from trajopt.errors import InputError
from trajopt.motion.output import check_output

if TYPE_CHECKING:
    from trajopt.study.suite.cases import Case
    from trajopt.study.suite.engine import SuiteRecords
    from trajopt.study.suite.outcome import Outcome
    from trajopt.study.suite.run import SuiteSettings

# Width in columns of a table that is written to a file or a pipe: no column is folded.
PIPE_WIDTH = 180
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
@default_option("--perturbed", 0, "K", "Perturbed starts per pair.", kind=COUNT)
@default_option("--sigma", 0.1, "SIGMA", "Noise of perturbed starts, scaled units.")
@click.option("--jobs", type=THREADS, metavar="N", help="Parallel processes.  [default: all processors]")
@click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler, e.g. tcp://127.0.0.1:8786.")
@solver_option
@default_option("--max-iterations", 500, "N", "Iteration limit.", kind=COUNT)
@default_option("--max-time", 300.0, "S", "Time limit of a solve, s.")
@click.option("--fixed-mesh", is_flag=True, help="Solve once, on each problem's own mesh.")
@click.option("--simulate", is_flag=True, help="Also run solved plans of legged robots in MuJoCo.")
@controller_option
@click.option("--output-dir", type=Path, metavar="DIR", help="Write results and solution files there.")
@click.option("--resume", is_flag=True, help="Continue from the results in --output-dir.")
@click.option("--update", type=Path, metavar="FILE", help="Write the bands of the pairs to FILE.")
@click.option("--compare", type=Path, metavar="FILE", help="Compare with the bands in FILE.")
@click.option("--list", "only_list", is_flag=True, help="List the pairs without solving.")
@json_option
def suite(
    problems: tuple[str, ...],
    robots: tuple[str, ...],
    jobs: int | None,
    scheduler: str | None,
    output_dir: Path | None,
    resume: bool,
    update: Path | None,
    compare: Path | None,
    only_list: bool,
    as_json: bool,
    **arguments: Any,
) -> int:
    """Solve all problem-robot pairs and print a table.

    Each pair is solved as by trajopt solve, from its default guess and from --perturbed starts. With
    --simulate the plans of legged robots are also run in MuJoCo. Exit status 0 when all pairs are solved
    (with --compare also within their bands, with --simulate alone without a fall), 1 when not, 130 after
    Ctrl-C, which prints the results so far.
    """
    from trajopt.problem.catalogue import families
    from trajopt.study.records import versions
    from trajopt.study.suite import data
    from trajopt.study.suite.cases import all_cases, select
    from trajopt.study.suite.engine import SuiteRecords
    from trajopt.study.suite.run import SuiteSettings
    from trajopt.study.suite.table import to_dict

    settings, known = SuiteSettings(**arguments), families()
    cases = select(known, problems, robots)
    if only_list:
        _print_cases(cases, as_json)
        return 0
    if resume and output_dir is None:
        raise InputError("--resume has no results to continue from", "allowed: with --output-dir DIR")
    if settings.simulate:
        from trajopt.robot.mujoco_package import mujoco_package

        mujoco_package()  # refused before solving, as are files that cannot be read or written
    target = None if update is None else check_output(update)
    old = data.read(target)[0] if target is not None and target.exists() else {}
    bands = None if compare is None else data.read(compare)[0]
    records = SuiteRecords(output_dir, settings, versions())
    outcomes, complete = _run(cases, settings, records, resume, jobs, scheduler)
    outside = None if bands is None else data.deviations(outcomes, settings, bands)
    if as_json:
        results = to_dict(outcomes, settings, versions())
        click.echo(to_json({"complete": complete, "outside": outside, **results}))
    else:
        _print(outcomes, outside)
    if not complete:
        click.echo(f"trajopt: cancelled, {len(outcomes)} of {len(cases)} pairs are done", err=True)
        return CANCELLED
    if target is not None:
        names = [case.name for case in all_cases(known)]
        data.write_bands(target, data.updated(old, outcomes, settings, names), versions())
    missed = outside or (bands is None and _falls(outcomes)) or not all(outcome.ok for outcome in outcomes)
    return NOT_REACHED if missed else 0


def _falls(outcomes: Sequence[Outcome]) -> bool:
    from trajopt.study.suite.outcome import FELL

    return any(outcome.physics is not None and outcome.physics.word == FELL for outcome in outcomes)


def _run(
    cases: Sequence[Case],
    settings: SuiteSettings,
    records: SuiteRecords,
    resume: bool,
    jobs: int | None,
    scheduler: str | None,
) -> tuple[list[Outcome], bool]:
    """Outcomes sorted by pair, and whether all pairs were run: after Ctrl-C only those finished so far."""
    from trajopt.study.display import TaskDisplay
    from trajopt.study.suite.engine import run_suite
    from trajopt.study.suite.table import outcome_line
    from trajopt.study.tasks import open_workers

    outcomes: list[Outcome] = []

    def run(check: Callable[[], None]) -> None:
        # First: without a scheduler no results are touched.
        with open_workers(scheduler=scheduler, jobs=jobs) as workers:
            known = records.open(resume=resume)
            outcomes.extend(known[case.name] for case in cases if case.name in known)
            missing = [case for case in cases if case.name not in known]
            with TaskDisplay("suite", len(cases), len(outcomes)) as display:
                watched = workers.watched(check, display.show)
                for outcome in run_suite(missing, settings, records, watched):
                    records.add(outcome)
                    outcomes.append(outcome)
                    display.finished(f"{len(outcomes)}/{len(cases)} {outcome_line(outcome)}")
        records.close()

    complete = runs_to_its_end(run)
    return sorted(outcomes, key=lambda outcome: outcome.name), complete


def _print_cases(cases: Sequence[Case], as_json: bool) -> None:
    if as_json:
        click.echo(to_json({"pairs": [{"problem": case.problem, "robot": case.robot} for case in cases]}))
        return
    width = max(len(case.problem) for case in cases)
    for case in cases:
        click.echo(f"{case.problem:{width}}  {case.robot}")
    click.echo(f"{len(cases)} pairs", err=True)


def _print(outcomes: Sequence[Outcome], outside: dict[str, str] | None) -> None:
    from trajopt.study.suite.table import outcome_table, summary_lines

    shown = console(PIPE_WIDTH)
    if outcomes:
        shown.print(outcome_table(outcomes, shown.width))
    for text in summary_lines(outcomes):
        shown.print(text, soft_wrap=True)
    for name, text in (outside or {}).items():
        shown.print(f"outside its bands: {name}: {text}", soft_wrap=True)
