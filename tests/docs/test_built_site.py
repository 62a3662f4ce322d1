"""The built site in a browser, opened as files: search, formulas and replays work without a network."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, sync_playwright

from tests.support.browser import require_chromium
from tests.support.repository import ROOT
from trajopt.view.replay.browser import FLAGS

pytestmark = pytest.mark.slow
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


def test_search_finds_a_name_without_a_network(site: Path, view: Page) -> None:
    view.goto((site / "index.html").as_uri() + "?q=FrictionCone")
    view.wait_for_selector(".md-search-result__link >> nth=0")
    links = view.eval_on_selector_all(".md-search-result__link", "all => all.map(link => link.href)")
    assert any("reference/python/trajopt.terms.html" in link for link in links)


def test_formulas_are_rendered(site: Path, view: Page) -> None:
    view.goto((site / "mathematics.html").as_uri())
    view.wait_for_selector(".katex-display >> nth=0")
    assert view.locator(".arithmatex").count() == view.locator(".arithmatex > :first-child").count() > 20
    assert view.locator(".katex-error").count() == 0


def test_a_replay_of_the_gallery_plays(site: Path, view: Page) -> None:
    view.goto((site / "gallery" / "solo12-jump@solo12.html").as_uri())
    view.wait_for_function("typeof trajopt !== 'undefined'")
    seek = (
        "() => trajopt.ready.then(() => { trajopt.pause(); trajopt.seek(0.4); return trajopt.state().time; })"
    )
    assert view.evaluate(seek) == pytest.approx(0.4)


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
