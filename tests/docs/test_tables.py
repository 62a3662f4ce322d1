"""Tables that commands write into documents, and generated pages of the site, which forget nothing."""

import csv
import importlib
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import click
import pytest
from click.testing import CliRunner
from playwright.sync_api import Page, sync_playwright

from scripts.documents import cells
from scripts.measure.__main__ import main
from scripts.site import gallery, reference
from tests.support.browser import require_chromium
from tests.support.printed import difference
from tests.support.repository import ROOT
from trajopt.problem import families
from trajopt.study.suite.data import read
from trajopt.view.replay.browser import FLAGS

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
    families, robots = ({getattr(band, key) for band in bands.values()} for key in ("family", "robot"))
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


SITE_PAGES = reference.python_pages()
COMMANDS = dict(reference.commands())


@pytest.mark.parametrize("module", sorted(reference.public_names()))
def test_every_public_name_has_its_entry(module: str) -> None:
    loaded = importlib.import_module(module)
    names = {name for name in loaded.__all__ if not isinstance(getattr(loaded, name), ModuleType)}
    page = SITE_PAGES[f"{reference.PYTHON}/{module}.md"]
    assert set(re.findall(rf"^::: {module}\.(\w+)$", page, re.MULTILINE)) >= names
    assert f"]({module}.md)" in SITE_PAGES[f"{reference.PYTHON}/index.md"]


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_option_of_a_command_is_on_its_page(name: str) -> None:
    pages = reference.command_pages()
    page = pages[f"{reference.COMMANDS}/{name.removeprefix('trajopt ').replace(' ', '-')}.md"]
    options = [p for p in COMMANDS[name].params if isinstance(p, click.Option) and not p.hidden]
    for option in (word for parameter in options for word in parameter.opts):
        assert re.search(rf"`[^`]*{re.escape(option)}\b", page), option
    assert f"`{name}`" in pages[f"{reference.COMMANDS}/index.md"]


def test_every_parameter_of_every_problem_is_listed() -> None:
    (page,) = reference.problem_page().values()
    sections = dict(re.findall(r"^## `([\w-]+)`\n(.*?)(?=^## |\Z)", page, re.MULTILINE | re.DOTALL))
    assert set(sections) == set(families())
    for name, family in families().items():
        listed = re.findall(r"^\| `(\w+)` \|", sections[name], re.MULTILINE)
        assert listed == [parameter.name for parameter in family.parameters], name


def test_nothing_of_the_site_comes_from_a_network() -> None:
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    assert "http" not in text
    assert "font: false" in text
    assert re.search(r"^  - offline", text, re.MULTILINE)
    assets = [path for path in (ROOT / "docs/assets").rglob("*") if path.suffix in (".js", ".css")]
    assert {"katex.min.js", "katex.min.css", "iframe-worker.js"} <= {path.name for path in assets}
    for path in assets:
        assert not re.search(r"url\(\s*[\"']?https?:", path.read_text(encoding="utf-8")), path.name


def test_every_picture_of_the_gallery_opens_a_replay() -> None:
    text = (ROOT / "docs" / gallery.PAGE).read_text(encoding="utf-8")
    names = {name for _, name in gallery.PICTURE.findall(text)}
    linked = set(re.findall(r"\]\(([\w@.-]+)\.html\)", gallery.with_links(text)))
    assert linked == names


# Seconds after which a build is ended.
LIMIT = 840
# Attributes with which a page loads something by itself.
LOADED = re.compile(r"<(?:script|img|iframe|source)[^>]* src=\"?https?:|<link[^>]*stylesheet[^>]*https?:")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site: that of ``TRAJOPT_SITE`` (CI has built one), or one that is built now."""
    if "TRAJOPT_SITE" in os.environ:
        return Path(os.environ["TRAJOPT_SITE"])
    pytest.importorskip("mkdocs", reason="the site needs: uv sync --group docs")
    target = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(target)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=LIMIT)
    assert done.returncode == 0, done.stderr[-2000:]
    return target


@pytest.fixture
def view() -> Iterator[Page]:
    """A page that must load nothing but files, and report no error."""
    wrong: list[str] = []
    with sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=require_chromium(), args=list(FLAGS))
        page = chromium.new_page()
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("requestfailed", lambda request: wrong.append(request.url))
        page.on("request", lambda request: wrong.append(request.url) if "http" in request.url[:4] else None)
        yield page
        chromium.close()
    assert wrong == []


@pytest.mark.slow
def test_search_finds_a_name_without_a_network(site: Path, view: Page) -> None:
    view.goto((site / "index.html").as_uri() + "?q=FrictionCone")
    view.wait_for_selector(".md-search-result__link >> nth=0")
    links = view.eval_on_selector_all(".md-search-result__link", "all => all.map(link => link.href)")
    assert any("reference/python/trajopt.terms.html" in link for link in links)


@pytest.mark.slow
def test_formulas_are_rendered(site: Path, view: Page) -> None:
    view.goto((site / "mathematics.html").as_uri())
    view.wait_for_selector(".katex-display >> nth=0")
    assert view.locator(".arithmatex").count() == view.locator(".arithmatex > :first-child").count() > 20
    assert view.locator(".katex-error").count() == 0


@pytest.mark.slow
def test_a_replay_of_the_gallery_plays(site: Path, view: Page) -> None:
    view.goto((site / "gallery" / "solo12-jump@solo12.html").as_uri())
    view.wait_for_function("typeof trajopt !== 'undefined'")
    seek = (
        "() => trajopt.ready.then(() => { trajopt.pause(); trajopt.seek(0.4); return trajopt.state().time; })"
    )
    assert view.evaluate(seek) == pytest.approx(0.4)


@pytest.mark.slow
def test_pages_load_nothing_from_elsewhere_and_hold_their_replays(site: Path) -> None:
    pages = list(site.rglob("*.html"))
    assert len(pages) > 100
    assert [page.name for page in pages if LOADED.search(page.read_text(encoding="utf-8"))] == []
    for name in ("arm", "gait", "jump"):
        frames = re.findall(
            r'src="([^"]+)"', (site / "tutorials" / f"{name}.html").read_text(encoding="utf-8")
        )
        replays = [frame for frame in frames if frame.startswith(f"{name}/replay")]
        assert len(replays) == 2
        assert all((site / "tutorials" / frame).is_file() for frame in replays)


DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
CODE = re.compile(r"^ *```.*?^ *```$|`[^`\n]*`", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\(([^)\s]+)\)")
HEADING = re.compile(r"^#{1,6} +(.+)$", re.MULTILINE)
# Pages that only the site has, by folder, and the site's own page, which alone may lead there.
SITE = ROOT / "docs" / "index.md"
GENERATED = ("docs/reference/", "docs/tutorials/", "docs/contributing.md", "docs/changelog.md")


def anchors(document: Path) -> set[str]:
    """Names of a document's headings as code hosts and MkDocs make them."""
    text = re.sub(r"^```.*?^```$", "", document.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    headings = (re.sub(r"\]\([^)]*\)", "", heading).lower() for heading in HEADING.findall(text))
    slugs = {re.sub(r" +", "-", re.sub(r"[^\w\s-]", "", heading).strip()) for heading in headings}
    return slugs | set(re.findall(r'<a id="([^"]+)">', text))


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_to_files_and_headings(document: Path) -> None:
    text = CODE.sub("", document.read_text(encoding="utf-8"))
    for link in LINK.findall(text):
        if re.match(r"[a-z]+:", link):
            continue
        path, _, anchor = link.partition("#")
        target = (document.parent / path).resolve() if path else document
        if document == SITE and str(target.relative_to(ROOT)).startswith(GENERATED):
            continue
        assert target.exists(), link
        if anchor and target.suffix == ".md":
            assert anchor in anchors(target), link
