"""Tables that commands write into documents: against the commands, and against the regression data."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from scripts.measure.__main__ import main
from tests.support.printed import difference
from tests.support.repository import ROOT
from trajopt.study.suite.data import read

SECTION = re.compile(r"<!-- ([\w-]+) -->\n\n(.*?)\n<!-- end of \1 -->", re.DOTALL)
PAGES = {
    name: (page, lines)
    for page in (ROOT / "docs").rglob("*.md")
    for name, lines in SECTION.findall(page.read_text(encoding="utf-8"))
}
# Written by `scripts/compare_crocoddyl.py`.
BESIDE_CROCODDYL = {name for name, (page, _) in PAGES.items() if page.name == "peers.md"}
# Measured in less than half a minute, and again here: columns that do not depend on the machine.
QUICK = {
    "bases": ("variables", "objective"),
    "models": ("variables", "rows", "objective"),
    "outside": ("published", "found", "intervals"),
    "transfers": ("duration",),
}
# Of the models: how many planes are laid between links, and where a solve is stopped.
UNSURE = "base (Solo12 half flip)"


def table(lines: str) -> Iterator[dict[str, str]]:
    """Rows of a Markdown table by its titles."""
    split = ([cell.strip() for cell in line.strip()[1:-1].split("|")] for line in lines.strip().splitlines())
    titles, _, *rows = split
    return (dict(zip(titles, row, strict=True)) for row in rows)


def test_every_table_between_markers_has_its_command() -> None:
    assert set(PAGES) - BESIDE_CROCODDYL <= set(main.commands)
    assert set(QUICK) <= set(PAGES)


@pytest.mark.parametrize("name", sorted(set(PAGES) - BESIDE_CROCODDYL))
def test_a_page_names_the_command_of_its_table(name: str) -> None:
    page, lines = PAGES[name]
    assert re.search(rf"scripts\.measure {name} [^`\n]*--write", page.read_text(encoding="utf-8"))
    assert list(table(lines))


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(QUICK))
def test_a_table_is_what_its_command_finds_now(name: str) -> None:
    measured = CliRunner().invoke(main, [name], catch_exceptions=False).output
    for stated, row in zip(table(PAGES[name][1]), table(measured), strict=True):
        for column in QUICK[name]:
            if UNSURE not in stated.values():
                assert difference(stated[column], row[column]) == "", f"{name}, {column} of {stated}"


def test_iterations_of_the_library_are_within_the_regression_data() -> None:
    bands, _ = read(ROOT / "tests/data/suite.csv")
    counted = {
        f"{row['problem'].strip('`')}@{robot}": int(count)
        for row in table(PAGES["library"][1])
        for robot, count in re.findall(
            r"(\w+) (\d+) \(\d+\)", row["iterations on all meshes (meshes), by robot"]
        )
    }
    assert set(counted) == set(bands)
    outside = {
        pair: count
        for pair, count in counted.items()
        if not bands[pair].iterations_low <= count <= bands[pair].iterations_high
    }
    assert outside == {}


def test_the_suite_has_as_many_pairs_as_its_pages_say() -> None:
    bands, _ = read(ROOT / "tests/data/suite.csv")
    pairs, *_ = table(PAGES["suite"][1])
    assert int(pairs["to the grade"]) == len(bands)
    families, robots = ({getattr(band, key) for band in bands.values()} for key in ("problem", "robot"))
    said = f"{len(families)} problem families on {len(robots)} robots, [{len(bands)} pairs]"
    assert said in Path(ROOT / "README.md").read_text(encoding="utf-8")
