"""``trajopt plot``: a solution's report, or several solutions overlaid."""

from __future__ import annotations

from pathlib import Path

import click

from trajopt.cli.progress import busy
from trajopt.cli.report import say
from trajopt.solution.output import check_apart


@click.command("plot")
@click.argument("files", nargs=-1, required=True, type=Path, metavar="FILE...")
@click.option(
    "-o", "--output", required=True, type=Path, metavar="OUT", help="A .png, .svg, .pdf or .html file."
)
@click.option("--label", "labels", multiple=True, metavar="NAME", help="Label of each file, in order.")
@click.option(
    "--page",
    "--pages",
    "pages",
    multiple=True,
    metavar="NAME[,NAME]...",
    help="summary, limits, joints, drives, forces, soles, base, momentum, clearance or accuracy.  "
    "[default: summary for .png and .svg, else all]",
)
def plot_command(
    files: tuple[Path, ...], output: Path, labels: tuple[str, ...], pages: tuple[str, ...]
) -> None:
    """Plot the solution in FILE, with all limits.

    Several FILEs of one robot are overlaid.

    Pages that do not apply to the robot (without contacts, drives or a moving base) are left out.
    """
    from trajopt.view.plotting.writing import write_plots

    check_apart([output], files)
    names = [name.strip() for given in pages for name in given.split(",") if name.strip()]
    with busy(f"plotting {output}"):
        plotted = write_plots(list(files), output, labels=labels or None, pages=names or None)
    shown = ", ".join(dict.fromkeys(plotted.pages))
    say(f"{plotted.path}: {shown}, {plotted.size / 1e6:.2f} MB")
