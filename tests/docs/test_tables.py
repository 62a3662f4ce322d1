"""Tables that commands write into documents: against the commands, and against the regression data."""

import csv
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from scripts.documents import cells
from scripts.measure.__main__ import main
from tests.support.printed import difference
from tests.support.repository import ROOT
from trajopt.study.suite.data import read

SECTION = re.compile(r"<!-- ([\w-]+) -->\n\n(.*?)\n<!-- end of \1 -->", re.DOTALL)
TEXTS = {page: page.read_text(encoding="utf-8") for page in (ROOT / "docs").rglob("*.md")}
PAGES = {name: (page, lines) for page, text in TEXTS.items() for name, lines in SECTION.findall(text)}
# Longer tables stand beside the pages, which link to them.
DATA = {path.stem: path for path in (ROOT / "docs" / "data").glob("*.csv")}
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


def table(lines: str) -> list[dict[str, str]]:
    """Rows of a Markdown table by its titles."""
    titles, *rows = cells(lines)
    return [dict(zip(titles, row, strict=True)) for row in rows]


def data(name: str) -> list[dict[str, str]]:
    """Rows of a CSV file by its titles."""
    with DATA[name].open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream, strict=True))


def command(name: str) -> str:
    """Pattern of the command that writes a table."""
    return rf"scripts\.measure {name} [^`\n]*--write"


def test_every_table_has_its_command() -> None:
    assert (set(PAGES) - BESIDE_CROCODDYL) | set(DATA) <= set(main.commands)
    assert set(QUICK) <= set(PAGES)


@pytest.mark.parametrize("name", sorted(set(PAGES) - BESIDE_CROCODDYL))
def test_a_page_names_the_command_of_its_table(name: str) -> None:
    page, lines = PAGES[name]
    assert re.search(command(name), TEXTS[page])
    assert table(lines)


@pytest.mark.parametrize("name", sorted(DATA))
def test_one_page_links_to_a_table_and_names_its_command(name: str) -> None:
    (text,) = (text for text in TEXTS.values() if f"data/{name}.csv)" in text)
    assert re.search(command(name), text)
    assert data(name)


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
        f"{row['problem']}@{robot}": int(count)
        for row in data("library")
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
    assert int(table(PAGES["suite"][1])[0]["to the grade"]) == len(bands)
    families, robots = ({getattr(band, key) for band in bands.values()} for key in ("problem", "robot"))
    said = f"{len(families)} problem families on {len(robots)} robots, [{len(bands)} pairs]"
    assert said in Path(ROOT / "README.md").read_text(encoding="utf-8")


def test_as_many_plans_are_tracked_as_pages_say() -> None:
    *plans, tracked = data("tracking")
    judged = [cell for row in plans for name, cell in row.items() if name != "problem" and cell]
    held = [cell for cell in judged if not re.search("off|fell", cell)]
    counted = [re.findall(r"\d+", cell) for name, cell in tracked.items() if name != "problem"]
    assert [sum(map(int, each)) for each in zip(*counted, strict=True)] == [len(held), len(judged)]
    for page in (ROOT / "README.md", ROOT / "docs" / "simulation.md"):
        assert f"{len(held)} of {len(judged)}" in page.read_text(encoding="utf-8")
