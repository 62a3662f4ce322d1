"""Robustness: four problems from many perturbed starts with every solver, as the table of docs/robustness.md.

uv run python -m scripts.robustness                        # 200 starts at two noises, one core
uv run python -m scripts.robustness --starts 5 --page -    # a trial; the table to stdout
uv run python -m scripts.robustness --solver ipopt --sigma 0.1   # one of each; may be repeated
uv run python -m scripts.robustness --only-table           # write the table from what is there

Interrupted, the same command goes on where it was: every start that has ended is kept in the work folder.
"""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from trajopt.errors import InputError
from trajopt.solvers.drivers import SOLVERS
from trajopt.suite.outcome import Outcome, quantile
from trajopt.suite.records import FILE, outcomes_of
from trajopt.workers.records import JsonLines

# Problem and robot; of the biped the one whose solves are fastest.
PAIRS = {"ur5-reach": "ur5", "solo12-jump": "solo12", "hopper-hop": "hopper", "biped-squat": "bolt"}
WORK = Path("robustness-work")
PAGE = Path(__file__).parent.parent / "docs" / "robustness.md"
BEGIN, END = "<!-- table -->", "<!-- end of table -->"
TITLES = (
    "problem", "noise", "solver", "solved", "iterations: median", "90 %", "worst", "median time", "optima",
    "motions", "not solved",
)  # fmt: skip
# Scaled units: a tenth is metres of leg or half a dozen degrees; three tenths are far from any motion.
NOISES = (0.1, 0.3)
# s: on any machine the limit of 500 iterations comes first, so that counts do not depend on the machine.
MOST_TIME = 600.0


def folder(work: Path, solver: str, sigma: float) -> Path:
    """Where the results of a solver are at a noise."""
    return work / f"{solver}-{sigma:g}"


def run(solver: str, starts: int, sigma: float, work: Path) -> None:
    """All pairs with one solver, one at a time so that times are its own, going on from before."""
    command = [sys.executable, "-m", "trajopt", "suite", "--resume", "--jobs", "1"]
    command += ["--problems", *PAIRS, "--robots", *PAIRS.values(), "--perturbed", str(starts)]
    command += ["--sigma", f"{sigma:g}", "--solver", solver, "--max-time", f"{MOST_TIME:g}"]
    command += ["--output-dir", str(folder(work, solver, sigma))]
    status = subprocess.run(command, check=False).returncode
    if status not in (0, 1):  # 1: some start was not solved, which is what is being counted
        sys.exit(status)


def outcomes(results: Path, starts: int) -> dict[str, Outcome]:
    """Results by problem, the last ones of each; those of other numbers of starts are passed over."""
    known = outcomes_of(JsonLines(results / FILE).read())
    return {outcome.problem: outcome for outcome in known if len(outcome.starts) == starts}


def cells(outcome: Outcome, solver: str, sigma: float) -> list[str]:
    """One line of the table."""
    figures, own = outcome.perturbed(), outcome.own
    iterations = sorted(attempt.iterations for attempt in outcome.starts if attempt.solved)
    lost = Counter(attempt.mode for attempt in outcome.starts if not attempt.solved)
    shown: list[Any] = ["", "", ""]
    if iterations:
        shown = [f"{figures.median_iterations:g}", quantile(iterations, 0.9), figures.most_iterations]
    refused = own is None and outcome.error
    return [
        outcome.problem,
        f"{sigma:g}",
        solver,
        "refused" if refused else f"{figures.solved} / {figures.count}",
        *map(str, shown),
        "" if figures.median_time is None else f"{figures.median_time:.2f} s",
        *([str(figures.optima), str(figures.motions)] if figures.solved else ["", ""]),
        ", ".join(f"{mode} {count}" for mode, count in lost.most_common()),
    ]


def table(work: Path, solvers: Sequence[str], sigmas: Sequence[float], starts: int) -> str:
    """The table as Markdown, problems one after the other, noises and solvers within."""
    keys = [(sigma, solver) for sigma in sigmas for solver in solvers]
    found = {(s, solver): outcomes(folder(work, solver, s), starts) for s, solver in keys}
    rows = [
        cells(found[key][problem], key[1], key[0])
        for problem in PAIRS
        for key in keys
        if problem in found[key]
    ]
    if not rows:
        raise InputError(f"no results of {starts} starts in {work}", "allowed: run it without --only-table")
    return "\n".join(_lines([list(TITLES), ["---"] * len(TITLES), *rows]))


def _lines(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    for row in rows:
        yield f"| {' | '.join(row)} |"


def written(page: str, new: str) -> str:
    """The page with the table between its marks. Raises InputError where it has none."""
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise InputError(f"the page has no {BEGIN} ... {END}", "allowed: a page with both marks")
    return f"{before}{BEGIN}\n{new}\n{END}{after}"


@click.command()
@click.option("--starts", type=click.IntRange(1), default=200, show_default=True)
@click.option("--solver", "solvers", multiple=True, type=click.Choice(list(SOLVERS)), help="[default: all]")
@click.option(
    "--sigma", "sigmas", multiple=True, type=click.FloatRange(0, min_open=True), help="[default: 0.1, 0.3]"
)
@click.option("--work", type=Path, default=WORK, show_default=True, help="Folder of the results.")
@click.option("--page", default=str(PAGE), help="Where the table goes; - for stdout.  [default: docs]")
@click.option("--only-table", is_flag=True, help="Run nothing.")
def main(
    starts: int,
    solvers: tuple[str, ...],
    sigmas: tuple[float, ...],
    work: Path,
    page: str,
    only_table: bool,
) -> None:
    """Run what is missing, and write the table."""
    chosen, noises = solvers or tuple(SOLVERS), sigmas or NOISES
    if not only_table:
        for sigma in noises:
            for solver in chosen:
                run(solver, starts, sigma, work)
    new = table(work, chosen, noises, starts)
    if page == "-":
        click.echo(new)
        return
    target = Path(page)
    target.write_text(written(target.read_text(encoding="utf-8"), new), encoding="utf-8")


if __name__ == "__main__":
    main()
