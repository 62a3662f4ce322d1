"""Hooks of MkDocs: pages that are generated, and links out of `docs/`."""

import multiprocessing
import os
import posixpath
import re
import sys
from concurrent.futures import Future, ProcessPoolExecutor
from functools import partial
from pathlib import Path

from jinja2 import Environment
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from scripts.site import gallery, notebooks, reference  # noqa: E402
from scripts.site.stored import stored  # noqa: E402

# A block of code with the name of the file that it is saved as.
NAMED_BLOCK = re.compile(r"^(```\w+) ([\w.]+)$", re.MULTILINE)
LINK = re.compile(r"(?<=\]\()(\.\./[^)#\s]+)")
# Files of the repository that are pages of the site, and the folder for others that pages link to.
PAGES = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
FILES = "files"
# Replays of the gallery in the making, by their paths in the site.
replays: dict[str, Future[bytes]] = {}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the reference, the notebooks, the replays, and pages that lie at the root of the repository."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # a process for each core
    pool = ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn"))
    executed = [pool.submit(notebooks.pages, path) for path in sorted((ROOT / "notebooks").glob("*.ipynb"))]
    for name in gallery.replays(files.src_uris[gallery.PAGE].content_string):
        make = partial(gallery.replay, name)
        replays[f"gallery/{name}.html"] = pool.submit(stored, name, make, gallery.__file__)
    pool.shutdown(wait=False)
    generated: dict[str, str | bytes] = {
        **reference.python_pages(),
        **reference.command_pages(),
        **reference.problem_page(),
        **dict.fromkeys(replays, b""),
    }
    for tutorial in executed:
        generated |= tutorial.result()
    for source, page in PAGES.items():
        if page not in files.src_uris and (ROOT / source).is_file():
            generated[page] = (ROOT / source).read_text(encoding="utf-8").replace("](docs/", "](")
    for name, content in generated.items():
        files.append(File.generated(config, name, content=content))
    for name in sorted(_linked(files)):
        files.append(File.generated(config, f"{FILES}/{name}", abs_src_path=str(ROOT / name)))
    return files


def _outside(link: str, page: str) -> str | None:
    """The file of the repository that a link of a page leads to, if that lies outside ``docs``."""
    target = posixpath.normpath(posixpath.join("docs", posixpath.dirname(page), link))
    return None if target.startswith(("docs/", "..")) or not (ROOT / target).is_file() else target


def _linked(files: Files) -> set[str]:
    """Files outside ``docs`` that pages link to, and that are no pages."""
    found = set()
    for file in files.documentation_pages():
        links = (_outside(link, file.src_uri) for link in LINK.findall(file.content_string))
        found |= {link for link in links if link is not None and link not in PAGES}
    return found


def on_env(env: Environment, config: MkDocsConfig, files: Files) -> None:
    """Put the replays, made while pages were rendered, into their files."""
    for page, replay in replays.items():
        files.src_uris[page].content_bytes = replay.result()
    replays.clear()


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links to files outside ``docs`` into links within the site, and names of blocks into titles."""

    def within(match: re.Match[str]) -> str:
        target = _outside(match[1], page.file.src_uri)
        if target is None:
            return match[1]
        inside = PAGES.get(target, f"{FILES}/{target}")
        return posixpath.relpath(inside, posixpath.dirname(page.file.src_uri) or ".")

    if page.file.src_uri == gallery.PAGE:
        markdown = gallery.with_links(markdown)
    return NAMED_BLOCK.sub(r'\1 title="\2"', LINK.sub(within, markdown))
