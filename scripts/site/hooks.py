"""Hooks of MkDocs: pages that are generated, and links out of `docs/`."""

import posixpath
import re
import sys
from functools import partial
from pathlib import Path

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


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the reference, the notebooks, the replays, and pages that lie at the root of the repository."""
    generated: dict[str, str | bytes] = {
        **reference.python_pages(),
        **reference.command_pages(),
        **reference.problem_page(),
    }
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        generated |= stored(path.stem, partial(notebooks.pages, path))
    page = files.src_uris[gallery.PAGE].content_string
    generated |= stored("gallery", partial(gallery.replays, page))
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
