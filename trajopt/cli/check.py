"""``trajopt check``: recompute the figures of a file, and on request the accuracy of its motion."""

from __future__ import annotations

from pathlib import Path

import click

from trajopt.cli.input import NOT_REACHED, json_option
from trajopt.cli.progress import busy
from trajopt.cli.report import say, to_json


@click.command("check")
@click.argument("file", type=Path)
@click.option("--accuracy", is_flag=True, help="Also report open-loop and local errors.")
@click.option(
    "--reference", type=Path, metavar="FILE", help="As --accuracy, and compare with this converged solution."
)
@json_option
def check_command(file: Path, accuracy: bool, reference: Path | None, as_json: bool) -> int:
    """Recompute the figures of FILE with numeric Pinocchio alone.

    --accuracy adds the open-loop error of the planned torques over intervals, phases and the whole motion,
    and the residuals of dynamics and constraints between collocation points. Exit status 1 when a figure is
    beyond its tolerance; the figures of --accuracy have no tolerance.
    """
    from trajopt.certify.check import check
    from trajopt.solution.solution import Solution

    plan = Solution.load(file)
    with busy(f"checking {file}"):
        report = check(plan)
    shown, text = report.to_dict(), report.table()
    if accuracy or reference is not None:
        from trajopt.certify.accuracy.measures import measure
        from trajopt.certify.accuracy.table import accuracy_table

        with busy(f"integrating the torques of {file}"):
            accuracy_figures = measure(plan, reference)
        shown["accuracy"] = accuracy_figures.to_dict()
        text = f"{text}\n\n{accuracy_table(accuracy_figures)}"
    say(to_json(shown) if as_json else text)
    return 0 if report.ok else NOT_REACHED
