"""Simulate solution files in MuJoCo and print how they are tracked, one row a file.

uv run trajopt suite --problems 'quadruped-*' --output-dir plans
uv run python -m scripts.simulate_plans plans
uv run python -m scripts.simulate_plans plans --only 'quadruped-jump-*' --set cycles=3
"""

from __future__ import annotations

from fnmatch import fnmatchcase
from pathlib import Path

import click

from trajopt.certify.simulation.simulate import Simulation, simulate
from trajopt.cli.input import options_of
from trajopt.errors import InputError
from trajopt.solution.solution import Solution

HEAD = (
    "plan",
    "tracked",
    "base at the end mm",
    "turn rad",
    "base largest mm",
    "held mm",
    "joints rms rad",
    "touchdown ms",
    "travel mm",
    "cut off %",
    "wall / duration",
    "why",
)


@click.command()
@click.argument("places", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
@click.option("--only", default="*", metavar="GLOB", help="Files whose name without ending fits.")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help="Settings of the simulation.")
def main(places: tuple[Path, ...], only: str, settings: tuple[str, ...]) -> None:
    """Print a Markdown table of the files in folders, or of single files."""
    files = [
        file for place in places for file in (sorted(place.glob("*.npz")) if place.is_dir() else [place])
    ]
    given = options_of(settings)
    click.echo("| " + " | ".join(HEAD) + " |")
    click.echo("|" + "---|" * len(HEAD))
    tracked = count = 0
    for file in (file for file in files if fnmatchcase(file.stem, only)):
        plan = Solution.load(file)
        count += 1
        if not plan.success:
            click.echo(f"| {file.stem} | not solved |" + " |" * (len(HEAD) - 2))
            continue
        try:
            found = simulate(plan, **given)
        except InputError as error:
            click.echo(f"| {file.stem} | refused |" + " |" * (len(HEAD) - 3) + f" {error} |")
            continue
        tracked += found.report.passed
        click.echo("| " + " | ".join(_row(file.stem, found)) + " |")
    click.echo(f"\n{tracked} of {count} plans are tracked")


def _row(name: str, found: Simulation) -> list[str]:
    report = found.report
    return [
        name,
        "yes" if report.passed else "no",
        _scaled(report.base_error_end, 1e3, ".1f"),
        _scaled(report.base_turn_end, 1.0, ".3f"),
        _scaled(report.base_error_max, 1e3, ".1f"),
        _scaled(report.base_error_held if report.held else None, 1e3, ".1f"),
        _scaled(report.joint_error_rms, 1.0, ".4f"),
        _scaled(report.touchdown_error, 1e3, ".0f"),
        _scaled(report.slip_travel, 1e3, ".1f"),
        _scaled(report.saturated, 1e2, ".1f"),
        _scaled(found.wall_time / (report.duration + report.held), 1.0, ".2f"),
        "; ".join(report.failures),
    ]


def _scaled(value: float | None, factor: float, form: str) -> str:
    return "" if value is None else format(value * factor, form)


if __name__ == "__main__":
    main()
