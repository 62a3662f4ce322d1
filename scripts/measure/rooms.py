"""Where the minutes of the tests go: by room, and the slowest of them."""

import collections
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import click

from scripts.measure.shared import head, row

MINUTE = 60.0


@click.command()
@click.argument("junit", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--slowest", default=15, show_default=True, help="Tests that are listed one by one.")
def tests(junit: Path, slowest: int) -> None:
    """Minutes of the tests by room, with their fixtures, from the file of `pytest --junit-xml=JUNIT`.

    Workers add up: with -n 2 the run took about half of the sum.
    """
    seconds: dict[str, dict[str, float]] = collections.defaultdict(dict)
    for case in ElementTree.parse(junit).iter("testcase"):
        _, *room, file = case.attrib["classname"].split(".")
        place = "/".join([*room, file])
        seconds["/".join(room) or "(none)"][f"{place}.py::{case.attrib['name']}"] = float(case.attrib["time"])
    head("room", "tests", "minutes", "slowest, s")
    for room, times in sorted(seconds.items(), key=lambda each: -sum(each[1].values())):
        figures = sum(times.values()) / MINUTE, max(times.values())
        row(room, len(times), *(f"{figure:.1f}" for figure in figures))
    whole = {test: time for times in seconds.values() for test, time in times.items()}
    row("all", len(whole), f"{sum(whole.values()) / MINUTE:.1f}", f"{max(whole.values()):.1f}")
    click.echo()
    head("test", "s")
    for test, time in sorted(whole.items(), key=lambda each: -each[1])[:slowest]:
        row(f"`{test}`", f"{time:.1f}")
